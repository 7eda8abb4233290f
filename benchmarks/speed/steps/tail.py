"""The slowest of many steps: closed loops with random references and loads, on the real plant and on a stranger.

    python -m benchmarks.speed.steps.tail [--steps 100000] [--horizon 20 80] [--rounds 3] [--loop stranger]

Runs take 20 s. A step is the controller's, a sample also has the observer. Times are processor times of the thread.
All runs are made several times with equal results, and every step counts with its least time, because interrupts and
other programs delay different steps each time. The stranger is one of `benchmarks.strangers` with the model of its data
sheet.
"""

import argparse
from collections.abc import Iterator, Sequence
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


class Row(NamedTuple):
    """Times [s] of one loop and horizon at `QUANTILES`."""

    loop: str
    horizon: int
    steps: int
    step: Array
    sample: Array


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


def runs(loop: str, horizon: int, number: int) -> Iterator[tuple[Array, Array, Array]]:
    """Yield the commands (M, 2) [Pa] of each run and the times (M,) of observer and controller [s]."""
    stranger, real = drawn("power", TUNING), RealPlant.standard()
    model, known = data_sheet(stranger)[:2] if loop == "stranger" else (real.nominal, real.known())
    observer = TimedObserver(KalmanObserver(model, DT, compensation=known))
    controller = TimedController(TrackingMPC(model, DT, horizon, compensation=known))
    for seed in range(number):
        load, since = np.random.default_rng([seed, 98]).uniform([-1.0, 4.0], [1.0, 8.0])
        on_real = replace(real, torque_profile=((since, load),))
        process = stranger.loaded(load, since) if loop == "stranger" else on_real
        run = simulate(process, controller, reference(seed), observer=observer, seed=seed)
        yield run.u, np.array(observer.seconds), np.array(controller.seconds)


def measured(loop: str, horizon: int, steps: int, rounds: int) -> Row:
    """Return the least times of every step over the rounds. Raises `BenchmarkFailure` if the rounds differ."""
    number = max(1, round(steps * DT / DURATION))
    found: list[tuple[Array, ...]] = []
    for _ in counted(range(rounds), f"{loop}, N = {horizon}"):
        found.append(tuple(np.concatenate(rows) for rows in zip(*runs(loop, horizon, number), strict=True)))
        if not np.array_equal(found[0][0], found[-1][0]):
            raise BenchmarkFailure("two equal runs gave different commands")
    observer, step = np.min([times for _, *times in found], axis=0)
    return Row(loop, horizon, step.size, np.quantile(step, QUANTILES), np.quantile(step + observer, QUANTILES))


def report(rows: Sequence[Row], rounds: int) -> str:
    """Return the report."""
    lines = ["# The slowest of many steps", "", (__doc__ or "").split("\n\n", 2)[2].strip(), ""]
    lines += [f"{rounds} rounds. Times in µs.", ""]
    lines += ["| loop | N | part | steps | median | 99 % | 99.9 % | 99.99 % | worst |"]
    lines += ["|---|--:|---|--:|--:|--:|--:|--:|--:|"]
    for row in rows:
        for part, times in (("step", row.step), ("sample", row.sample)):
            cells = " | ".join(f"{1e6 * time:.0f}" for time in times)
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
    rows = [measured(loop, N, asked.steps, asked.rounds) for loop in asked.loop or LOOPS for N in asked.horizon]
    write_text(asked.out / "tail.md", text := report(rows, asked.rounds))
    print(text)


if __name__ == "__main__":
    main()
