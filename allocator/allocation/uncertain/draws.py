"""Force limits kept in draws of uncertain muscle parameters."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np

from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.spread import roots
from allocator.calculus import Array
from allocator.joint.limits import Limit, PressureBox, PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import TableMuscle
from allocator.units import BAR

_FEWEST, _MOST = 12, 16  # powers of two: numbers of draws
_BEYOND = 64  # least number of draws beyond the quantile
_AT_ONCE = 2_000_000  # forces in memory


def sampled_box(problem: Problem, risk_of_one: float) -> PressureBox:
    """Return the pressures that keep the limits without forces, and every force limit in the draws."""
    box, limits = problem.box_without_forces, problem.limits
    if limits.min_force is None and limits.max_force is None:
        return box
    sides = zip(problem.sides, roots(problem.joint), box, (Limit.AGONIST_SLACK, Limit.ANTAGONIST_SLACK), strict=True)
    one, two = (
        _narrowed_by_draws(problem, side, root, interval, risk_of_one, slack) for side, root, interval, slack in sides
    )
    return replace(box, agonist=one, antagonist=two)


def _narrowed_by_draws(
    problem: Problem, side: OneMuscle, root: Array, interval: PressureInterval, risk: float, slack: Limit
) -> PressureInterval:
    if isinstance(side.muscle, TableMuscle) or not root.any():
        return interval  # linear in its parameters: the first order is exact
    lo, hi = (np.broadcast_to(end, problem.theta.shape).astype(float) for end in (interval.lo, interval.hi))
    lo_limit, hi_limit = interval.lo_limit, interval.hi_limit
    ceiling = Limit.AGONIST_FORCE if slack is Limit.AGONIST_SLACK else Limit.ANTAGONIST_FORCE
    if (least := problem.limits.min_force) is not None:
        bound = np.concatenate([_upper(low, risk) for low in _least_pressures(side, root, risk, least)])
        lo_limit, lo = np.where(bound > lo, np.int32(slack), lo_limit), np.clip(bound, lo, hi + BAR)
    if (greatest := problem.limits.max_force) is not None:
        bound = np.concatenate([-_upper(-high, risk) for high in _greatest_pressures(side, root, risk, greatest)])
        hi_limit, hi = np.where(bound < hi, np.int32(ceiling), hi_limit), np.clip(bound, lo - BAR, hi)
    return replace(interval, lo=lo, hi=hi, lo_limit=lo_limit, hi_limit=hi_limit, empty=interval.empty | (lo > hi))


def _upper(bounds: Array, risk: float) -> Array:
    """Return the bound (n,) that all but the share `risk` of the draws (N, n) are below, to the safe side."""
    N = len(bounds)
    beyond = max(int(N * risk - np.sqrt(N * risk)), 0)
    return np.asarray(np.partition(bounds, N - 1 - beyond, axis=0)[N - 1 - beyond])


def _least_pressures(side: OneMuscle, root: Array, risk: float, least: float) -> Iterator[Array]:
    for A, B in _drawn(side, root, risk):
        with np.errstate(all="ignore"):
            P = np.where(A > 0, (least - B) / A, np.where(B < least, np.inf, -np.inf))
        yield np.where(np.isnan(P), np.inf, P)


def _greatest_pressures(side: OneMuscle, root: Array, risk: float, greatest: float) -> Iterator[Array]:
    for A, B in _drawn(side, root, risk):
        with np.errstate(all="ignore"):
            P = np.where(A > 0, (greatest - B) / A, np.where(B > greatest, -np.inf, np.inf))
        yield np.where(np.isnan(P), -np.inf, P)


def _drawn(side: OneMuscle, root: Array, risk: float) -> Iterator[tuple[Array, Array]]:
    """Yield A [N/Pa] and B [N] of the draws (N, …), for some of the n contractions at a time."""
    muscle = side.muscle
    z = _normal(root.shape[1], int(np.clip(np.ceil(np.log2(_BEYOND / risk)), _FEWEST, _MOST)))
    values = np.array([*muscle.parameters.values()]) + z @ root.T
    drawn = muscle.unchecked([column[:, None] for column in values.T])
    eps = np.ravel(side.contraction)
    for some in np.array_split(eps, np.ceil(eps.size * len(z) / _AT_ONCE)):
        with np.errstate(all="ignore"):
            B = np.broadcast_to(drawn.law(np.zeros_like(some), some), (len(z), some.size))
            A = (drawn.law(np.full_like(some, BAR), some) - B) / BAR
        yield A, B


@lru_cache(maxsize=8)
def _normal(dimension: int, power: int) -> Array:
    """Return 2^power points (N, dimension) of the standard normal distribution."""
    from scipy.special import ndtri
    from scipy.stats.qmc import Sobol

    points = ndtri(Sobol(dimension, rng=np.random.default_rng(0)).random_base2(power))
    points.setflags(write=False)
    return np.asarray(points)
