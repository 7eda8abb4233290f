"""Answers of one joint against the dense search."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator import Allocation
from tests.exact_everywhere.curves import Image, image
from tests.exact_everywhere.dense_search import Targets
from tests.exact_everywhere.joints import joint_of
from tests.exact_everywhere.judge import PRIORITIES, Verdict, asked, false_intervals, judged
from tests.exact_everywhere.targets import made_targets, random_targets

ANGLES = 200  # with many targets at each, so that the reachable set is sampled once for all of them
INTERVALS = 20  # intervals are searched for one of so many answers


@dataclass(frozen=True)
class Score:
    """Results for one joint with one priority: numbers of answers, unless stated otherwise."""

    muscle: str
    geometry: str
    priority: str
    random: int  # targets
    made: int  # targets made by random pressures
    beaten: int  # by the dense search
    refused: int  # feasible targets
    outside: int  # the box of taut pressures
    false_status: int
    false_intervals: int
    intervals: int  # checked
    unequalled: int  # answers that the dense search did not find
    worst: float  # greatest excess of an answer, in fractions of the scale
    gap: float  # the greatest stated, in fractions of the scale; NaN if none
    several: float  # share of targets met by more than one pair of pressures; NaN if not stated

    @property
    def wrong(self) -> int:
        """Number of wrong answers or claims."""
        return self.beaten + self.refused + self.outside + self.false_status + self.false_intervals


def scores(muscle: str, geometry: str, targets: int) -> Iterator[Score]:
    """Yield one score per priority; `targets` at random, half as many by random pressures, at up to ANGLES angles."""
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(2026)
    angles = min(ANGLES, max(2, targets // 10))
    reach = _reach(joint, angles, rng)
    each = -(-targets // reach.theta.size)
    random, made = random_targets(reach, each, rng), made_targets(joint, reach, -(-each // 2), rng)
    both = Targets(*(np.concatenate(pair) for pair in zip(random, made, strict=True)))
    for priority in PRIORITIES:
        answer = asked(joint, reach, both, priority)
        verdict = judged(joint, reach, both, priority, answer)
        some = both.take(np.arange(0, both.T.size, INTERVALS))
        false = false_intervals(joint, reach, some, asked(joint, reach, some, priority))
        yield _score((muscle, geometry, priority), (random.T.size, made.T.size), verdict, false, answer)


def _reach(joint: Any, angles: int, rng: np.random.Generator) -> Image:
    """Return the image at `angles` random angles at which both cables can be taut."""
    left, right = joint.angle_range
    reach = image(joint, np.sort(rng.uniform(left, right, 3 * angles)))
    return reach.take(np.unique(np.linspace(0, reach.theta.size - 1, angles).astype(int)))


def _score(
    names: tuple[str, str, str], sizes: tuple[int, int], found: Verdict, false: NDArray[np.bool_], answer: Allocation
) -> Score:
    gap, pairs = getattr(answer, "gap", None), getattr(answer, "pairs", None)
    flags = (found.beaten, found.refused, found.outside, found.false_status)
    return Score(
        *names,
        *sizes,
        *(int(flag.sum()) for flag in flags),
        int(false.sum()),
        false.size,
        int(found.unequalled.sum()),
        float(found.excess.max()),
        float("nan") if gap is None else float(np.max(gap)),
        float("nan") if pairs is None else float(np.mean(np.asarray(pairs) > 1)),
    )
