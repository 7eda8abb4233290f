"""Regulators of a log that has measured pressures beside the commands.

    minimise  Σ_k (P_i,k - P̂_i,k - o_i)²     over τ_up, τ_down, their ratio, t_dead, dead band, filling, gas

P̂_i answers the commands as `loops.pressures` has it, and o_i is the mean difference of a sensor and its regulator. The
pressures are taken to be read at once, so this dead time is that of the commands alone. The angle of the same log
follows the commands by the dead time and by the age of its readings: the difference is that age.
"""

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.motion.problem import ABSENT, LOWER, REGULATOR, STEP, UPPER
from allocator.identification.motion.search import Found
from allocator.units import BAR

_WORSE = 1.01  # by which the error grows at least without a number that the pressures show
_FIRST = (0.1, 0.1, 0.02, 0.05 * BAR, 0.05 / BAR, 1.0, 1.0)
_START = dict(zip(REGULATOR, _FIRST, strict=True))


def sensed_at(times: Array, t: ArrayLike, measured: tuple[ArrayLike, ArrayLike]) -> tuple[Array, Array]:
    """Return the pressures `measured` at `t` [s] at the `times` (n,) [s] of a log. Raises `InvalidInput`."""
    at = checks.real("t", t, "s")
    one, two = (checks.pressure(f"measured[{i}]", P) for i, P in enumerate(measured))
    if not at.shape == one.shape == two.shape:
        raise InvalidInput("measured has to be two rows of pressures, one of each for every sample")
    return np.interp(times, at, one), np.interp(times, at, two)


def fit_regulators(found: Found, measured: tuple[Array, Array], used: Mask) -> dict[str, float]:
    """Return the numbers `REGULATOR` by the pressures `measured` (n,) [Pa] in the rows `used` (n,) of the log.

    A dead band or a limit of the filling that the pressures do not show is 0.
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
    """Return the numbers `REGULATOR`, as `ABSENT` where they are not `free`, and the RMS error [bar]."""
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
