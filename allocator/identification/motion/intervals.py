"""Parameters of the motion of a joint, and their 95 % intervals."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.motion.doubt import possible_changes
from allocator.identification.motion.problem import ABSENT, LOWER, UPPER
from allocator.identification.motion.result import Estimate
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.search import Found, fit_regulators, search
from allocator.identification.motion.static import Equilibrium
from allocator.units import DEG

JACKKNIFE = 10  # contiguous blocks, left out in turn for the intervals
_MODEL = 0.05  # relative error on plants of another structure, in any log: benchmarks.identification.motion_truth
_MODEL_OF_LOOPS = 0.1  # for hysteresis
_TRADED = 0.2  # share of the dead band that hysteresis may imitate, and growth of the error
_AT_BOUND = 1.001  # times the lower bound of the search: smaller estimates are at the bound
_TAPER = 0.3  # of the widths, at the ends of the range
_LOOPS = ("loop_width", "stuck_slope", "base")
_TIMES = ("dead_time", "lag_up", "lag_down")  # which imitate each other within a sample
_DYNAMIC = ("damping", "inertia")
WORSE = 1.02  # least growth of the error without an observable parameter


def parameters_of(found: Found, noisy: MotionLog, tell: Callable[[str], object]) -> dict[str, Estimate]:
    """Return the parameters of the motion with their intervals; `noisy` is the log with unfiltered pressures."""
    log, every, jackknife = found.problem.log, found.problem.log.settled, []
    for rows in without_blocks(log.n, JACKKNIFE):
        tell("intervals")
        jackknife.append(_named(found.again(rows & every), rows & every))
    tell("other choices")
    choices = _other_choices(found, noisy)
    changes = possible_changes(found.problem, found.x, every, lambda x: _named(found._replace(x=x), every))
    return _estimates(_named(found, every), jackknife, choices, changes, log, found.rms * DEG)


def _named(found: Found, used: Mask) -> dict[str, float]:
    """Return the parameters of the motion by name."""
    problem, run = found.problem, found.run(used)
    H, values = problem.filled(found.x, run.weights), problem.values(found.x)
    named = {name: values[name] for name in problem.free}
    named["loop_width"] = 2 * sum(w * r for w, r in zip(H.weights[1:], H.thresholds, strict=True))
    if not problem.stiffest(found.x, run.weights):
        named["stuck_slope"] = H.weights[0]
    if isinstance(problem.static, Equilibrium):
        named["gain"] = found.slope(used)
    return named


def _other_choices(here: Found, noisy: MotionLog) -> list[dict[str, float]]:
    """Return the parameters found with alternative choices.

    These are other half widths, unfiltered pressures, one lag for both directions if it explains the log as well, a
    smaller dead band if it resembles hysteresis, and widths that shrink at the ends of the range, like those of
    friction on stiffening muscles; also the other kind of springs, if it explains the log as well.
    """
    problem, every = here.problem, here.problem.log.settled
    others = [here.again(every, replace(problem, finest=problem.finest * 1.3))]
    if not (np.array_equal(noisy.P1, problem.log.P1) and np.array_equal(noisy.P2, problem.log.P2)):
        others.append(here.again(every, replace(problem, log=noisy)))
    as_good = [replace(problem, one_lag=True)] if "lag_up" in problem.free else []
    if problem.may_have_own_springs:
        as_good.append(replace(problem, elastic=not problem.elastic))
    for other in (*as_good, replace(problem, taper=_TAPER)):
        if (found := here.again(every, other)).rms < WORSE * here.rms:
            others.append(found)
    if "dead_band" in problem.free and problem.log.swept:  # in sweeps it resembles hysteresis
        less, x = here.without("dead_band")
        less = replace(less, assumed=(("dead_band", (1 - _TRADED) * problem.values(here.x)["dead_band"]),))
        found = search(less, every, x)
        if found.rms < (1 + _TRADED) * here.rms:  # the rest is the model's error, which proves nothing
            others.append(found)
    return [_named(other, every) | dict(other.problem.assumed) for other in others]


def _estimates(
    here: dict[str, float],
    jackknife: list[dict[str, float]],
    choices: list[dict[str, float]],
    changes: dict[str, float],
    log: MotionLog,
    rms: float,
) -> dict[str, Estimate]:
    """Return values and 95 % intervals by the jackknife over contiguous blocks, within which errors are correlated.

    Each of these adds one standard deviation: the effect of another choice; the `changes` that the structure of the
    residual allows; the unknown time within a sample at which a command began to act; the usual model error; the spread
    of the stiffness; for the loop, the unexplained angle `rms` [rad].
    """
    from scipy.stats import t as student

    found = {}
    for name, value in here.items():
        n = max(sum(name in other for other in jackknife), 2)
        factor = float(student.ppf(0.975, n - 1))
        left_out, chosen = (np.array([o[name] for o in others if name in o]) for others in (jackknife, choices))
        variance = (n - 1) / n * np.sum((left_out - left_out.mean()) ** 2) + np.sum((chosen - value) ** 2)
        variance += changes.get(name, 0.0) ** 2
        variance += ((_MODEL_OF_LOOPS if name in _LOOPS else _MODEL) * value) ** 2
        variance += rms**2 if name == "loop_width" else 0.0
        variance += log.step**2 / 12 if name in _TIMES else 0.0
        variance += (value * log.relative_spread) ** 2 if name in _DYNAMIC else 0.0
        std = float(np.sqrt(variance))
        below = 0.0 if value <= _AT_BOUND * LOWER.get(name, 0.0) else value - factor * std  # it would be less still
        low, high = max(below, 0.0), min(value + factor * std, UPPER.get(name, np.inf))
        found[name] = Estimate(value, std, low, high)
    return found


def with_regulators(total: dict[str, Estimate], found: Found, sensed: tuple[Array, Array]) -> dict[str, Estimate]:
    """Return the estimates with those of the regulators, and the angle's delay split into dead time and reading age."""
    log, every = found.problem.log, found.problem.log.settled
    jackknife = [fit_regulators(found, sensed, rows & every) for rows in without_blocks(log.n, JACKKNIFE)]
    own = _estimates(fit_regulators(found, sensed, every), jackknife, [], {}, log, 0.0)
    own = {name: estimate for name, estimate in own.items() if estimate.value != ABSENT[name]}
    late, dead = total.get("dead_time"), own.get("dead_time", Estimate(0.0, 0.0, 0.0, 0.0))
    if late is None:
        return total | own
    age, std = max(late.value - dead.value, 0.0), float(np.hypot(late.std, dead.std))
    half = float(np.hypot(late.high - late.low, dead.high - dead.low)) / 2
    return total | own | {"reading_age": Estimate(age, std, max(age - half, 0.0), age + half)}


def without_blocks(n: int, count: int) -> list[Mask]:
    """Return the masks (n,) of rows that remain without each of `count` contiguous blocks."""
    return [block_of(n, count) != block for block in range(count)]


def block_of(n: int, count: int) -> Array:
    """Return the number of each of n rows' contiguous block, of `count` ones (n,)."""
    return np.asarray(np.arange(n) * count // n, float)
