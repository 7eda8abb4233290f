"""The search for the unknowns of a moving joint: trust-region least squares with forward differences."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.motion.problem import ABSENT, MotionProblem

_LAGS = (0.05, 0.3)  # [s] to start from
_FINE = 1e-3  # of the usual size of a change: differences
_ROWS = 2500  # whose errors are squared: those of neighbours say the same
_FIRST = 8  # evaluations after which the better start is kept
_MOST = 60
_CLOSE = 1e-5  # relative change of the sum of squares, and of x, below which it has converged


class Found(NamedTuple):
    """What was found is x, and whether the search converged."""

    x: Array
    converged: bool
    rms: float  # of the rows used [°], the ridge included


def search(problem: MotionProblem, used: Mask, x: Array | None = None) -> Found:
    """Minimise over the rows `used` (n,), from `x` or from the better of two lags."""
    if x is not None:
        starts = x, problem.anew(x, used)  # what was fitted to other rows may be far off on these
        return _descend(problem, used, min(starts, key=lambda x: _squares(problem, x, used)), _MOST)
    lags = _LAGS if "lag_up" in problem.free else _LAGS[:1]
    first = [_descend(problem, used, problem.start(lag, used), _FIRST) for lag in lags]
    return _descend(problem, used, min(first, key=lambda found: found.rms).x, _MOST)


def _squares(problem: MotionProblem, x: Array, used: Mask) -> float:
    return float((problem.residual(x, used) ** 2).sum())


def without(problem: MotionProblem, x: Array, *names: str) -> tuple[MotionProblem, Array]:
    """Return the problem in which these unknowns are absent, and its part of `x`."""
    kept = tuple(name for name in problem.free if name not in names)
    return _posed(problem, kept, problem.values(x), x, np.ones(problem.log.n, bool))


def extended(problem: MotionProblem, x: Array, used: Mask, **more: float) -> tuple[MotionProblem, Array]:
    """Return the problem with further unknowns, which begin at these values, and its `x`."""
    free = tuple(name for name in ABSENT if name in problem.free or name in more)
    return _posed(problem, free, problem.values(x) | more, x, used)


def _posed(
    problem: MotionProblem, free: tuple[str, ...], values: dict[str, float], x: Array, used: Mask
) -> tuple[MotionProblem, Array]:
    """Return the problem with the unknowns `free`, and its `x` at these values; rows `used` give new springs."""
    other, c = replace(problem, free=free), problem.coefficients(x)
    head = [values[name] for name in free]
    if not other.swings:
        return other, np.concatenate([head, c])
    if problem.swings:
        return other, np.concatenate([head, problem.springs(x), c])
    run = problem.run(x, used)
    return other, np.concatenate([head, problem.first_springs(run.static, run.P1, run.P2, x, used), c])


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
    return Found(np.asarray(done.x), bool(done.status > 0), float(np.sqrt(2 * done.cost / used.sum())))
