"""An afternoon on a simulated board in real time: sweep, fit, and min-jerk at 100 Hz, over a pseudo-terminal.

    python -m benchmarks.board_afternoon [--motion 40] [--timeout 0.02]

The board is the exported C, compiled for this machine; its joint has unknown muscles, lags and inertia, and the effects
of a bench. It takes about five minutes.
"""

import argparse
import subprocess
import sys
import tempfile
from pathlib import Path

from allocator.units import DEG
from mpc import Compensation, Plant
from mpc.trials.metrics import metrics
from tests.rigs.afternoon import GEOMETRY, HIDDEN, Afternoon


def antagonist(*arguments: object) -> None:
    subprocess.run([sys.executable, "-m", "mpc", *map(str, arguments)], check=True, stdout=subprocess.DEVNULL)


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--motion", type=int, default=40)
    parser.add_argument("--timeout", type=float, default=0.02)
    given = parser.parse_args(arguments)
    afternoon = Afternoon(real_time=True, timeout=given.timeout, flags=("-O2",))
    with tempfile.TemporaryDirectory() as made:
        directory = Path(made)
        swept = afternoon.sweep(directory, given.motion)
        print(f"sweep at 50 Hz: {swept.ending}; {swept.lateness}", flush=True)
        joint, plant = directory / "joint.toml", directory / "plant.toml"
        antagonist("fit-joint", directory / "joint_log.csv", *GEOMETRY, "--out", joint)
        antagonist("fit-motion", directory / "motion_log.csv", "--machine", joint, "--out", plant)
        found = Plant.load(plant)
        known = Compensation.load(plant)
        lags = (f"{one:.3g} and {two:.3g} s" for one, two in (found.lag, HIDDEN.lag))
        print(f"fit: lags {next(lags)}, true {next(lags)}; {known.summary}", flush=True)
        record = afternoon.run(found, known, directory / "run.csv")
        print(f"run at 100 Hz: {record.ending}; {record.lateness}")
        figures = metrics(record.run())
        print(
            f"theta: {record.theta_rms / DEG:.2f}° RMS as measured, {figures.after_rest.theta_rms:.2f}° RMS after the "
            f"first rest; limits {'kept' if figures.limits_kept else f'broken: {figures.violations}'}"
        )


if __name__ == "__main__":
    main()
