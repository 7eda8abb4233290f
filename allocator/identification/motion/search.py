"""Searches for the unknowns of a moving joint, and for the regulators of a log with measured pressures.

Both are trust-region least squares. The first has forward differences; the second is

    minimise  Σ_k (P_i,k - P̂_i,k - o_i)²     over τ_up, τ_down, ρ, t_dead, dead band, filling, gas

where P̂_i is the response to the commands by `loops.pressures` and o_i the mean difference of a sensor and its
regulator. Pressure readings are assumed free of delay, so this dead time is that of the commands alone. The angle of
the same log lags the commands by the dead time plus the age of its readings; the difference is that age.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.motion.problem import ABSENT, LOWER, REGULATOR, STEP, UPPER, MotionProblem, Prediction
from allocator.units import BAR

_LAGS = (0.05, 0.3)  # [s] to start from
_FINE = 1e-3  # of the usual size of a change: differences
_ROWS = 2500  # with squared errors: neighbours are redundant
_FIRST = 8  # evaluations after which the better start is kept
_MOST = 60
_CLOSE = 1e-5  # relative change of the sum of squares, and of x, below which it has converged
_STEP = {"atol": 1e-10, "btol": 1e-10, "maxiter": 300}  # LSMR: as many turns as unknowns, the default, give poor steps


class Found(NamedTuple):
    """Result of a search: the unknowns x of a problem."""

    problem: MotionProblem
    x: Array
    converged: bool
    rms: float  # of the rows used [°], the ridge included

    def run(self, used: Mask) -> Prediction:
        """Return the free run with the best weights on the rows `used` (n,)."""
        return self.problem.run(self.x, used)

    def slope(self, used: Mask) -> float:
        """Return the mean slope of the static angle [rad] with respect to q over the rows `used` (n,)."""
        run = self.run(used)
        return float(np.polyfit(self.problem.static(run.P1, run.P2)[used], run.static[used], 1)[0])

    def again(self, used: Mask, problem: MotionProblem | None = None) -> "Found":
        """Continue the search on other rows, or for another problem of these unknowns."""
        return search(problem or self.problem, used, self.x)

    def without(self, *names: str) -> tuple[MotionProblem, Array]:
        """Return the problem without these unknowns, and its part of x."""
        kept = tuple(name for name in self.problem.free if name not in names)
        return self._posed(kept, self.problem.values(self.x), np.ones(self.problem.log.n, bool))

    def extended(self, used: Mask, **more: float) -> tuple[MotionProblem, Array]:
        """Return the problem with further unknowns, started at these values, and its x."""
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
        starts = x, problem.anew(x, used)  # a fit to other rows may be far off on these
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
    ends = {"ftol": _CLOSE, "xtol": _CLOSE, "gtol": 1e-12, "max_nfev": most}
    lsmr = {"tr_solver": "lsmr", "tr_options": _STEP}  # wakes no threads for small matrices, as an SVD does
    done = least_squares(residual, start, jacobian, (low, high), x_scale=sizes, **lsmr, **ends)
    return Found(problem, np.asarray(done.x), bool(done.status > 0), float(np.sqrt(2 * done.cost / used.sum())))


# --- regulators -------------------------------------------------------------------------------------------------------


_WORSE = 1.01  # least growth of the error without an identifiable number
_START = dict(zip(REGULATOR, (0.1, 0.1, 0.02, 0.05 * BAR, 0.05 / BAR, 1.0, 1.0), strict=True))


def sensed_at(times: Array, t: ArrayLike, measured: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    """Return the pressures `measured` at `t` [s] at the `times` (n,) [s] of a log. Raises `InvalidInput`."""
    at = checks.real("t", t, "s")
    one, two = (checks.pressure(f"measured[{i}]", P) for i, P in enumerate(measured))
    if not at.shape == one.shape == two.shape:
        raise InvalidInput("measured has to be two rows of pressures, one of each for every sample")
    return np.interp(times, at, one), np.interp(times, at, two)


def fit_regulators(found: Found, measured: tuple[Array, Array], used: Mask) -> dict[str, float]:
    """Return the numbers `REGULATOR` from the pressures `measured` (n,) [Pa] in the rows `used` (n,) of the log.

    A dead band or a limit of the filling that is not identifiable is 0.
    """
    shown = REGULATOR if found.problem.gas else REGULATOR[:-1]
    best, error = _fitted(found, measured, used, shown)
    for name in ("filling", "dead_band"):
        less, without = _fitted(found, measured, used, tuple(one for one in shown if best[one] and one != name))
        if without < _WORSE * error:
            best, error = less, without
    return best


def _fitted(
    found: Found, measured: tuple[Array, Array], used: Mask, free: tuple[str, ...]
) -> tuple[dict[str, float], float]:
    """Return the numbers `REGULATOR`, those of `ABSENT` unless `free`, and the RMS error [bar]."""
    from scipy.optimize import least_squares

    problem = found.problem
    log, sizes = problem.log, np.array([STEP[name] for name in free])
    low, high, start = (np.array([of[name] for name in free]) / sizes for of in (LOWER, UPPER, _START))

    def numbers(z: Array) -> dict[str, float]:
        return {name: ABSENT[name] for name in REGULATOR} | dict(zip(free, (z * sizes).tolist(), strict=True))

    def residual(z: Array) -> Array:
        pressures = problem.pressures(log.t, (log.P1, log.P2), log.theta, tuple(numbers(z).values()))
        gaps = [(P - own)[used] for P, own in zip(measured, pressures, strict=True)]
        return np.concatenate([gap - gap.mean() for gap in gaps]) / BAR

    done = least_squares(residual, start, bounds=(low, high), diff_step=1e-3)
    return numbers(done.x), float(np.sqrt(np.mean(done.fun**2)))
