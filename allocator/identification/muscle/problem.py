"""Least-squares problem of a muscle's fit.

    minimise  Σ w_i r_i²,   r_i = F(P_i, ε_i; p) - y_i           where the muscle was measured taut
                            r_i = max(0, F(P_i, ε_i; p)) - y_i   where it was slack: the true force is "≤ 0", not y_i

(see `Samples.residual`, also for a cell that cuts its readings off at zero)
over the free parameters p within bounds. The Jacobian is exact (complex steps). Parameters in which the force is
linear are solved for directly, the others searched by SciPy's trust-region method from every start of the recipe.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import solve
from allocator.identification.muscle.samples import Samples
from allocator.muscles import Muscle, force_gradient

_ACTIVE_SET_STEPS = 30
_TOLERANCE = 1e-12
_FIRST_EVALUATIONS = 40
_MAX_EVALUATIONS = 400
_GREAT = 1e100  # in place of a force that the law cannot evaluate


class Solution(NamedTuple):
    """End of a search."""

    x: Array  # values of the free parameters
    cost: float  # Σ w r²
    converged: bool


@dataclass(frozen=True)
class MuscleProblem:
    """Problem of this module.

    `slack` [n] marks the inequalities, `free` and `linear` are parameter names.
    """

    prototype: Muscle
    free: tuple[str, ...]  # m names
    linear: tuple[str, ...]
    lower: Array  # (m,)
    upper: Array  # (m,)
    samples: Samples
    slack: Mask  # (n,)

    def on(self, keep: Mask) -> Self:
        """Return this problem on some of the samples."""
        return replace(self, samples=self.samples.where(keep), slack=self.slack[keep])

    def values(self, muscle: Muscle) -> Array:
        """Return the free parameters (m,) of a muscle."""
        return np.array([muscle.parameters[name] for name in self.free])

    def muscle(self, x: Array) -> Muscle:
        """Return the muscle with the free parameters x, not checked."""
        free = dict(zip(self.free, x.tolist(), strict=True))
        return self.prototype.unchecked([*(self.prototype.parameters | free).values()])

    def force(self, x: Array) -> Array:
        """Return F (n,) at the samples [N]; a huge number if the law gives none, so that the search turns back."""
        with np.errstate(all="ignore"):
            F = self.muscle(x).law(self.samples.pressure, self.samples.contraction)
        return np.where(np.isfinite(F), F, _GREAT) + 0.0 * self.samples.force

    def residual(self, x: Array) -> Array:
        """Return √w r (n,) [N]."""
        return np.asarray(np.sqrt(self.samples.weights) * self.samples.residual(self.force(x), self.slack))

    def jacobian(self, x: Array) -> Array:
        """Return √w ∂r/∂p (n, m)."""
        slope = self.samples.residual_slope(self.force(x), self.slack)
        return np.asarray((np.sqrt(self.samples.weights) * slope)[:, None] * self._gradient(x))

    def _gradient(self, x: Array) -> Array:
        with np.errstate(all="ignore"):
            J = force_gradient(self.muscle(x), self.samples.pressure, self.samples.contraction, self.free)
        return np.nan_to_num(J)

    def solve(self, starts: tuple[Muscle, ...]) -> Solution:
        """Return the best of the searches from all starts.

        Only the leader after some steps is followed to its end.
        """
        begun = [self._search(self.solve_linear(self.values(start)), _FIRST_EVALUATIONS) for start in starts]
        best = min(begun, key=lambda solution: solution.cost)
        return best if best.converged else self._search(best.x, _MAX_EVALUATIONS)

    def solve_linear(self, x: Array) -> Array:
        """Return `x` with its linear part replaced by the least-squares solution.

        With inequalities the cost is convex and piecewise quadratic; the set of violated ones is updated until it is
        constant (Newton's method).
        """
        places = np.array([i for i, name in enumerate(self.free) if name in self.linear], int)
        if not places.size:
            return x
        J = self._gradient(x)[:, places]  # constant in the linear parameters
        rest = self.force(np.where(np.isin(np.arange(x.size), places), 0.0, x))
        target = np.where(self.slack, self.samples.floored, self.samples.force) - rest
        root = np.sqrt(self.samples.weights)
        active = ~self.slack
        for _ in range(_ACTIVE_SET_STEPS):
            p = solve((root * active)[:, None] * J, root * active * target, rcond=1e-12)
            violated = ~self.slack | (rest + J @ p > 0)
            if (violated == active).all():
                break
            active = violated
        x = x.copy()
        x[places] = p
        return np.clip(x, self.lower, self.upper)

    def _search(self, x: Array, evaluations: int) -> Solution:
        if set(self.free) <= set(self.linear) and not np.isfinite([self.lower, self.upper]).any():
            J, r = self.jacobian(x), self.residual(x)
            scale = np.linalg.norm(J, axis=0) * np.linalg.norm(r)
            if (np.abs(J.T @ r) <= 1e-8 * scale + 1e-300).all():  # the active set settled: this is the minimum
                return Solution(x, float(r @ r), True)
        from scipy.optimize import least_squares

        scale = 1 / self.samples.full_scale  # makes the cost of order one
        found = least_squares(
            lambda x: scale * self.residual(x),
            _inside(x, self.lower, self.upper),
            lambda x: scale * self.jacobian(x),
            bounds=(self.lower, self.upper),
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=evaluations,
        )
        r = self.residual(found.x)
        return Solution(found.x, float(r @ r), found.status > 0)


def _inside(x: Array, lower: Array, upper: Array) -> Array:
    """Return `x` moved strictly between the bounds, as SciPy requires."""
    width = np.where(np.isfinite(upper - lower), upper - lower, np.maximum(np.abs(x), 1.0))
    return np.clip(x, lower + 1e-3 * width, upper - 1e-3 * width)
