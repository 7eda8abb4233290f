"""How much faster are many closed loops in compiled code than `simulate`, and do they come out the same?

    python -m benchmarks.many [--runs 1000] [--pairs 12] [--out benchmarks/results/many.md]

Loops of 14 s on the standard real plant: MPC of N = 20 with its observer and all that it is told, a sine with a load
that comes at 9 s. Either all runs have one plant and differ in the noise, or every run has a plant of its own besides:
gains of the muscles, inertia, lags, share of the friction. First `simulate` and `simulate_many` answer the same in
turns, which gives the differences and the ratio of the processor's time on one core; then all runs are made on one
process and on two, which gives the ratio of the wall's.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.files.atomic import write_text
from benchmarks.allocators.machine import machine
from mpc import KalmanObserver, RealPlant, Run, TrackingMPC, Weights, simulate, simulate_many
from mpc.trials.trajectories import rested_sine

LOAD = ((9.0, 1.0),)  # from [s] on, [N·m]
WANTED, WANTED_OF_TWO = 6.0, 2.0  # times as fast as `simulate` on one core, and two cores as one
STATE = np.array([1.0, 10.0, 1e5, 1e5])  # [rad], [rad/s], [Pa]: scales of differences


class Setting(NamedTuple):
    """What all runs have."""

    controller: TrackingMPC
    observer: KalmanObserver


def setting() -> Setting:
    """The controller of the closed-loop benchmark, and its observer."""
    real = RealPlant.standard()
    told = real.known()
    controller = TrackingMPC(real.nominal, weights=Weights.calm(), compensation=told)
    return Setting(controller, KalmanObserver(real.nominal, controller.dt, compensation=told))


def one_plant(runs: int) -> list[RealPlant]:
    """The standard plant, as often."""
    return [RealPlant.standard(torque_profile=LOAD)] * runs


def many_plants(runs: int) -> list[RealPlant]:
    """Plants that differ from the standard one by some per cent in all that a fit may have wrong."""
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
    """The greatest difference of states [1 rad, 10 rad/s, 1 bar] and commands [bar]; inf if a status differs."""
    if (one.status != other.status).any() or (one.rung != other.rung).any():
        return np.inf
    x = np.abs((one.x - other.x) / STATE).max()
    return float(max(x, np.abs(one.u - other.u).max() / STATE[2], np.abs(one.K - other.K).max()))


def ratios(s: Setting, plants: Sequence[RealPlant], pairs: int) -> Iterator[tuple[float, float, float, str]]:
    """Both ways in turns, a batch of runs against one: CPU seconds of a run by either, difference, implementation."""
    reference, batch = rested_sine(), max(len(plants) // pairs, 1)
    for pair in range(min(pairs, len(plants))):
        own = range(pair * batch, (pair + 1) * batch)
        begun = time.process_time()
        alone = simulate(plants[own[0]], s.controller, reference, observer=s.observer, seed=own[0])
        took = time.process_time() - begun
        begun = time.process_time()
        many = simulate_many(
            [plants[i] for i in own], s.controller, reference, observers=s.observer, seeds=own, keep=True
        )
        share = (time.process_time() - begun) / batch
        yield took, share, difference(alone, many[0]), many.implementation[0]


def spread(s: Setting, plants: Sequence[RealPlant], rounds: int) -> list[list[float]]:
    """Wall seconds of all runs on one process and on two, in turns."""
    found = []
    for _ in range(rounds):
        took = []
        for workers in (1, 2):
            begun = time.perf_counter()
            simulate_many(
                plants, s.controller, rested_sine(), observers=s.observer, seeds=range(len(plants)), workers=workers
            )
            took.append(time.perf_counter() - begun)
        found.append(took)
    return found


def report(runs: int, pairs: int, rounds: int) -> Iterator[str]:
    """Lines as they come."""
    s = setting()
    yield (
        "| plants | runs | `simulate`, a run [ms] | `simulate_many` [ms] | ratio on one core | asked | greatest "
        "difference | compiled | one process [s] | two [s] | ratio of two to one | asked |"
    )
    yield "|---" + "|--:" * 11 + "|"
    for name, plants in (("one", one_plant(runs)), ("each its own", many_plants(runs))):
        simulate_many(plants[:1], s.controller, rested_sine(), observers=s.observer)  # compiles
        took, share, differences, made = zip(*ratios(s, plants, pairs), strict=True)
        times = np.array(took) / np.array(share)
        walls = np.array(spread(s, plants, rounds))
        yield (
            f"| {name} | {runs} | {1e3 * np.median(took):.0f} | {1e3 * np.median(share):.1f} | {np.median(times):.1f} "
            f"({times.min():.1f} to {times.max():.1f}) | {WANTED:g} | {max(differences):.1e} | "
            f"{made.count('compiled')} of {len(made)} | {walls[:, 0].min():.1f} | {walls[:, 1].min():.1f} | "
            f"{np.median(walls[:, 0] / walls[:, 1]):.2f} | {WANTED_OF_TWO:g} |"
        )


def main() -> None:
    assert __doc__ is not None
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=100, help="of each kind")
    parser.add_argument("--pairs", type=int, default=10, help="of both ways, in turns")
    parser.add_argument("--rounds", type=int, default=1, help="on one process and on two")
    parser.add_argument("--out", type=Path, help="a .md to write")
    given = parser.parse_args()
    lines = []
    for line in report(given.runs, given.pairs, given.rounds):
        print(line, flush=True)
        lines.append(line)
    if given.out is not None:
        head, rest = __doc__.partition("\n")[::2]
        write_text(given.out, f"# Many runs\n\n{head}\n{rest}\n{machine()}\n\n" + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
