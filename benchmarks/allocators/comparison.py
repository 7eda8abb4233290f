"""The whole run: every contender on every set with every priority, then the times."""

from dataclasses import dataclass
from itertools import product

from allocator.presentation.progress import counted
from benchmarks.allocators import timing, warm_start
from benchmarks.allocators.contenders import CONTENDERS, EXACT, PRIORITIES
from benchmarks.allocators.measures import Score, score
from benchmarks.allocators.targets import TargetSet, test_sets
from benchmarks.allocators.timing import Time
from benchmarks.allocators.truth import check
from benchmarks.allocators.warm_start import Gain


@dataclass(frozen=True)
class Results:
    """All results."""

    quick: bool
    sets: tuple[TargetSet, ...]
    scores: tuple[Score, ...]
    times: tuple[Time, ...]
    gains: tuple[Gain, ...]


def compare(quick: bool) -> Results:
    """Run everything. Raises BenchmarkFailure at a false claim of an answer."""
    sets, rounds, singles = tuple(test_sets(quick)), 1 if quick else 3, 2 if quick else 40
    each = list(product(sets, PRIORITIES))
    scores = [s for one in counted(each, "feasibility and accuracy") for s in scored(*one)]
    timed = [
        t
        for targets in counted(sets, "time")
        for t in timing.times(targets.thinned(8 if quick else 300), rounds, singles)
    ]
    warm = counted(warm_start.sets(quick), "warm start")
    gains = [g for targets in warm for g in warm_start.gains(targets, rounds)]
    return Results(quick, sets, tuple(scores), tuple(timed), tuple(gains))


def scored(targets: TargetSet, priority: str) -> list[Score]:
    """Check and score all contenders on one set."""
    exact, found = EXACT.answer(targets, priority), []
    for contender in CONTENDERS:
        answer = contender.answer(targets, priority)
        check(targets, priority, contender.name, answer, exact)
        found.append(score(targets, priority, contender.name, answer, exact))
    return found
