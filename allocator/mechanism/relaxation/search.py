"""Level after level of problem [M] is solved here for muscles that are not affine, and bounded from below."""

from itertools import pairwise
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import CLOSED_FORM
from allocator.calculus import Array
from allocator.mechanism.batches import Solved, residuals
from allocator.mechanism.problem import BoxProblem
from allocator.mechanism.relaxation.descent import Found, certified, descend, lower
from allocator.mechanism.relaxation.model import Model
from allocator.mechanism.relaxation.tree import close

_BESIDE = 0.35  # of the interval of a muscle's pressure, from its middle
_PARTS = 16  # of a curve, which are enclosed one by one


class Nearby(NamedTuple):
    """`Nearby` is what is found for N problems of K levels."""

    solved: Solved  # its rounds are nodes of the search
    residual: Array  # of optimality nearby (N,)
    costs: Array  # the squared errors of each level (N, K) [cost]
    bounds: Array  # below which no pressures get them, what earlier levels achieve being kept (N, K) [cost]

    @property
    def left(self) -> Array:
        """Return how far a level's cost may be above the least (N,), of 1 + cost."""
        return np.asarray(((self.costs - self.bounds) / (1 + self.costs)).max(axis=1))

    @classmethod
    def of(cls, problem: BoxProblem, solved: Solved) -> Self:
        """Return answers for affine muscles, which are the best; their residuals tell if not."""
        costs = problem.costs(solved.x)
        return cls(solved, residuals(problem, solved), costs, costs)


def solve(problem: BoxProblem, gap: float) -> Nearby:
    """Return pressures whose costs are above the least by `gap`·(1 + cost) at most, unless the search grows too long.

    Raises `InvalidInput` for a force that does not rise with the pressure, or a law that is not smooth.
    """
    model = Model(problem)
    model.check()
    found, N = _descended(model), problem.size
    costs, bounds, nodes = found.costs[:, :-1].copy(), np.zeros((N, found.costs.shape[1] - 1)), np.ones(N, np.int64)
    for i in range(N):
        best = found.of(i)
        if _missed(model, i, best).any():
            best, bounds[i], nodes[i] = _closed(model, i, best, gap)
        found.P[i], costs[i] = best.P[0], best.costs[0, :-1]
    solved, residual = certified(model, found.P)
    return Nearby(solved._replace(rounds=nodes), residual, costs, np.minimum(bounds, costs))


def _descended(model: Model) -> Found:
    """Return the best of descents from the middle and from beside it, muscles in turn high and low.

    Of equally good pressures a descent from the middle alone may end at a saddle: that of a mechanism whose muscles are
    alike is as symmetric as they are.
    """
    every, (lo, hi) = np.arange(model.problem.size), model.bounds
    middle, in_turn = (lo + hi) / 2, np.where(np.arange(lo.shape[1]) % 2, 1.0, -1.0)
    last_two = np.where(np.arange(in_turn.size) >= in_turn.size - 2, in_turn, 0.0)
    found = descend(model, every, middle)
    for pattern in (in_turn, -in_turn, last_two, -last_two):
        other = descend(model, every, middle + _BESIDE * (hi - lo) * pattern)
        better = lower(model, every, other.costs, found.costs)
        for array, new in zip(found, other, strict=True):
            array[better] = new[better]
    return found


def _closed(model: Model, target: int, best: Found, gap: float) -> tuple[Found, Array, int]:
    """Return the best pressures of a target, the lower bounds of its levels (K,), and the number of nodes."""
    bounds, nodes = np.zeros(best.costs.shape[1] - 1), 0
    for k in range(bounds.size):
        if not _missed(model, target, best)[k]:
            continue
        better, bounds[k], more = close(model, target, k, best, gap)
        nodes += more
        if better is not best:
            best = descend(model, np.array([target]), better.P)
    return best, bounds, nodes


def _missed(model: Model, target: int, best: Found) -> NDArray[np.bool_]:
    """Return which levels (K,) of a target have an error that is no rounding."""
    ends = [0, *model.problem.rows[1].tolist()]
    error = np.array([np.abs(best.left[0, a:b]).max(initial=0.0) for a, b in pairwise(ends)])
    return np.asarray(error > CLOSED_FORM.met * model.scale[target])


def furthest(problem: BoxProblem, d: Array) -> Array:
    """Return a bound (N,) that d·y(P) is not above anywhere in the box, for directions d (N, d)."""
    model = Model(problem)
    every = np.arange(problem.size)
    g = (d[:, None, :] @ (model.C if len(model.C) == 1 else model.C[model.posture(every)]))[:, 0]
    found = np.zeros(problem.size)
    for i, curves in enumerate(model.curves):
        here = np.flatnonzero(problem.which == i)
        for j, curve in enumerate(curves):
            corners = np.concatenate(list(curve.parts(_PARTS)))
            found[here] += (g[here, 2 * j : 2 * j + 2] @ corners.T).max(axis=1)
    return found
