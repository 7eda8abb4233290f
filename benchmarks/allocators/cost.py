"""Costs, and comparison of answers."""

import numpy as np

from benchmarks.allocators.contenders import WEIGHTS, Answer
from benchmarks.allocators.effect import effect
from benchmarks.allocators.targets import Array, Flags, TargetSet

SAME_FIRST = 1e-9  # [N·m], [N·m/rad] tolerance of equal first errors
BETTER_FIRST, BETTER_SECOND = 1e-6, 1e-4  # of max(1, error); [N·m], [N·m/rad]: a greater difference counts


def beats(targets: TargetSet, priority: str, one: Answer, other: Answer) -> Flags:
    """Return whether one answer is better than the other by more than the tolerance."""
    first, second = costs(targets, priority, one)
    other_first, other_second = costs(targets, priority, other)
    better = first < other_first - BETTER_FIRST * np.maximum(1.0, other_first)
    tied = np.abs(first - other_first) < SAME_FIRST
    return np.asarray(better | (tied & (second < other_second - BETTER_SECOND)))


def costs(targets: TargetSet, priority: str, answer: Answer) -> tuple[Array, Array]:
    """Return the first and the second cost."""
    found = effect(targets, answer)
    e_T, e_K = np.abs(found.T - targets.T), np.abs(found.K - targets.K)
    if priority == "weighted":
        w_T, w_K = WEIGHTS
        return w_T * e_T**2 + w_K * e_K**2, np.zeros(e_T.shape)
    return (e_T, e_K) if priority == "torque" else (e_K, e_T)


def unproved(exact: Answer) -> Flags:
    """Return whether the exact answer does not claim to be the global optimum."""
    return np.zeros(exact.P1.shape, bool) if exact.local is None else exact.local
