"""Write what a test stand, a joint at rest and one in motion would have recorded, from a known truth.

    python examples/make_sample_data.py

The muscles are Sarosi2012 with the numbers of the DMSP-20-400N, at rest 400 mm long; the joint is the report's pulley
(radius 20 mm, contraction 0.1375 at θ = 0) with friction μ = 0.03. The forces have 1 % and 1.5 N of noise, the angles
0.03°, the pressures 3 mbar. Every setpoint is held for 4 s, first without a weight, then with it on either side.

In motion both pressures step at random, the pressures written down are the commands; regulators have a lag of 0.12 s,
30 ms of dead time and a dead band of 0.1 bar, the joint has hysteresis with loops of 3°.

The hand of arm26 moves along a rectangle of 12 by 5.5 cm, with rests at its corners, while its stiffness grows.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from allocator import BAR, DEG, AntagonistJoint, Pulley
from allocator.calculus import increasing_root
from allocator.muscles import SAROSI_DMSP_20_400N
from mpc import Plant, RealPlant
from mpc.model import MaxwellSlip

HERE = Path(__file__).parent
JOINT = AntagonistJoint(Pulley(0.40, 0.02, 0.1375), SAROSI_DMSP_20_400N, SAROSI_DMSP_20_400N, friction=0.03)
WEIGHT = 1.5  # [N·m]
RATE, HOLD, LAG = 10, 4.0, 0.3  # [Hz], [s], [s]


def force_table(rng: np.random.Generator) -> None:
    """26 contractions at 5 pressures; a slack muscle pulls with nothing, give or take the noise."""
    eps, P = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.25, 26), np.arange(1, 6) * BAR))
    F = np.maximum(SAROSI_DMSP_20_400N.force(P, eps), 0.0)
    F = np.maximum(F * (1 + 0.01 * rng.standard_normal(F.size)) + 1.5 * rng.standard_normal(F.size), 0.0)
    header = (
        "# synthetic: Sarosi2012, DMSP-20-400N, 1 % and 1.5 N of noise (make_sample_data.py)\neps [%],p [bar],F [N]"
    )
    table = np.column_stack([100 * eps, P / BAR, F])
    np.savetxt(HERE / "force_table.csv", table, "%.5g", ",", header=header, comments="", encoding="utf-8")


def joint_log(rng: np.random.Generator) -> None:
    """Staircases of the pressures up and down, at three sums, without a weight and with it on either side."""
    P1, P2, torque = setpoints()
    without_friction = JOINT.equilibrium(P1, P2, torque)
    way = np.sign(np.diff(without_friction, prepend=without_friction[0]))
    theta = increasing_root(lacking, *JOINT.angle_range, P1, P2, torque, way)
    steps = int(HOLD * RATE)
    t = np.arange(P1.size * steps) / RATE
    rise = np.tile(1 - np.exp(-np.arange(steps) / RATE / LAG), P1.size)
    columns = [follow(a, rise, steps) for a in (P1 / BAR, P2 / BAR, theta / DEG)]
    noise = (0.003, 0.003, 0.03)
    noisy = [a + size * rng.standard_normal(a.size) for a, size in zip(columns, noise, strict=True)]
    header = (
        "# synthetic: the report's pulley, 2 x Sarosi2012 DMSP-20-400N, friction 0.03 (make_sample_data.py)\n"
        "time [s],P1 [bar],P2 [bar],theta [deg],torque [Nm]"
    )
    table = np.column_stack([t, *noisy, np.repeat(torque, steps)])
    np.savetxt(HERE / "joint_log.csv", table, "%.5g", ",", header=header, comments="", encoding="utf-8")


def motion_log(rng: np.random.Generator) -> None:
    """A minute and a half of random steps of both commands, from rest, without a weight."""
    plant = Plant(replace(JOINT, friction=0.0), lag=0.12)
    friction = MaxwellSlip.of_width(plant, 3 * DEG)
    real = RealPlant(plant, friction=friction, dead_time=0.03, dead_band=0.1 * BAR, encoder=0.03 * DEG)
    dt, steps = 0.02, 90
    held = np.concatenate([[[2.5, 2.5]], rng.uniform(1.8, 4.2, (steps, 2))]).repeat(round(1 / dt), axis=0)
    experiment = real.begin(dt, real.at_rest(0.0, 4.8), 2104)
    rows = []
    for k, command in enumerate(held):
        rows.append([k * dt, *command, experiment.measure()[0] / DEG])
        experiment.advance(command * BAR)
    header = (
        "# synthetic: the joint of joint_log.csv in motion, commanded pressures (make_sample_data.py)\n"
        "time [s],P1 [bar],P2 [bar],theta [deg]"
    )
    np.savetxt(HERE / "motion_log.csv", rows, "%.5g", ",", header=header, comments="", encoding="utf-8")


def hand_path() -> None:
    """Minimum-jerk movements along a rectangle, 0.8 s each with rests of 0.4 s; K11 and K22 grow."""
    corners = np.array([[575.0, -60.0], [575.0, 60.0], [630.0, 60.0], [630.0, -60.0], [575.0, -60.0]])  # [mm]
    t = np.arange(0.0, 5.6 + 1e-9, 0.05)
    s = np.clip((t % 1.2 - 0.4) / 0.8, 0.0, 1.0)
    done = np.where(t >= 4.8, 4.0, np.minimum(t // 1.2, 3) + s**3 * (10 - 15 * s + 6 * s**2))
    sides = [np.interp(done, np.arange(5), corner) for corner in corners.T]
    grown = 1.5 * done / 4
    table = np.column_stack([t, *sides, 10 + grown, np.full(t.size, 3.5), 8 + grown])
    header = "# arm26: where the hand is, and the stiffness of the joints [N·m/rad]\nt,x_mm,y_mm,K11,K12,K22"
    np.savetxt(HERE / "hand_path.csv", table, "%.5g", ",", header=header, comments="", encoding="utf-8")


def setpoints() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pressures [Pa] and torque of the weight [N·m] of every setpoint."""
    up = np.linspace(-1, 1, 7)
    P1, P2, torque = [], [], []
    for load, sums in ((0.0, (5.0, 6.5, 8.0)), (WEIGHT, (6.5, 8.0)), (-WEIGHT, (6.5, 8.0))):
        for total in sums:
            half = np.concatenate([up, up[-2:0:-1]]) * 0.6
            P1.append((total / 2 + half) * BAR)
            P2.append((total / 2 - half) * BAR)
            torque.append(np.full(half.size, load))
    return np.concatenate(P1), np.concatenate(P2), np.concatenate(torque)


def lacking(theta, P1, P2, torque, way):
    """Torque that holds the joint back [N·m]; at rest it is nothing."""
    return torque + JOINT.friction_torque(theta, P1, P2, way) - JOINT.torque(theta, P1, P2)


def follow(held: np.ndarray, rise: np.ndarray, steps: int) -> np.ndarray:
    """The values `held`, each reached from the one before as a lag reaches it."""
    before, now = np.repeat(np.concatenate([held[:1], held[:-1]]), steps), np.repeat(held, steps)
    return before + (now - before) * rise


if __name__ == "__main__":
    rng = np.random.default_rng(2104)
    force_table(rng)
    joint_log(rng)
    motion_log(rng)
    hand_path()
