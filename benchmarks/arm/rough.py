"""Arm with force errors of 5 %, a load, noise and dead time: the MPC with observer, and PIDs.

    python -m benchmarks.arm.rough mpc | pid [--arm arm26] [--evaluations 50]

tunes the numbers of one of them by Nelder and Mead's method over their logarithms, with one objective for both: the RMS
errors of circle and reach except the second after the load arrives, their swing at rest, and a tenth of the errors in
that second. Tuning uses one plant (seed 11), the report others (1, 2, 3).
"""

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from allocator.units import BAR, DEG
from benchmarks.arm.cases import ARRIVES, DEAD_TIME, DT, load, rough_plant
from benchmarks.arm.pid import ArmPID, Gains
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.observer.base import Differentiator
from mpc.observer.filter import Noise
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import Weights
from mpc.trials.motions.arm_trajectories import circle, reach
from mpc.trials.simulation import Run, in_motion, simulate

TUNED_ON, JUDGED_ON = (11,), (1, 2, 3)
_FINDING = 1.0  # [s] at the beginning and after the load arrives, for its estimation
_LAST = 1.0  # [s] of the reach's last rest, which is judged


@dataclass(frozen=True)
class Figures:
    """The errors of a run [°], at the worst joint."""

    rms: float  # except the second after the beginning and after the load
    found: float  # RMS in the second after the load
    everything: float  # RMS over all
    rest: float  # |mean| in the last second of the reach
    swing: float  # peak to peak there
    rate: float  # RMS of the commands' rate there [bar/s]


def figures(runs: tuple[Run, Run]) -> Figures:
    errors = [(run.theta - run.theta_ref) / DEG for run in runs]
    finding = [(run.t < _FINDING) | ((run.t >= ARRIVES) & (run.t < ARRIVES + _FINDING)) for run in runs]
    loaded = [(run.t >= ARRIVES) & (run.t < ARRIVES + _FINDING) for run in runs]

    def rms(masks: Any) -> float:
        chosen = np.vstack([error[mask] for error, mask in zip(errors, masks, strict=True)])
        return float(np.sqrt(np.mean(chosen**2, axis=0)).max())

    at_rest = errors[1][-round(_LAST / DT) :]
    rate = np.diff(runs[1].u[-round(_LAST / DT) :], axis=0) / BAR / DT
    everywhere = [np.full(mask.shape, True) for mask in finding]
    return Figures(
        rms([~mask for mask in finding]),
        rms(loaded),
        rms(everywhere),
        float(np.abs(at_rest.mean(axis=0)).max()),
        float(np.ptp(at_rest, axis=0).max()),
        float(np.sqrt(np.mean(rate**2))),
    )


class Loop(NamedTuple):
    """Controller and observer."""

    controller: Any
    observer: Any


def mpc(arm: Arm, theta: float, omega: float, rate: float, d_walk: float, pressure_walk: float, N: int = 20) -> Loop:
    """Return the MPC with errors of angle [°], velocity [°/s] and rate [bar/s] of cost ½, and the observer's walks."""
    weights = Weights(theta=1 / (theta * DEG) ** 2, omega=1 / (omega * DEG) ** 2, rate=1 / (rate * BAR) ** 2)
    noise = Noise(theta=0.02 * DEG / 12**0.5, d_walk=d_walk, pressure_walk=pressure_walk * BAR)
    known = Compensation(dead_time=DEAD_TIME)
    return Loop(TrackingMPC(arm, N=N, weights=weights, compensation=known), KalmanObserver(arm, DT, noise, known))


def pid(arm: Arm, **gains: float) -> Loop:
    """Return PIDs with gains P1, I1, D1, P2, …"""
    rows = (np.array([gains[f"{letter}{i + 1}"] for i in range(arm.n)]) for letter in "PID")
    return Loop(ArmPID(arm, DT, Gains(*rows), DEAD_TIME), Differentiator(DT, arm.n))


MPC = {"theta": 0.08, "omega": 10.0, "rate": 1.0, "d_walk": 1.9, "pressure_walk": 0.07}
PID = {
    "arm26": {"P1": 1.5, "I1": 10.0, "D1": 0.6, "P2": 1.2, "I2": 4.0, "D2": 0.1},
    "arm48": {f"{letter}{i + 1}": v / (1 + i) for i in range(4) for letter, v in (("P", 4.0), ("I", 12.0), ("D", 0.3))},
}
"""The numbers from which the search starts."""

TUNED: dict[tuple[str, str], dict[str, float]] = {
    ("MPC", "arm26"): {"theta": 0.234, "omega": 10.07, "rate": 1.526, "d_walk": 2.09, "pressure_walk": 0.00501},
    ("MPC", "arm48"): {"theta": 0.234, "omega": 10.07, "rate": 1.526, "d_walk": 2.09, "pressure_walk": 0.00501},
    ("PID", "arm26"): {"P1": 0.366, "I1": 52.9, "D1": 1.80, "P2": 0.321, "I2": 46.0, "D2": 0.0343},
    ("PID", "arm48"): {
        "P1": 0.191,
        "I1": 17.8,
        "D1": 1.73,
        "P2": 1.25,
        "I2": 8.95,
        "D2": 0.0607,
        "P3": 1.60,
        "I3": 2.37,
        "D3": 0.3,
        "P4": 1.12,
        "I4": 9.30,
        "D4": 0.0994,
    },
}
"""The numbers that it found, by controller and arm; the MPC of arm48 has those of arm26."""


def runs(arm: Arm, loop: Loop, seed: int) -> tuple[Run, Run]:
    """Return runs of the circle and the reach on one plant."""
    tested = rough_plant(arm, seed)
    done = [
        simulate(tested, loop.controller, asked, x0=x0, observer=loop.observer, load=load(arm), seed=seed)
        for asked in (circle(arm, turns=2), reach(arm))
        for x0 in (in_motion(arm, asked),)
    ]
    return done[0], done[1]


def cost(arm: Arm, loop: Loop, seeds: tuple[int, ...] = TUNED_ON) -> float:
    """Return the objective [°]."""
    found = [figures(runs(arm, loop, seed)) for seed in seeds]
    return float(np.mean([min(f.rms + f.swing / 3 + f.found / 10, 20.0) for f in found]))


def tuned(arm: Arm, start: dict[str, float], build: Callable[..., Loop], evaluations: int) -> dict[str, float]:
    """Return the best numbers after so many evaluations."""

    def of(logarithms: Any) -> float:
        numbers = dict(zip(start, np.exp(logarithms).tolist(), strict=True))
        try:
            value = cost(arm, build(arm, **numbers))
        except ValueError:  # unstable: the plant reports a motion that is not finite
            value = 20.0
        print(f"{value:.4f}", ", ".join(f"{name} {v:.4g}" for name, v in numbers.items()), flush=True)
        return value

    begun = np.log(list(start.values()))
    simplex = np.vstack([begun, begun + 0.4 * np.eye(begun.size)])
    found = minimize(of, begun, method="Nelder-Mead", options={"maxfev": evaluations, "initial_simplex": simplex})
    return dict(zip(start, np.exp(found.x).tolist(), strict=True))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("controller", choices=("mpc", "pid"))
    parser.add_argument("--arm", default="arm26")
    parser.add_argument("--evaluations", type=int, default=50)
    given = parser.parse_args()
    arm = Arm.machine(given.arm)
    start, build = (MPC, mpc) if given.controller == "mpc" else (PID[given.arm], pid)
    print("best:", tuned(arm, start, build, given.evaluations))


if __name__ == "__main__":
    main()
