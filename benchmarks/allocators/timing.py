"""Times of answers on a shared machine, of which the ratios count."""

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from benchmarks.allocators.contenders import CONTENDERS, EXACT, Allocator, Inverse
from benchmarks.allocators.targets import TargetSet


@dataclass(frozen=True)
class Time:
    """Time per target of one contender, priority "torque"."""

    set: str
    joint: str
    contender: str
    targets: int
    batch_us: float  # all targets in one call, per target; median of the rounds
    ratio: float  # of it to `exact`, median of the ratios round by round
    single_us: float  # one target a call, median


def times(targets: TargetSet, rounds: int, singles: int) -> Iterator[Time]:
    """Time every contender, in turns, so that a disturbance of the machine affects all of them."""
    for contender in CONTENDERS:  # imports, builds programmes
        seconds(contender, targets.thinned(3))
    batches = {contender.name: np.zeros(rounds) for contender in CONTENDERS}
    for i in range(rounds):
        for contender in CONTENDERS:
            batches[contender.name][i] = seconds(contender, targets) / targets.theta.size
    for contender in CONTENDERS:
        batch = batches[contender.name]
        single = [seconds(contender, one) for one in each(targets.thinned(singles))]
        yield Time(
            set=targets.name,
            joint=targets.joint_name,
            contender=contender.name,
            targets=targets.theta.size,
            batch_us=1e6 * float(np.median(batch)),
            ratio=float(np.median(batch / batches[EXACT.name])),
            single_us=1e6 * float(np.median(single)),
        )


def seconds(contender: Inverse | Allocator, targets: TargetSet, warm_start: bool = True) -> float:
    """Return the wall time of one call."""
    start = perf_counter()
    if isinstance(contender, Allocator):
        contender.allocation(targets, "torque", warm_start)
    else:
        contender.answer(targets, "torque")
    return perf_counter() - start


def each(targets: TargetSet) -> Iterator[TargetSet]:
    """Yield the targets one by one."""
    for i in range(targets.theta.size):
        yield targets.take(slice(i, i + 1))
