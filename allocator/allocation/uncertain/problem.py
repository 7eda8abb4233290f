"""Allocation problem under uncertain muscle parameters, and the force limits kept in draws of them.

The parameters p of the (affine) muscles are normal with covariance C = L Lᵀ. To first order in p every force, torque
and stiffness is normal, with a standard deviation that is the norm of an affine function of the pressures. So

    minimise    w_T E[(T - T*)²] + w_K E[(K - K*)²] + ρ ‖P - P_ref‖²
    subject to  prob(min_force ≤ F_i ≤ max_force, i = 1, 2) ≥ 1 - α,   supply, slew, floor                        [U]

is a second-order cone programme: E[(T - T*)²] = (T̂ - T*)² + ‖Lᵀ∂T/∂p‖², and each of the m force limits is kept with
probability 1 - α/m (Bonferroni), F̂_i - z ‖Lᵀ∂F_i/∂p‖ ≥ min_force with z the normal quantile. For the lexicographic
priorities the mean of the first target is met and kept; the second enters by its expectation.

Each force limit depends on one pressure only, so it is a bound on that pressure: the feasible set is a box again,
`chance_box`, found without the cones. Since the first order may underestimate the risk, the box also keeps the limits
in draws of the parameters (`sampled_box`).
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from allocator.allocation.optimisers.backends import SCALE
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.spread import roots, spread
from allocator.calculus import Array, increasing_root
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


class Affine(NamedTuple):
    """Affine quantity y = y0 + Y u of pressures u = (P1, P2) [bar] of n problems; y (n, m), Y (n, m, 2)."""

    offset: Array
    slope: Array

    def __call__(self, u: Array) -> Array:
        """Return y (n, m) at u (n, 2)."""
        return np.asarray(self.offset + np.einsum("nmi,ni->nm", self.slope, u))


class Uncertain(NamedTuple):
    """n problems [U]: means (m = 1) and spreads over the pressures, and the force limits' z."""

    errors: tuple[Affine, Affine]  # T̂ - T*, K̂ - K* [N·m], [N·m/rad]
    spreads: tuple[Affine, Affine]  # Lᵀ∂T/∂p, Lᵀ∂K/∂p
    forces: tuple[Affine, Affine]  # F̂1, F̂2 [N]
    force_spreads: tuple[Affine, Affine]
    z: float  # normal quantile of 1 - α/m


def uncertain(problem: Problem, risk: float) -> Uncertain:
    """Return the means and spreads of the problem, affine in the pressures and thus determined by three of them."""
    corners = [np.full((2, problem.theta.size), 0.0) for _ in range(3)]
    corners[1][0], corners[2][1] = SCALE, SCALE

    def affine(values: list[Array]) -> Affine:
        zero, one, two = (v if v.ndim == 2 else v[:, None] for v in values)
        return Affine(zero, np.stack([one - zero, two - zero], axis=2))

    errors = [problem.errors(*P) for P in corners]
    forces = [[side.force(P[i]) for i, side in enumerate(problem.sides)] for P in corners]
    spreads = [spread(problem, *P) for P in corners]
    return Uncertain(
        (affine([e[0] for e in errors]), affine([e[1] for e in errors])),
        (affine([s.torque for s in spreads]), affine([s.stiffness for s in spreads])),
        (affine([f[0] for f in forces]), affine([f[1] for f in forces])),
        (affine([s.forces[0] for s in spreads]), affine([s.forces[1] for s in spreads])),
        NormalDist().inv_cdf(1 - risk_of_one(problem, risk)),
    )


def risk_of_one(problem: Problem, risk: float) -> float:
    """Return α/m [-], the probability with which each force limit may be broken."""
    limits = 2 * sum(force is not None for force in (problem.limits.min_force, problem.limits.max_force))
    return risk / max(limits, 1)


def chance_box(problem: Problem, risk: float) -> PressureBox:
    """Return the pressures that keep every force limit with its probability: again one interval a muscle."""
    model, box = uncertain(problem, risk), sampled_box(problem, risk_of_one(problem, risk))
    intervals = [
        _narrowed(problem, side, interval, model, j)
        for j, (side, interval) in enumerate(zip(problem.sides, box, strict=True))
    ]
    return replace(box, agonist=intervals[0], antagonist=intervals[1])


def _narrowed(
    problem: Problem, side: OneMuscle, interval: PressureInterval, model: Uncertain, j: int
) -> PressureInterval:
    mean, deviation, lo, hi = model.forces[j], model.force_spreads[j], interval.lo, interval.hi
    lo_limit, hi_limit = interval.lo_limit, interval.hi_limit

    def worst(P: Array, f0: Array, f1: Array, sign: Array, index: Array) -> Array:
        i = index.astype(int)
        spread = deviation.offset[i] + deviation.slope[i, :, j] * (P / SCALE)[..., None]
        return np.asarray(f0 + f1 * P / SCALE + sign * model.z * np.linalg.norm(spread, axis=-1))

    given = mean.offset[:, 0], mean.slope[:, 0, j]
    index = np.arange(problem.theta.size, dtype=float)
    if (least := problem.limits.min_force) is not None:
        low = increasing_root(worst, lo, hi, given[0] - least, given[1], -np.ones_like(lo), index)
        slack = Limit.AGONIST_SLACK if j == 0 else Limit.ANTAGONIST_SLACK
        lo_limit = np.where(low > lo, np.int32(slack), interval.lo_limit)
        lo = np.maximum(lo, low)
    if (greatest := problem.limits.max_force) is not None:
        high = increasing_root(worst, interval.lo, hi, given[0] - greatest, given[1], np.ones_like(lo), index)
        ceiling = Limit.AGONIST_FORCE if j == 0 else Limit.ANTAGONIST_FORCE
        hi_limit = np.where(high < hi, np.int32(ceiling), interval.hi_limit)
        hi = np.minimum(hi, high)
    return replace(interval, lo=lo, hi=hi, lo_limit=lo_limit, hi_limit=hi_limit, empty=interval.empty | (lo > hi))
