"""The allocation problem under uncertain muscle parameters is stated here.

The parameters p of the (affine) muscles are normal with covariance C = L Lᵀ. To first order in p every force, torque
and stiffness is normal, with a standard deviation that is the norm of an affine function of the pressures. So

    minimise    w_T E[(T - T*)²] + w_K E[(K - K*)²] + ρ ‖P - P_ref‖²
    subject to  prob(min_force ≤ F_i ≤ max_force, i = 1, 2) ≥ 1 - α,   supply, slew, floor                        [U]

is a second-order cone programme: E[(T - T*)²] = (T̂ - T*)² + ‖Lᵀ∂T/∂p‖², and each of the m force limits is kept with
probability 1 - α/m (Bonferroni), F̂_i - z ‖Lᵀ∂F_i/∂p‖ ≥ min_force with z the normal quantile. For the lexicographic
priorities the mean of the first target is met and kept; the second one counts in expectation.

Each force limit depends on one pressure only, so that it is a bound on that pressure: the feasible set is a box again,
`chance_box`, found without the cones. The first order is not trusted with the risk alone: the box also keeps the limits
in draws of the parameters, see `allocator.allocation.uncertain.draws`.
"""

from dataclasses import replace
from statistics import NormalDist
from typing import NamedTuple

import numpy as np

from allocator.allocation.optimisers.backends import SCALE
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.draws import sampled_box
from allocator.allocation.uncertain.spread import spread
from allocator.calculus import Array, increasing_root
from allocator.joint.limits import Limit, PressureBox, PressureInterval
from allocator.joint.one_muscle import OneMuscle


class Affine(NamedTuple):
    """A quantity is `Affine` in pressures u = (P1, P2) [bar] of n problems: y = y0 + Y u; y (n, m), Y (n, m, 2)."""

    offset: Array
    slope: Array

    def __call__(self, u: Array) -> Array:
        """Return y (n, m) at u (n, 2)."""
        return np.asarray(self.offset + np.einsum("nmi,ni->nm", self.slope, u))


class Uncertain(NamedTuple):
    """An `Uncertain` is n problems [U]: means (m = 1) and spreads over the pressures, and the force limits' z."""

    errors: tuple[Affine, Affine]  # T̂ - T*, K̂ - K* [N·m], [N·m/rad]
    spreads: tuple[Affine, Affine]  # Lᵀ∂T/∂p, Lᵀ∂K/∂p
    forces: tuple[Affine, Affine]  # F̂1, F̂2 [N]
    force_spreads: tuple[Affine, Affine]
    z: float  # normal quantile of 1 - α/m


def uncertain(problem: Problem, risk: float) -> Uncertain:
    """Return the means and spreads of the problem, affine in the pressures and therefore known from three of them."""
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
