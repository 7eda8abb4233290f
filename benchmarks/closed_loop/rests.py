"""Rests of a loop, and the cost of the rest mode in motion. `python -m benchmarks.closed_loop.rests --help`.

A move of 60°, followed by a rest of 24 s with an unmodelled load of 1 N·m from its 4 s on. A run is quiet if from 6 s
after the load its angle moves by at most 0.05° peak to peak and each command changes by at most 0.02 bar/s RMS. The
tracking errors with and without the rest mode are those of the closed-loop benchmark.
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.presentation.progress import counted
from allocator.units import BAR, DEG
from benchmarks.closed_loop.cases import CASES, LOAD, MODEL, SETTINGS, STANDARD
from benchmarks.closed_loop.runs import figures, run_case
from mpc import Plant, RealPlant, Reference, Weights, simulate
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.trajectories import point_to_point

LOADED, SETTLED, END = 9.0, 6.0, 29.0  # [s] onset of the load; wait after it; end of the run
SWING, RATE = 0.05, 0.02  # [°], [bar/s]
FIRST_SEED, SEEDS, FEW = 3001, 10, 6
GAINS = {"standard": (1.1, 0.9), "gains swapped": (0.9, 1.1), "both +10 %": (1.1, 1.1)}
RESULT = Path(__file__).parents[1] / "results" / "rests.md"


def plants() -> dict[str, RealPlant]:
    """Return the plants by name; controllers have the assumptions of the standard one."""
    tondu = RealPlant.standard(nominal=Plant(lag=MODEL.lag))  # the report's muscles
    alike = {name: replace(STANDARD, force_gains=gains) for name, gains in GAINS.items()} | {"report's muscles": tondu}
    dahl = {
        f"{name}, Dahl friction": replace(real, friction=real.friction.as_dahl(real.nominal))
        for name, real in alike.items()
        if isinstance(real.friction, MaxwellSlip)
    }
    return alike | dahl | {"friction removed": replace(STANDARD, friction=Friction())}


class Rested(NamedTuple):
    """Run from SETTLED after the load."""

    swing: float  # [°] peak to peak
    rate: float  # [bar/s] RMS rate of the busier command
    mean: float  # [°] magnitude of the mean error

    @property
    def quiet(self) -> bool:
        """Whether it came to rest."""
        return self.swing <= SWING and self.rate <= RATE


def rests(name: str) -> tuple[str, list[Rested]]:
    """Return the runs on one plant, by its name."""
    real = replace(plants()[name], torque_profile=((LOADED, LOAD),))
    known = RealPlant.standard(nominal=real.nominal).known()
    driver = loop("mpc", Settings(real.nominal, compensation=known, weights=Weights.calm()))
    long = point_to_point(rest=END)
    end = int(np.searchsorted(long.t, END)) + 1
    reference = Reference(long.t[:end], long.theta[:end], long.K[:end])
    found = []
    for seed in range(FIRST_SEED, FIRST_SEED + SEEDS):
        run = simulate(real, driver[0], reference, observer=driver[1], seed=seed)
        begin = round((LOADED + SETTLED) / run.dt)
        error = (run.theta - run.theta_ref)[begin:] / DEG
        rates = np.sqrt(np.mean((np.diff(run.u[begin:], axis=0) / run.dt / BAR) ** 2, axis=0))
        found.append(Rested(float(np.ptp(error)), float(rates.max()), abs(float(error.mean()))))
    return name, found


class Cost(NamedTuple):
    """Mean RMS errors of a trajectory over the seeds, without rest mode and with it [°]."""

    plant: str
    case: str
    alone: tuple[float, float]  # before the load
    loaded: tuple[float, float]  # with it


def costs(name: str) -> list[Cost]:
    """Return the costs of the rest mode on one plant, by its name."""
    real, errors = plants()[name], {}
    for rest in (False, True):
        driver, observer = loop("mpc", SETTINGS)
        driver.rest = rest  # type: ignore[attr-defined]  # of TrackingMPC
        for case in CASES:
            runs = [run_case(real, CASES[case], driver, observer, FIRST_SEED + k) for k in range(FEW)]
            told = [figures(case, run) for run in runs]
            errors[case, rest] = [np.mean([f.rms for f in told]), np.mean([f.rms_with_load for f in told])]
    return [
        Cost(name, case, *((float(errors[case, False][i]), float(errors[case, True][i])) for i in (0, 1)))
        for case in CASES
    ]


def markdown(rested: list[tuple[str, list[Rested]]], cost: list[Cost]) -> Iterator[str]:
    """Yield the report."""
    yield "# Rests\n\n" + (__doc__ or "").partition("\n\n")[2]
    yield "Median, worst over the runs:\n\n| plant | quiet runs | swing [°] | rate [bar/s] | mean error [°] |"
    yield "|---|---|---|---|---|"
    for name, runs in rested:
        columns = [np.array([getattr(run, field) for run in runs]) for field in Rested._fields]
        numbers = " | ".join(f"{np.median(column):.3f}, {column.max():.3f}" for column in columns)
        yield f"| {name} | {sum(run.quiet for run in runs)} of {len(runs)} | {numbers} |"
    yield f"\nRMS errors of the angle [°] without → with rest mode, {FEW} seeds:\n"
    yield "| plant | trajectory | before the load | to the end, with load |\n|---|---|---|---|"
    for row in cost:
        pairs = (f"{off:.3f} → {on:.3f} ({on / off - 1:+.1%})" for off, on in (row.alone, row.loaded))
        yield f"| {row.plant} | {row.case} | {' | '.join(pairs)} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.closed_loop.rests", description=(__doc__ or "").partition(".")[0]
    )
    parser.add_argument("--out", type=Path, default=RESULT)
    parser.add_argument("--processes", type=int, default=2)
    given = parser.parse_args()
    moving = [f"{gains}{name}" for name in ("", ", Dahl friction") for gains in GAINS]
    with ProcessPoolExecutor(given.processes) as pool:
        rested = [*counted(pool.map(rests, plants()), "rests", len(plants()))]
        cost = [row for rows in counted(pool.map(costs, moving), "motions", len(moving)) for row in rows]
    text = "\n".join(markdown(rested, cost)) + "\n"
    given.out.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
