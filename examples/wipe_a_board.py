"""Wipe a board with three stiffnesses of the hand: `pip install 'antagonist[mujoco]'`, then `python wipe_a_board.py`.

The hand of a two-joint arm with six muscles slides along a board. Its reference runs 3 mm behind the surface, so that
the hand presses with the stiffness across the board times these 3 mm. The pressures come from the inverse dynamics
alone: feedback of the angles would make the hand stiffer than its muscles are. The script prints the stiffness that the
board meets beside the one asked for, which is that of small displacements: 3 mm turn the elbow by 1.5°, which takes 4 %
of it. It writes wiping.png.
"""

from dataclasses import replace
from xml.etree import ElementTree as Tree

import matplotlib.pyplot as plt
import numpy as np

from mpc import Arm, Reference, simulate
from mpc.arm import MujocoPlant, to_mjcf
from mpc.trials import FeedForwardControl

ARM = Arm.machine("arm26")
HAND = ARM.bodies.endpoint
BOARD, BEHIND, OFF = 0.59, 0.003, 0.006  # [m] x of the surface, the reference behind it, and before it at the ends
RADIUS, STROKE = 0.01, (-0.03, 0.0)  # [m] of the hand, from where to where along y
ACROSS, ALONG = (350.0, 400.0, 450.0), 30.0  # [N/m] asked for across the board and along it
LEAST_FORCE = 10.0  # [N] with which every muscle pulls, so that none goes slack as the hand is pushed back
APPROACH, SLIDE = 0.8, 1.6  # [s]


def model() -> str:
    """Return the arm's MJCF with a round hand and a board without friction, which touch nothing else."""
    root = Tree.fromstring(to_mjcf(ARM.mechanism, ARM.bodies, timestep=0.001))
    flag = root.find("option/flag")
    assert flag is not None
    flag.set("contact", "enable")
    touching = {"contype": "2", "conaffinity": "2", "friction": "0 0 0", "condim": "1", "solref": "0.004 1"}
    last = root.findall(".//body")[-1]
    tip = f"{ARM.bodies.length[-1]} 0 0"
    Tree.SubElement(last, "geom", touching, type="sphere", name="hand", mass="0", pos=tip, size=str(RADIUS))
    place = f"{BOARD + RADIUS + 0.01} {sum(STROKE) / 2} 0"
    Tree.SubElement(root.find("worldbody"), "geom", touching, type="box", pos=place, size="0.01 0.1 0.03")
    return Tree.tostring(root, encoding="unicode")


def motion(t: np.ndarray) -> np.ndarray:
    """Return the way of the hand (k, 2) [m]: to the board, along it, and away again."""
    down, up = np.clip(t / APPROACH, 0, 1), np.clip((t - APPROACH - SLIDE) / APPROACH, 0, 1)
    slid = np.clip((t - APPROACH) / SLIDE, 0, 1)
    ease = [s**3 * (10 - 15 * s + 6 * s**2) for s in (down, up, slid)]
    x = BOARD - OFF + (OFF + BEHIND) * (ease[0] - ease[1])
    return np.stack([x, STROKE[0] + (STROKE[1] - STROKE[0]) * ease[2]], axis=1)


def angles(hand: np.ndarray) -> np.ndarray:
    """Return the joints' angles (k, 2) [rad] at which the hand is there (k, 2) [m]."""
    first, second = ARM.bodies.length
    elbow = np.arccos((hand[:, 0] ** 2 + hand[:, 1] ** 2 - first**2 - second**2) / (2 * first * second))
    bent = np.arctan2(second * np.sin(elbow), first + second * np.cos(elbow))
    return np.stack([np.arctan2(hand[:, 1], hand[:, 0]) - bent, elbow], axis=1)


def wipe(across: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the way of the hand (k, 2) [m], the force on the board (k,) [N], and where the stroke is (k,)."""
    arm = replace(ARM, endpoint=HAND)
    K = np.diag([across, ALONG])
    asked = Reference.of("wipe", 2 * APPROACH + SLIDE, lambda t: (angles(motion(t)), np.tile(K, (t.size, 1, 1))))
    plant, force = MujocoPlant(model(), arm.mechanism.muscles, lag=arm.lag, slew=arm.slew, nominal=arm), []

    def watch() -> None:
        force.append(-np.linalg.solve(HAND.jacobian(plant.q).T, plant.data.qfrc_constraint)[0])

    run = simulate(plant, FeedForwardControl(arm, min_force=LEAST_FORCE), asked, watch=watch)
    middle = np.abs(run.t[1:] - APPROACH - SLIDE / 2) < 0.35 * SLIDE
    return HAND.position(run.theta)[1:], np.array(force), middle


def main() -> None:
    figure, (plane, pressing) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    plane.axvspan(1e3 * BOARD, 1e3 * BOARD + 4, color="0.85", label="board")
    plane.plot(*1e3 * motion(np.linspace(0, 2 * APPROACH + SLIDE, 300)).T, "k--", lw=1, label="reference")
    for across in ACROSS:
        hand, force, stroke = wipe(across)
        depth = BOARD + BEHIND - hand[stroke, 0]
        met = float(np.mean(force[stroke] / depth))
        print(f"across the board {across:.0f} N/m asked for, {met:.0f} N/m met: {force[stroke].mean():.2f} N")
        (line,) = plane.plot(*1e3 * hand.T, lw=1.5)
        pressing.plot(1e3 * hand[:, 1], force, color=line.get_color(), label=f"{across:.0f} N/m asked, {met:.0f} met")
        pressing.axhline(across * BEHIND, color=line.get_color(), ls=":", lw=1)
    plane.set(xlabel="x [mm]", ylabel="y [mm]", title="the hand")
    pressing.set(
        xlabel="y [mm]", ylabel="force on the board [N]", title="dotted: stiffness asked for times 3 mm", ylim=(0, 2.5)
    )
    plane.legend(loc="center left")
    pressing.legend(loc="upper right")
    figure.savefig("wiping.png", dpi=150)


if __name__ == "__main__":
    main()
