"""Every answer is certified here from its pressures: by a residual of optimality, and beyond reach by a direction.

**Optimal.** At level k, with the multipliers μ of the rows of the earlier levels, G = A_kᵀ(A_k x - b_k) + Σ A_iᵀμ_i has to
vanish where x is inside its bounds, and must not point inside where it is at one, unless an earlier level holds it
there. Whoever found the μ, that proves the level; what is left of it, in fractions of its scale, is the residual.

**Beyond reach.** If d·y(P) < d·y* for all P of the box, no pressures give y*. For affine muscles the greatest d·y(P) is
d·y0 + Σ_j max(d·M_j lo_j, d·M_j hi_j): three lines that anybody can check. The first level that is missed gives
d = -W(residual, with its multipliers).
"""

from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.limits import BINDS
from allocator.mechanism.batches import Solved
from allocator.mechanism.kernel import ZERO
from allocator.mechanism.problem import MechanismProblem


class Separation(NamedTuple):
    """A `Separation` proves targets to be beyond reach: d·y(P) ≤ reach < asked = d·y* for all pressures of the box.

    Its components are NaN where the targets are met.
    """

    direction: Any  # d (…, d), in the order of a `TargetsMap`, its greatest component 1
    reach: Any  # (…) the greatest d·y(P)
    asked: Any  # (…) d·y*


def residual(problem: MechanismProblem, solved: Solved) -> Array:
    """Return the optimality residual (N,) in fractions of its scale; inf where there is no answer."""
    (_, ends), (lo, hi, centre) = problem.rows, problem.x_bounds
    x = solved.x
    inside = (x > lo + BINDS) & (x < hi - BINDS)
    low, high = x <= lo + BINDS, x >= hi - BINDS
    held = low & high  # a muscle without a choice
    worst = np.zeros(len(x))
    begin = 0
    magnitudes, steep = np.abs(problem.A), np.abs(problem.A).sum(axis=1)
    for k in range(len(ends) + 1):
        end = int(ends[k]) if k < len(ends) else begin
        mu = np.array(solved.mu[:, k, :end])
        if k < len(ends):
            own = problem.by_posture(problem.A[:, begin:end].swapaxes(1, 2), x) - problem.b[:, begin:end]
            mu[:, begin:end] = own
            size = np.abs(problem.b[:, begin:end]).max(axis=1, initial=0.0)[:, None]
            scale = (size + magnitudes[:, begin:end].sum(axis=2).max(axis=1)[:, None]) * steep
        else:
            scale = np.ones((1, 1))
        G = problem.by_posture(problem.A[:, :end], mu) + (x - centre if k == len(ends) else 0.0)
        scale = scale + problem.by_posture(magnitudes[:, :end], np.abs(mu))
        wrong = np.where(inside, np.abs(G), np.maximum(np.where(low, -G, G), 0.0))
        worst = np.maximum(worst, np.where(held, 0.0, wrong / scale).max(axis=1))
        held = held | ((low | high) & (np.abs(G) > ZERO * scale))
        begin = end
    return np.where(solved.rounds > 0, worst, np.inf)


def separation(problem: MechanismProblem, mu: Array) -> Separation:
    """Return the direction (N, d), the reach and what is asked (N,) of each target."""
    (rows, ends), (lo, hi) = problem.rows, problem.bounds
    d = np.zeros(problem.y.shape)
    begin, found = 0, np.zeros(problem.size, bool)
    for k, end in enumerate(ends.tolist()):
        first = ~found & (mu[:, k, begin:end] != 0).any(axis=1)
        d[np.ix_(first, rows[:end])] = -np.sqrt(problem.weights[rows[:end]]) * mu[first, k, :end]
        begin, found = end, found | first
    d /= np.abs(d).max(axis=1, where=found[:, None], initial=0.0)[:, None] + ~found[:, None]
    dM = problem.by_posture(problem.map.M, d)  # (N, m)
    reach = (d * problem.map.y0).sum(axis=1) + np.maximum(dM * lo, dM * hi).sum(axis=1)
    asked = (d * problem.y).sum(axis=1)
    proved = found & (reach < asked)
    return Separation(*(np.where(proved.reshape(-1, *[1] * (a.ndim - 1)), a, np.nan) for a in (d, reach, asked)))


__all__ = ["Separation", "residual", "separation"]
