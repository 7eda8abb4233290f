"""Speed of many closed loops in compiled code against `simulate`, and equality of the results.

    python -m benchmarks.many [--runs 1000] [--pairs 20] [--out benchmarks/results]

Loops of 14 s on the standard real plant: MPC of N = 20 with its observer and compensation, a sine with a load that
comes at 9 s. Either all runs have one plant and differ in the noise, or every run also has its own plant: gains of the
muscles, inertia, lags, share of the friction.

All runs are made by one process, in as many batches as there are pairs. Before each batch its first run is also made by
`simulate`: the results must be equal, or nothing is written. This gives the ratio of processor times per run, batch by
batch. Then all runs are made again by two processes, which gives the ratio of wall times, in one call including the
start. Two columns show the possible gain: the work of both processes as a multiple of that of one, and the speed-up of
hashing by two threads, which on a busy machine is below 2.
"""

import argparse
import csv
import os
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.files.atomic import write_text
from allocator.presentation.progress import counted
from benchmarks.allocators.machine import machine
from benchmarks.speed.allocation import machine_threads
from benchmarks.speed.truth import BenchmarkFailure
from mpc import KalmanObserver, RealPlant, Run, TrackingMPC, Weights, simulate, simulate_many
from mpc.trials.motions.trajectories import rested_sine

LOAD = ((9.0, 1.0),)  # from [s] on, [N·m]
RESULTS = Path(__file__).parent / "results"
WANTED, WANTED_OF_TWO = 6.0, 2.0  # required speed-ups: over `simulate` on one core, and of two processes over one
SAME = 1e-9  # of the differences
STATE = np.array([1.0, 10.0, 1e5, 1e5])  # [rad], [rad/s], [Pa]: scales of differences


class Setting(NamedTuple):
    """Common setting of all runs."""

    controller: TrackingMPC
    observer: KalmanObserver


def setting() -> Setting:
    """Return the controller of the closed-loop benchmark, and its observer."""
    real = RealPlant.standard()
    told = real.known()
    controller = TrackingMPC(real.nominal, weights=Weights.calm(), compensation=told)
    return Setting(controller, KalmanObserver(real.nominal, controller.dt, compensation=told))


def one_plant(runs: int) -> list[RealPlant]:
    """Return the standard plant, so many times."""
    return [RealPlant.standard(torque_profile=LOAD)] * runs


def many_plants(runs: int) -> list[RealPlant]:
    """Return plants that differ from the standard one by a few per cent in all fitted quantities."""
    rng, standard = np.random.default_rng(1), RealPlant.standard(torque_profile=LOAD)
    found = []
    for _ in range(runs):
        gains, inertia, lag, share = rng.normal(1, 0.05, 2), *rng.normal(1, 0.05, 2), rng.uniform(0.7, 1.3)
        nominal = standard.nominal
        nominal = replace(nominal, inertia=inertia * nominal.inertia, lag=(lag * 0.12, lag * 0.12))
        varied = replace(standard, nominal=nominal, friction=standard.friction.share(float(share)))
        found.append(replace(varied, force_gains=tuple(gains.tolist())))
    return found


def difference(one: Run, other: Run) -> float:
    """Return the greatest difference of states [1 rad, 10 rad/s, 1 bar] and commands [bar]; inf if a status differs."""
    if (one.status != other.status).any() or (one.rung != other.rung).any():
        return np.inf
    x = np.abs((one.x - other.x) / STATE).max()
    return float(max(x, np.abs(one.u - other.u).max() / STATE[2], np.abs(one.K - other.K).max()))


class Pair(NamedTuple):
    """Run by `simulate`, and the batch that begins with it."""

    alone: float  # [s] of the processor
    share: float  # [s] of the processor, of one run of the batch
    batch: float  # [s] of the processor, of all of it
    wall: float  # [s] of the batch
    difference: float
    compiled: int  # runs of the batch


class Row(NamedTuple):
    """Row of the table for one kind of plants."""

    plants: str
    runs: int
    pairs: int
    simulate: float  # [s] a run
    simulate_many: float  # [s] a run
    ratio: float  # on one core; median of the pairs
    least: float
    most: float
    difference: float  # greatest
    compiled: int  # runs
    one: float  # [s] of all runs on one process
    two: float  # [s] on two
    of_two: float  # ratio of both
    work: float  # processor time of two processes over that of one
    machine: float  # gain of hashing by a second thread


