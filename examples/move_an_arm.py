"""Move an arm of six pneumatic muscles on MuJoCo: `pip install 'antagonist[mujoco]'`, then `python move_an_arm.py`.

The arm is put together here of what could be yours: muscles, moment arms, links. It follows a reach from one side to
the other with a stiffness matrix of your choice, and writes arm.csv and arm.png into the current folder.
"""

import numpy as np

from allocator.mechanism import Mechanism, Pulleys
from allocator.muscles import SAROSI_DMSP_20_400N
from mpc import Arm, Reference, TrackingMPC, metrics, simulate
from mpc.arm import Bodies, MujocoPlant
from mpc.trials import save_run, save_tracking_figure

ARMS = [[0.02, 0.0], [-0.02, 0.0], [0.0, 0.02], [0.0, -0.02], [0.02, 0.015], [-0.02, -0.015]]  # [m], a row a muscle
STIFFNESS = np.array([[12.0, 4.6], [4.6, 9.5]])  # [N·m/rad]


def reach(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """From (-0.3, 0.5) to (0.3, 0.1) rad in a second, along a minimum-jerk curve, after half a second of rest."""
    s = np.clip(t - 0.5, 0.0, 1.0)[:, None]
    done = s**3 * (10 - 15 * s + 6 * s**2)
    return (1 - done) * [-0.3, 0.5] + done * [0.3, 0.1], np.tile(STIFFNESS, (t.size, 1, 1))


def main() -> None:
    limits = ((-1.0, 1.0), (-1.0, 1.0))  # [rad]
    mechanism = Mechanism(Pulleys(0.40, ARMS, 0.1375), SAROSI_DMSP_20_400N, angle_limits=limits)
    bodies = Bodies.rods(length=(0.31, 0.34), mass=(1.2, 0.8), damping=0.25)
    arm = Arm(mechanism, bodies, lag=0.1, slew=5e5)  # lag of the regulators [s], slew [Pa/s]
    run = simulate(MujocoPlant.of(arm), TrackingMPC(arm), Reference.of("reach", 2.5, reach))
    figures = metrics(run)
    print(f"angle RMS {figures.theta_rms.round(4)}°, worst {figures.theta_worst.round(3)}°")
    print(f"stiffness RMS {figures.K_rms.max():.3g} N·m/rad, limits kept: {figures.limits_kept}")
    save_run(run, "arm.csv")
    save_tracking_figure(run, "arm.png")


if __name__ == "__main__":
    main()
