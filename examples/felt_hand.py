"""The stiffness that a hand meets: `pip install 'antagonist[mujoco]'`, then `python felt_hand.py`.

The joints of a two-joint arm with six muscles rub. A hand that is pushed to and fro by a force meets this hysteresis
beside the muscles' stiffness. The pressures are computed twice for the same stiffness, as the isobaric one of the
muscles and as the one felt by the push. The script prints how far the hand moves under the force that has to move it by
25 mm, and writes felt_hand.png with both loops.
"""

import matplotlib.pyplot as plt
import numpy as np

from allocator import DEG, Limits, Stiffness, allocate
from mpc import Arm
from mpc.arm import MujocoPlant
from mpc.model import Friction

ARM = Arm.machine("arm26")
HAND = ARM.bodies.endpoint
POSTURE, AMPLITUDE = np.array([0.1, 0.6]), 1.5 * DEG  # [rad] of the joints, and by which a push moves each of them
RUBBING = Friction(coulomb=0.10, presliding=1.0 * DEG), Friction(coulomb=0.08, presliding=0.6 * DEG)
STIFFNESS = np.array([[815.0, 387.0], [387.0, 222.0]])  # of the hand [N/m]
LEAST_FORCE = 10.0  # [N] with which every muscle pulls, so that none goes slack as the hand is pushed


def pushed(P: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the forces (k,) [N] of a push to and fro, and how far the hand moves along it (k,) [m]."""
    J = HAND.jacobian(POSTURE)
    along = J @ np.full(ARM.n, AMPLITUDE)  # the way that all joints move by the amplitude
    force = STIFFNESS @ along
    plant = MujocoPlant.of(ARM, friction=RUBBING)
    plant.reset(POSTURE, P)
    course = np.cos(np.linspace(0, 4 * np.pi, 49))
    hand = np.array([HAND.position(plant.settle(s * J.T @ force)) for s in course])
    course, hand = course[24:], hand[24:]  # of the second cycle, which is steady
    way = (hand - (hand.max(axis=0) + hand.min(axis=0)) / 2) @ along / np.linalg.norm(along)
    return course * float(np.linalg.norm(force)), way


def main() -> None:
    loops = tuple(friction.loop for friction in RUBBING)
    kinds = {
        "isobaric": Stiffness(endpoint=HAND),
        "felt": Stiffness(endpoint=HAND, amplitude=AMPLITUDE, loop=loops),
    }
    expected = float(np.linalg.norm(HAND.jacobian(POSTURE) @ np.full(ARM.n, AMPLITUDE)))
    target = POSTURE[None], STIFFNESS[None], ARM.bodies.gravity_torque(POSTURE)[None]  # one of a row
    figure, axes = plt.subplots(figsize=(6, 4), layout="constrained")
    for name, kind in kinds.items():
        answer = allocate(*target, joint=ARM.mechanism, stiffness=kind, limits=Limits(LEAST_FORCE))
        assert answer.stiffness_met.all()
        force, way = pushed(answer.P[0])
        print(f"{name} stiffness as asked: the hand moves by {1e3 * np.ptp(way) / 2:.1f} of {1e3 * expected:.1f} mm")
        axes.plot(1e3 * way, force, label=f"{name} stiffness as asked")
    ends = np.array([-expected, expected])
    axes.plot(1e3 * ends, ends / expected * force.max(), "k--", lw=1, label="the stiffness asked for")
    axes.set(xlabel="displacement of the hand [mm]", ylabel="force [N]")
    axes.legend()
    axes.grid(alpha=0.25)
    figure.savefig("felt_hand.png", dpi=150)


if __name__ == "__main__":
    main()
