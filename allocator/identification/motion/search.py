"""The search for the unknowns of a moving joint: trust-region least squares with forward differences."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.motion.problem import ABSENT, MotionProblem, Prediction

_LAGS = (0.05, 0.3)  # [s] to start from
_FINE = 1e-3  # of the usual size of a change: differences
_ROWS = 2500  # whose errors are squared: those of neighbours say the same
_FIRST = 8  # evaluations after which the better start is kept
_MOST = 60
_CLOSE = 1e-5  # relative change of the sum of squares, and of x, below which it has converged


class Found(NamedTuple):
    """Where a search ended: the unknowns x of a problem."""

    problem: MotionProblem
    x: Array
    converged: bool
    rms: float  # of the rows used [°], the ridge included

    def run(self, used: Mask) -> Prediction:
        """Return the free run with the best weights on the rows `used` (n,)."""
        return self.problem.run(self.x, used)

    def again(self, used: Mask, problem: MotionProblem | None = None) -> "Found":
        """Search from here on other rows, or for another problem of these unknowns."""
        return search(problem or self.problem, used, self.x)

    def without(self, *names: str) -> tuple[MotionProblem, Array]:
        """Return the problem in which these unknowns are absent, and its part of x."""
        kept = tuple(name for name in self.problem.free if name not in names)
        return self._posed(kept, self.problem.values(self.x), np.ones(self.problem.log.n, bool))

    def extended(self, used: Mask, **more: float) -> tuple[MotionProblem, Array]:
        """Return the problem with further unknowns, which begin at these values, and its x."""
        free = tuple(name for name in ABSENT if name in self.problem.free or name in more)
        return self._posed(free, self.problem.values(self.x) | more, used)

    def _posed(self, free: tuple[str, ...], values: dict[str, float], used: Mask) -> tuple[MotionProblem, Array]:
        """Return the problem with the unknowns `free`, and its x at these values; rows `used` give new springs."""
        problem, x = self.problem, self.x
        other = replace(problem, free=free)
        head, springs = [values[name] for name in free], np.zeros(0)
        if other.swings and problem.swings:
            springs = problem.springs(x)
        elif other.swings:
            run = self.run(used)
            springs = problem.first_springs(run.static, run.P1, run.P2, x, used)
        return other, np.concatenate([head, springs, problem.coefficients(x)])


def search(problem: MotionProblem, used: Mask, x: Array | None = None) -> Found:
    """Minimise over the rows `used` (n,), from `x` or from the better of two lags."""
    if x is not None:
        starts = x, problem.anew(x, used)  # what was fitted to other rows may be far off on these
        best = min(starts, key=lambda x: float((problem.residual(x, used) ** 2).sum()))
        return _descend(problem, used, best, _MOST)
    lags = _LAGS if "lag_up" in problem.free else _LAGS[:1]
    first = [_descend(problem, used, problem.start(lag, used), _FIRST) for lag in lags]
    return _descend(problem, used, min(first, key=lambda found: found.rms).x, _MOST)


def _descend(problem: MotionProblem, used: Mask, x: Array, most: int) -> Found:
    from scipy.optimize import least_squares

    used = used & (np.arange(used.size) % max(1, used.size // _ROWS) == 0)  # the run goes over all rows
    low, high = problem.bounds()
    sizes = problem.sizes()

    def residual(x: Array) -> Array:
        return problem.residual(x, used)

    def jacobian(x: Array) -> Array:
        here = residual(x)
        columns = np.empty((here.size, x.size))
        for i, step in enumerate(_FINE * sizes):
            step = step if x[i] + step <= high[i] else -step
            moved = x.copy()
            moved[i] += step
            columns[:, i] = (residual(moved) - here) / step
        return columns

    start = np.clip(x, low, high)
    options = {"x_scale": sizes, "tr_solver": "lsmr", "ftol": _CLOSE, "xtol": _CLOSE, "gtol": 1e-12, "max_nfev": most}
    done = least_squares(residual, start, jacobian, (low, high), **options)  # lsmr: no threads for small matrices
    return Found(problem, np.asarray(done.x), bool(done.status > 0), float(np.sqrt(2 * done.cost / used.sum())))
