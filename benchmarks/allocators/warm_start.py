"""Gain by starting the optimisers at the projected analytic inverse instead of the middle of the box."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.allocators.contenders import BACK_ENDS, EXACT, Allocator
from benchmarks.allocators.targets import JOINTS, TargetSet, feasible_targets, random_targets
from benchmarks.allocators.timing import seconds
from benchmarks.allocators.truth import check


@dataclass(frozen=True)
class Gain:
    """One back-end on one set with and without the warm start, priority "torque"."""

    set: str
    joint: str
    back_end: str
    targets: int
    iterations_warm: float  # mean per target
    iterations_cold: float
    warm_us: float  # per target, median of the rounds
    cold_us: float
    speed_up: float  # median of the ratios cold to warm, round by round
    failed_warm: float  # share
    failed_cold: float


def sets(quick: bool) -> Iterator[TargetSet]:
    """Return a feasible set of targets, and the mixed ones of the comparison."""
    n = 3 if quick else 100
    for seed, joint_name in enumerate(JOINTS, start=100):
        yield feasible_targets(joint_name, n, seed)
        yield random_targets(joint_name, n, seed)


def gains(targets: TargetSet, rounds: int) -> Iterator[Gain]:
    """Return the gains of every back-end, with checked answers."""
    exact = EXACT.answer(targets, "torque")
    for back_end in BACK_ENDS:
        yield gain(targets, back_end, rounds, lambda name, a: check(targets, "torque", name, a, exact))


def gain(targets: TargetSet, back_end: Allocator, rounds: int, checked: Callable[..., None]) -> Gain:
    warm, cold = (back_end.answer(targets, "torque", warm_start=start) for start in (True, False))
    checked(back_end.name, warm)
    checked(f"{back_end.name} without warm start", cold)
    us = np.array([[seconds(back_end, targets, start) for start in (True, False)] for _ in range(rounds)])
    us *= 1e6 / targets.theta.size
    return Gain(
        set=targets.name,
        joint=targets.joint_name,
        back_end=back_end.name,
        targets=targets.theta.size,
        iterations_warm=float(np.mean(warm.iterations)),
        iterations_cold=float(np.mean(cold.iterations)),
        warm_us=float(np.median(us[:, 0])),
        cold_us=float(np.median(us[:, 1])),
        speed_up=float(np.median(us[:, 1] / us[:, 0])),
        failed_warm=float(warm.failed.mean()),
        failed_cold=float(cold.failed.mean()),
    )