def pairs_of(s: Setting, plants: Sequence[RealPlant], number: int) -> Iterator[Pair]:
    """Make all runs, in so many batches, and one of each by `simulate` before it."""
    reference = rested_sine()
    for own in np.array_split(np.arange(len(plants)), min(number, len(plants))):
        first, seeds = plants[own[0]], own.tolist()
        begun = time.process_time()
        alone = simulate(first, s.controller, reference, observer=s.observer, seed=seeds[0])
        took, begun, wall = time.process_time() - begun, time.process_time(), time.perf_counter()
        batch = [plants[i] for i in seeds]
        many = simulate_many(batch, s.controller, reference, observers=s.observer, seeds=seeds, keep=True)
        worked, wall = time.process_time() - begun, time.perf_counter() - wall
        compiled = many.implementation.count("compiled")
        yield Pair(took, worked / own.size, worked, wall, difference(alone, many[0]), compiled)


def by_two(s: Setting, plants: Sequence[RealPlant]) -> tuple[float, float]:
    """Make all runs by two processes; return the wall time and the processors' time [s]."""
    begun, worked = time.perf_counter(), sum(os.times()[:4])
    shared = {"observers": s.observer, "seeds": range(len(plants)), "workers": 2, "progress": True}
    simulate_many(plants, s.controller, rested_sine(), **shared)
    return time.perf_counter() - begun, sum(os.times()[:4]) - worked


def measured(name: str, s: Setting, plants: Sequence[RealPlant], pairs: int) -> Row:
    """Make all runs of one kind of plants. Raises `BenchmarkFailure` if the results differ."""
    simulate_many(plants[:1], s.controller, rested_sine(), observers=s.observer)  # compiles
    found = [*counted(pairs_of(s, plants, pairs), "runs", min(pairs, len(plants)))]
    alone, share, batches, walls, differences, compiled = map(np.array, zip(*found, strict=True))
    if not (worst := differences.max()) <= SAME:
        raise BenchmarkFailure(f"plants: {name}: `simulate` and `simulate_many` differ by {worst:.1e}, over {SAME:g}")
    ratios, one, (two, worked) = alone / share, float(walls.sum()), by_two(s, plants)
    own, spread = (float(np.median(alone)), float(np.median(share))), (float(ratios.min()), float(ratios.max()))
    counts = len(plants), len(found)
    rest = float(worst), int(compiled.sum()), one, two, one / two, worked / float(batches.sum())
    return Row(name, *counts, *own, float(np.median(ratios)), *spread, *rest, machine_threads(3).ratio)


HEADER = (
    "| plants | runs, of these by both ways | `simulate`, a run [ms] | `simulate_many` [ms] | ratio on one core | "
    "asked | greatest difference | compiled | one process [s] | two [s] | ratio | asked | work | "
    "hashing |"
)


def line(row: Row) -> str:
    """Return a row of the table."""
    ratio, of_two = (f"{x:.2f}{'' if x >= wanted else ', missed'}" for x, wanted in asked(row))
    return (
        f"| {row.plants} | {row.runs}, {row.pairs} | {1e3 * row.simulate:.0f} | {1e3 * row.simulate_many:.1f} | "
        f"{ratio} ({row.least:.1f} to {row.most:.1f}) | {WANTED:g} | {row.difference:.1e} | {row.compiled} | "
        f"{row.one:.1f} | {row.two:.1f} | {of_two} | {WANTED_OF_TWO:g} | {row.work:.2f} | "
        f"{row.machine:.2f} |"
    )


def asked(row: Row) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return both ratios with their requirements."""
    return (row.ratio, WANTED), (row.of_two, WANTED_OF_TWO)


def write(rows: Sequence[Row], folder: Path) -> None:
    """Write `many.md` and `many.csv`."""
    assert __doc__ is not None
    question, _, text = __doc__.partition("\n")
    table = "\n".join([HEADER, "|---" + "|--:" * HEADER.count(" | ") + "|", *map(line, rows)])
    write_text(folder / "many.md", f"# Many runs\n\n{question}\n{text}\n{table}\n\n{machine()}.\n")
    with (folder / "many.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows(rows)


def main() -> int:
    """Measure, print and write; return 1 if the results differ."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.many", description="Time many closed loops.")
    parser.add_argument("--runs", type=int, default=1000, help="of each kind")
    parser.add_argument("--pairs", type=int, default=20, help="of these, by `simulate` too")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of many.md and many.csv")
    given = parser.parse_args()
    s, rows = setting(), []
    print(HEADER)
    try:
        for name, plants in (("one", one_plant(given.runs)), ("each its own", many_plants(given.runs))):
            rows.append(measured(name, s, plants, given.pairs))
            print(line(rows[-1]), flush=True)
    except BenchmarkFailure as failure:
        print(f"Stopped, nothing written: {failure}")
        return 1
    given.out.mkdir(parents=True, exist_ok=True)
    write(rows, given.out)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
