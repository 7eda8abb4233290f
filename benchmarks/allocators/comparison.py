"""The whole run: every contender on every set with every priority, then the times."""

from collections.abc import Callable
from dataclasses import dataclass

from rich.progress import Progress

from benchmarks.allocators import timing, warm_start
from benchmarks.allocators.contenders import BACK_ENDS, CONTENDERS, EXACT, PRIORITIES
from benchmarks.allocators.measures import Score, score
from benchmarks.allocators.targets import JOINTS, TargetSet, test_sets
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


def compare(quick: bool, progress: Progress) -> Results:
    """Run everything. Raises BenchmarkFailure at a false claim of an answer."""
    sets, rounds, singles = tuple(test_sets(quick)), 1 if quick else 3, 2 if quick else 40

    def ticker(title: str, steps: int) -> Callable[[], None]:
        task = progress.add_task(title, total=steps)
        return lambda: progress.advance(task)

    tick = ticker("feasibility and accuracy", len(sets) * len(PRIORITIES) * len(CONTENDERS))
    scores = [s for targets in sets for priority in PRIORITIES for s in scored(targets, priority, tick)]
    tick = ticker("time", len(sets) * (rounds + 1) * len(CONTENDERS))
    timed = [t for targets in sets for t in timing.times(targets.thinned(8 if quick else 300), rounds, singles, tick)]
    tick = ticker("warm start", 2 * len(JOINTS) * len(BACK_ENDS))
    gains = [g for targets in warm_start.sets(quick) for g in warm_start.gains(targets, rounds, tick)]
    return Results(quick, sets, tuple(scores), tuple(timed), tuple(gains))


def scored(targets: TargetSet, priority: str, tick: Callable[[], None]) -> list[Score]:
    """Check and score all contenders on one set."""
    exact, found = EXACT.answer(targets, priority), []
    for contender in CONTENDERS:
        answer = contender.answer(targets, priority)
        check(targets, priority, contender.name, answer, exact)
        found.append(score(targets, priority, contender.name, answer, exact))
        tick()
    return found
