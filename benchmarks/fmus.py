"""Deviation of the FMUs of a plant and of a controller from Python, step by step.

    python -m benchmarks.fmus [--steps 10000]

The plant gets commands and torques with jumps, the controller the inputs of Python's controller in a closed loop on the
real plant of the closed-loop benchmark, without faults. Both FMUs are validated and stepped by FMPy.
"""

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from fmpy.validation import validate_fmu

from mpc import KalmanObserver, RealPlant, TrackingMPC, Weights, sine
from mpc.export.fmu.entry import export_controller_fmu, export_plant_fmu
from tests.rigs.fmus import Stepped
from tests.rigs.replay import record

SPAN = 5e5  # [Pa]
SCALE = np.array([1.0, 10.0, SPAN, SPAN])


def plant(directory: Path, steps: int) -> float:
    """Return the greatest difference of a state, as a share of (1 rad, 10 rad/s, 5 bar, 5 bar)."""
    real, dt = RealPlant.standard(), 0.01
    x0, rng, worst = real.at_rest(0.1, 5.5), np.random.default_rng(0), 0.0
    path = export_plant_fmu(directory / "plant.fmu", real, dt, x0=x0)
    print(f"plant: validation says {validate_fmu(str(path)) or 'nothing'}")
    experiment = real.begin(dt, x0, 0)
    with Stepped(path, directory / "plant", dt) as fmu:
        for k in range(steps):
            if k % 20 == 0:
                u, d = rng.uniform(1e5, 4e5, 2), float(rng.normal())
                fmu.set(u1=u[0], u2=u[1], d=d)
            experiment.advance(u, d)
            fmu.step()
            worst = max(worst, *np.abs((np.array(fmu.get("theta", "omega", "P1", "P2")) - experiment.x) / SCALE))
    return worst


def controller(directory: Path, steps: int) -> tuple[np.ndarray, int]:
    """Return the differences of the commands, as shares of 5 bar, and the number of steps with another status."""
    real = RealPlant.standard()
    told = {"compensation": real.known()}
    made = TrackingMPC(real.nominal, N=10, weights=Weights.calm(), **told)
    observer = KalmanObserver(real.nominal, made.dt, **told)
    done = record(real, made, observer, sine(K=5.5, duration=steps * made.dt))
    path = export_controller_fmu(directory / "controller.fmu", made, observer)
    print(f"controller: validation says {validate_fmu(str(path)) or 'nothing'}")
    differences, others = [], 0
    ahead = made.ahead + 1
    with Stepped(path, directory / "controller", made.dt) as fmu:
        for sample, answer in zip(done.samples, done.answers, strict=True):
            theta, P1, P2 = sample[:3]
            fmu.set(theta=theta, P1=P1, P2=P2, theta_ref=sample[4 : 4 + ahead], K_ref=sample[4 + ahead :])
            fmu.step()
            u1, u2, *decided = fmu.get("u1", "u2", "status", "rung")
            differences.append(np.abs(np.array([u1, u2]) - answer[:2]).max() / SPAN)
            others += decided != answer[2:4].tolist()
    print(f"controller: rungs in Python {dict(Counter(done.answers[:, 3].astype(int).tolist()))}")
    return np.array(differences), others


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10_000)
    steps = parser.parse_args(arguments).steps
    with tempfile.TemporaryDirectory() as made:
        print(f"plant: {steps} steps, greatest difference {plant(Path(made), steps):.2e} of the scale")
        differences, others = controller(Path(made), steps)
        print(
            f"controller: {len(differences)} steps, {others} with another status or rung; difference of a command "
            f"{np.median(differences):.1e} of the supply in the median, {np.quantile(differences, 0.99):.1e} for 99 %, "
            f"{differences.max():.1e} at worst"
        )


if __name__ == "__main__":
    main()
