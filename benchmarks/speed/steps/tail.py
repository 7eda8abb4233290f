"""The slowest of many steps: closed loops with random references and loads, on the real plant and on a stranger.

    python -m benchmarks.speed.steps.tail [--steps 100000] [--horizon 20 80] [--rounds 3] [--loop stranger]

Runs take 20 s. A step is the controller's, a sample also has the observer. Times are processor times of the thread.
All runs are made several times with equal results, and every step counts with its least time, because interrupts and
other programs delay different steps each time. Then the runs with the slowest steps are repeated, until their times are
those of the work. Python's garbage collector, which takes 0.2 ms more now and then, is off. The first two samples of a
run, with cold caches and without an active set, have a column of their own. The last column is the worst of a single
round, with all delays. The stranger is one of `benchmarks.strangers` with the model of its data sheet.
"""

import argparse
import gc
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.files.atomic import write_text
from allocator.presentation.progress import counted
from allocator.units import DEG
from benchmarks.allocators.machine import machine
from benchmarks.speed.steps.whole_sample import DT, TimedController, TimedObserver
from benchmarks.speed.truth import BenchmarkFailure
from benchmarks.strangers.identified import data_sheet
from benchmarks.strangers.plants import TUNING, drawn
from mpc import KalmanObserver, RealPlant, Reference, TrackingMPC, simulate

RESULTS = Path(__file__).parents[2] / "results"
DURATION = 20.0  # [s] of a run
QUANTILES = (0.5, 0.99, 0.999, 0.9999, 1.0)
LOOPS = ("real plant", "stranger")
FIRST = 2  # samples of a run that count apart
REPEATS, SLOWEST = 20, 2  # further rounds, and how many runs with the slowest steps and samples they repeat


class Row(NamedTuple):
    """Times [s] of one loop and horizon at `QUANTILES`."""

    loop: str
    horizon: int
    steps: int
    times: Array  # (2, …) of the step and of the sample
    first: Array  # (2,) the worst of the first samples
    once: Array  # (2,) the worst of one round


def reference(seed: int) -> Reference:
    """Return a sine with jumps of the angle and of the stiffness, all at random."""
    rng = np.random.default_rng([seed, 97])
    t = DT * np.arange(round(DURATION / DT) + 1)
    theta = rng.uniform(5, 20) * DEG * np.sin(2 * np.pi * rng.uniform(0.2, 0.8) * t) * np.minimum(t, 1.0)
    K = np.full(t.size, 5.5)
    for at in rng.uniform(1.0, DURATION, 8):
        theta += rng.uniform(-10, 10) * DEG * (t >= at)
        K[t >= at] = rng.uniform(4.0, 8.0)
    return Reference(t, np.clip(theta, -30 * DEG, 30 * DEG), K)


def runs(loop: str, horizon: int, seeds: Iterable[int]) -> Iterator[tuple[Array, Array]]:
    """Yield the commands (M, 2) [Pa] of each run, and the times (2, M) of controller and whole sample [s]."""
    stranger, real = drawn("power", TUNING), RealPlant.standard()
    model, known = data_sheet(stranger)[:2] if loop == "stranger" else (real.nominal, real.known())
    observer = TimedObserver(KalmanObserver(model, DT, compensation=known))
    controller = TimedController(TrackingMPC(model, DT, horizon, compensation=known))
    for seed in seeds:
        load, since = np.random.default_rng([seed, 98]).uniform([-1.0, 4.0], [1.0, 8.0])
        on_real = replace(real, torque_profile=((since, load),))
        process = stranger.loaded(load, since) if loop == "stranger" else on_real
        run = simulate(process, controller, reference(seed), observer=observer, seed=seed)
        step = np.array(controller.seconds)
        yield run.u, np.array([step, step + observer.seconds])


def measured(loop: str, horizon: int, steps: int, rounds: int) -> Row:
    """Return the least times of every step over the rounds. Raises `BenchmarkFailure` if the rounds differ."""
    found: list[tuple[Array, Array]] = [*runs(loop, horizon, range(max(1, round(steps * DT / DURATION))))]
    once = _worst(found).max(axis=0)
    for turn in counted(range(1, rounds + REPEATS), f"{loop}, N = {horizon}"):
        slow = np.argsort(_worst(found, FIRST), axis=0)[-SLOWEST:]
        seeds = [*range(len(found))] if turn < rounds else np.unique(slow).tolist()
        for seed, (u, times) in zip(seeds, runs(loop, horizon, seeds), strict=True):
            if not np.array_equal(found[seed][0], u):
                raise BenchmarkFailure("two equal runs gave different commands")
            found[seed] = u, np.minimum(found[seed][1], times)
    least, first = np.concatenate([times[:, FIRST:] for _, times in found], axis=1), _worst(found, 0, FIRST).max(axis=0)
    return Row(loop, horizon, least.shape[1], np.quantile(least, QUANTILES, axis=1).T, first, once)


def _worst(found: Sequence[tuple[Array, Array]], since: int = 0, until: int | None = None) -> Array:
    """Return the worst times (runs, 2) of these samples of each run."""
    return np.array([times[:, since:until].max(axis=1) for _, times in found])


def report(rows: Sequence[Row], rounds: int) -> str:
    """Return the report."""
    lines = ["# The slowest of many steps", "", (__doc__ or "").split("\n\n", 2)[2].strip(), ""]
    lines += [f"{rounds} round{'s' if rounds > 1 else ''}. Times in µs.", ""]
    lines += ["| loop | N | part | steps | median | 99 % | 99.9 % | 99.99 % | worst | first samples | one round |"]
    lines += ["|---|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|"]
    for row in rows:
        for part, times, *worst in zip(("step", "sample"), row.times, row.first, row.once, strict=True):
            cells = " | ".join(f"{1e6 * time:.0f}" for time in (*times, *worst))
            lines.append(f"| {row.loop} | {row.horizon} | {part} | {row.steps} | {cells} |")
    return "\n".join([*lines, "", f"{machine()}."]) + "\n"


def main() -> None:
    """Run the benchmark and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--horizon", type=int, nargs="+", default=[20, 80])
    parser.add_argument("--loop", choices=LOOPS, action="append", help="only this loop; may be repeated")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report")
    asked = parser.parse_args()
    gc.disable()
    rows = [measured(loop, N, asked.steps, asked.rounds) for loop in asked.loop or LOOPS for N in asked.horizon]
    write_text(asked.out / "tail.md", text := report(rows, asked.rounds))
    print(text)


if __name__ == "__main__":
    main()
