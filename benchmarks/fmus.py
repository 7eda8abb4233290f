"""Deviation of the FMUs of a plant and of a controller from Python, step by step.

    python -m benchmarks.fmus [--steps 10000] [--machine arm26]

The plant gets commands and torques with jumps, the controller the inputs of Python's controller in the closed loop of
`benchmarks.speed.exported`, with faults. All FMUs are validated and stepped by FMPy.
"""

import argparse
import tempfile
from collections import Counter
from pathlib import Path

import numpy as np
from fmpy.validation import validate_fmu

from benchmarks.speed.exported import loop
from mpc import Arm, RealPlant
from mpc.export.fmu import export_controller_fmu, export_plant_fmu
from mpc.export.plant import start_of
from mpc.model.friction.dahl import Friction
from mpc.model.real import RealArm
from mpc.model.real_experiment import RealMachine
from tests.rigs.fmus import Stepped, names

SPAN = 5e5  # [Pa]
FRICTION = Friction(0.1, 0.2)


def plant(directory: Path, steps: int, machine: str = "") -> float:
    """Return the greatest difference of a state, as a share of 1 rad, 10 rad/s and 5 bar."""
    real, dt = real_machine(machine), 0.01
    x0, rng, worst = start_of(real), np.random.default_rng(0), 0.0
    n, m = real.nominal.n, real.nominal.m
    (states, valves, torques), scale = names(n, m), np.repeat([1.0, 10.0, SPAN], [n, n, m])
    path = export_plant_fmu(directory / "plant.fmu", real, dt, x0=x0)
    print(f"{machine or 'plant'}: validation says {validate_fmu(str(path)) or 'nothing'}")
    experiment = real.begin(dt, x0, 0)
    with Stepped(path, directory / "plant", dt) as fmu:
        for k in range(steps):
            if k % 20 == 0:
                u, d = rng.uniform(1e5, 4e5, m), rng.normal(size=n)
                fmu.set(**dict(zip([*valves, *torques], [*u, *d], strict=True)))
            experiment.advance(u, d)
            fmu.step()
            worst = max(worst, *np.abs((np.array(fmu.get(*states)) - experiment.x) / scale))
    return worst


def real_machine(name: str) -> RealMachine:
    """Return the joint of the closed-loop benchmark, or the arm of this name with friction, dead time and encoders."""
    if not name:
        return RealPlant.standard()
    return RealArm(Arm.machine(name), friction=FRICTION, dead_time=0.025, encoder=3e-4, mass=1.2)


def controller(directory: Path, steps: int, machine: str = "") -> tuple[np.ndarray, int]:
    """Return the differences of the commands, as shares of 5 bar, and the number of steps with another status."""
    made, observer, done = loop(10, steps, machine)
    n, m = made.plant.n, made.plant.m
    path = export_controller_fmu(directory / "controller.fmu", made, observer)
    print(f"{machine or 'controller'}: validation says {validate_fmu(str(path)) or 'nothing'}")
    angles = ["theta"] if n == 1 else [f"theta{i}" for i in range(1, n + 1)]
    inputs = [*angles, *(f"P{i}" for i in range(1, m + 1))]
    outputs = [*(f"u{i}" for i in range(1, m + 1)), "status", "rung"]
    preview, differences, others = n * (made.ahead + 1), [], 0
    with Stepped(path, directory / "controller", made.dt) as fmu:
        for sample, answer in zip(done.samples, done.answers, strict=True):
            asked = sample[n + m + 1 :]
            rows = {"theta_ref": asked[:preview], "K_ref": asked[preview:]}
            fmu.set(**dict(zip(inputs, sample, strict=False)), **rows)
            fmu.step()
            found = np.array(fmu.get(*outputs))
            differences.append(np.abs(found[:m] - answer[:m]).max() / SPAN)
            others += (found[m:] != answer[m : m + 2]).any()
    rungs = dict(Counter(done.answers[:, m + 1].astype(int).tolist()))
    print(f"{machine or 'controller'}: rungs in Python {rungs}")
    return np.array(differences), others


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=10_000)
    parser.add_argument("--machine", default="", help="a ready-made arm; by default a joint")
    asked = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as made:
        worst = plant(Path(made), asked.steps, asked.machine)
        print(f"{asked.machine or 'plant'}: {asked.steps} steps, greatest difference {worst:.2e} of the scale")
        differences, others = controller(Path(made), asked.steps, asked.machine)
        print(
            f"{asked.machine or 'controller'}: {len(differences)} steps, {others} with another status or rung; "
            f"difference of a command {np.median(differences):.1e} of the supply in the median, "
            f"{np.quantile(differences, 0.99):.1e} for 99 %, {differences.max():.1e} at worst"
        )


if __name__ == "__main__":
    main()
