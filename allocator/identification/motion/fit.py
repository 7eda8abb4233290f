"""Fit of a moving joint to its log: search, blocks left out in turn, intervals, and unobservable parameters."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.motion.doubt import Bands, possible_changes
from allocator.identification.motion.problem import ABSENT, LOWER, REGULATOR, STIFFEST, UPPER, MotionProblem, Prediction
from allocator.identification.motion.result import TRAINED, Errors, Estimate, MotionFit
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.search import Found, fit_regulators, search, sensed_at
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.assumption import with_volumes
from allocator.units import BAR, DEG

_MOST_SUPPLY = 2.0  # greatest pressure of a log relative to the supply of the given joint
LEFT_OUT = 5  # contiguous blocks, left out in turn for prediction
_JACKKNIFE = 10  # contiguous blocks, left out in turn for the intervals
_WORSE = 1.02  # least growth of the error without an observable parameter,
_MUCH_WORSE = 1.05  # and without inertia and damping, small values of which imitate lag
_SIGNS = {  # parameters identified together, and the sentence if they are not; imitators of others come first
    ("dead_band",): "the dead band: small steps up and down about one pressure would show it",
    ("base",): "that the hysteresis grows with P1 + P2: sweeps at several co-contractions would show it",
    ("dead_time",): "the dead time: steps of the pressures, at a higher sample rate, would show it",
    ("lag_up", "lag_down"): "the lags: steps of the pressures would show them",
}
_UNFILLED = "how fast the valves can fill the muscles: great steps of the pressures would show it"
_AGE = "the age of the angle's readings, counted as dead time: pressures measured beside the commands would show it"
_OF_REGULATORS = {_UNFILLED, *(sentence for names, sentence in _SIGNS.items() if names != ("base",))}
_FILLING = {"filling": 0.1 / BAR}  # [s/Pa] to start from
_MODEL = 0.05  # relative error on plants of another structure, in any log: benchmarks.identification.motion_truth
_MODEL_OF_LOOPS = 0.1  # for hysteresis
_TRADED = 0.2  # share of the dead band that hysteresis may imitate, and growth of the error
_AT_BOUND = 1.001  # times the lower bound of the search: smaller estimates are at the bound
_TAPER = 0.3  # of the widths, at the ends of the range
_LOOPS = ("loop_width", "stuck_slope", "base")
_TIMES = ("dead_time", "lag_up", "lag_down")  # which imitate each other within a sample
_DYNAMIC = {"damping": 0.02, "inertia": 1e-3}  # [s], [s²] to start from
_USUAL = {"lag_up": 0.1, "lag_down": 0.13, "dead_time": 0.03, "dead_band": 0.08 * BAR, "filling": 0.15 / BAR}
_USUAL |= {"lag_ratio": 1.0, "volume": 1.3, "base": 0.8, "damping": 0.03, "inertia": 6e-3}  # starts of all at once
_BY_SUM = "base", "lag_ratio"  # identified only if P1 + P2 varies
_SPRING = 0.02  # κ_i of each stop
STEPS = 9 + LEFT_OUT + _JACKKNIFE + 2 * len(_SIGNS)  # of `progress`, at most


def fit_motion(
    t: ArrayLike,
    theta: ArrayLike,
    P1: ArrayLike,
    P2: ArrayLike,
    *,
    joint: AntagonistJoint | None = None,
    zero: float = 0.0,
    measured: tuple[ArrayLike, ArrayLike] | None = None,
    scale_known: bool = True,
    gas: bool | None = None,
    progress: Callable[[str], object] | None = None,
) -> MotionFit:
    """Fit lags, dead time, dead band, hysteresis, inertia and damping to the log of a joint that moves without load.

    All parameters are fitted by free-run prediction of the angle from the pressures alone, over the whole log.

    Parameters
    ----------
    t
        Times [s], increasing; arrays (n,), as are the others.
    theta
        Encoder reading [rad].
    P1, P2
        Pressures of agonist and antagonist [Pa, gauge], commanded or measured; lags are from them to the angle.
    joint
        A joint of the same kind, as returned by `fit_joint`, whose static angle is corrected; `MotionFit.joint` refits
        its muscles. Without one the static angle is a polynomial of the pressures, linear in its coefficients, and
        there is no plant to save.
    zero
        Encoder reading [rad] at 0 of `joint`, `JointFit.zero`; corrected by up to 20°, like the muscles.
    measured
        Pressures of both sensors [Pa], arrays (n,), if `P1` and `P2` are commands. The regulators are then fitted to
        these, and the angle determines `reading_age` separately from `dead_time`.
    scale_known
        Whether the joint's forces are correct in scale; otherwise those of the result are not either.
    gas
        Whether to include the gas in the given joint's muscles, which motion compresses; otherwise lags, hysteresis and
        inertia absorb its effect. By default the better prediction decides. Muscles of unknown volume are treated as
        ordinary braids with the same force.
    progress
        Called with a word before each of `STEPS` steps.

    Raises
    ------
    InvalidInput
        For an invalid log, and for one with too little motion, with a suggested experiment.
    """
    if joint is not None:
        checks.instance("joint", joint, AntagonistJoint, "an AntagonistJoint, such as that of fit_joint")
    log = MotionLog.checked(t, theta, P1, P2)
    zero = float(checks.angle("zero", checks.number("zero", zero, "rad")))
    tell = progress or (lambda step: None)
    full, taken = (joint, "") if joint is None or gas is False else with_volumes(joint)
    every = log.settled
    early = every & (np.arange(log.n) < TRAINED * log.n)
    kinds = [False] if joint is None or gas is False else [True] if gas else [False, True]
    problems = [MotionProblem.of(log, _static(full, log.greatest_pressure, held, zero)) for held in kinds]
    sensed = None if measured is None else sensed_at(log.t, t, measured)
    trained, unseen = min((_seen(problem, early, tell) for problem in problems), key=lambda seen: seen[0].rms)
    if sensed is not None and log.varies_speed:
        trained, unseen = _with_regulators(trained, sensed, early), [one for one in unseen if one not in _OF_REGULATORS]
    elif "dead_time" in trained.problem.free:
        unseen.append(_AGE)
    _check_sign(trained, early)
    tell("all rows")
    found = trained.again(every)
    left_out = [_left_out(found, rows & every, every & ~rows, tell) for rows in _blocks(log.n, LEFT_OUT)]
    jackknife = []
    for rows in _blocks(log.n, _JACKKNIFE):
        tell("intervals")
        jackknife.append(_named(found.again(rows & every), rows & every))
    tell("other choices")
    choices = _other_choices(found, MotionLog.checked(t, theta, P1, P2, medians=False))
    run = found.run(every)
    changes = possible_changes(found.problem, found.x, every, lambda x: _named(found._replace(x=x), every))
    errors = np.where(every, np.nansum([error for _, error in left_out], axis=0), np.nan)
    parameters = _estimates(_named(found, every), jackknife, choices, changes, log, found.rms * DEG)
    if sensed is not None and log.varies_speed:
        parameters = _apart(parameters, found, sensed)
    return MotionFit(
        operator=found.problem.filled(found.x, run.weights),
        parameters=parameters,
        error=_errors(found, every, every),
        held_out=_errors(trained, early, every & ~early),
        blocks=tuple(errors for errors, _ in left_out),
        bands=Bands.of(errors, _block(log.n, LEFT_OUT), found.problem.taut(run)),
        unseen=(*unseen, *_taken(found, run), *([taken] if taken and found.problem.gas else [])),
        converged=found.converged,
        given=full if found.problem.gas else joint,
        zero=zero,
        scale_known=scale_known,
        problem=found.problem,
        x=found.x,
        x_early=trained.x,
    )


def _static(joint: AntagonistJoint | None, greatest: float, gas: bool, zero: float) -> Difference | Equilibrium:
    """Return the variable of the static angle's polynomial, for pressures up to `greatest` [Pa]."""
    if joint is None:
        return Difference(greatest)
    if greatest > _MOST_SUPPLY * (supply := joint.pressure_limits[1]):
        raise InvalidInput(
            f"the pressures of the log go up to {greatest / BAR:.3g} bar, those of the joint up to {supply / BAR:.3g} "
            "bar: check the unit of P1 and P2 [Pa], or the joint's supply"
        )
    return Equilibrium(joint, greatest, gas, zero)


def _check_sign(found: Found, used: Mask) -> None:
    if _slope(found, used) < 0:
        raise InvalidInput(
            "θ falls with P1 and rises with P2: the muscles are swapped, or the angle has the other sign; pass P2 as "
            "P1 and P1 as P2, or -theta"
        )


def _slope(found: Found, used: Mask) -> float:
    """Return the mean slope of the static angle [rad] with respect to q over the rows."""
    run = found.run(used)
    return float(np.polyfit(found.problem.static(run.P1, run.P2), run.static, 1)[0])


def _seen(problem: MotionProblem, used: Mask, tell: Callable[[str], object]) -> tuple[Found, list[str]]:
    """Return the fit with the unknowns identified by the rows `used`, and sentences about the others."""
    tell("first rows")
    found, unseen = search(problem, used), []
    tell("inertia and damping")
    found = _swinging(found, used)
    tell("filling")
    if "lag_up" in found.problem.free:
        found = _if_better(found, used, **_FILLING)
        found = _if_better(found, used, volume=1.0) if problem.gas else found
        found = _if_better(found, used, lag_ratio=1.0) if problem.log.varies_sum else found
    tell("all at once")
    found = _all_at_once(found, used)
    if "filling" not in found.problem.free:
        unseen.append(_UNFILLED)
    best = found.rms
    found = _if_needed(found, best, used, ("lag_ratio",))
    for names, sentence in _SIGNS.items():
        tell("what is seen")
        found = _if_needed(found, best, used, names)
        if not set(names) & set(found.problem.free):
            unseen.append(sentence)
    if not found.problem.swings:
        found = _swinging(found, used)
    if not found.problem.swings:
        unseen.append("inertia and damping: faster steps, of a joint that swings, show them")
    else:
        found = _if_needed(found, best, used, ("inertia",))
        if "inertia" not in found.problem.free:
            unseen.append("the inertia: faster steps, of a joint that swings, show it")
    return found, unseen


def _all_at_once(found: Found, used: Mask) -> Found:
    """Return the fit with every unknown started at usual values, if it is better.

    Added one by one they can end in a valley where the first have replaced the others.
    """
    log = found.problem.log
    if not log.varies_speed:
        return found
    usual = _USUAL if found.problem.gas else {name: value for name, value in _USUAL.items() if name != "volume"}
    free = tuple(name for name in usual if name not in _BY_SUM or log.varies_sum)
    problem = replace(found.problem, free=free)
    springs = np.full(problem.widths.size, _SPRING)
    x = np.concatenate([[usual[name] for name in free], springs, np.zeros(len(problem.powers))])
    other = search(problem, used, problem.anew(x, used))
    return other if other.rms * _MUCH_WORSE < found.rms else found


def _if_needed(found: Found, best: float, used: Mask, names: tuple[str, ...]) -> Found:
    """Return the fit without these unknowns, unless its error then exceeds `best`."""
    if not set(names) & set(found.problem.free):
        return found
    less, x = found.without(*names)
    other = search(less, used, x)
    return other if other.rms < _WORSE * best else found


def _if_better(found: Found, used: Mask, **more: float) -> Found:
    """Return the fit with further unknowns, started at these values, if the log identifies them."""
    if not found.problem.log.varies_speed:
        return found
    richer, x = found.extended(used, **more)
    other = search(richer, used, x)
    return other if other.rms * _MUCH_WORSE < found.rms else found


def _swinging(found: Found, used: Mask) -> Found:
    """Return the fit with inertia and damping, if the log identifies them, and with the better kind of springs."""
    found = _if_better(found, used, **_DYNAMIC)
    if not found.problem.may_have_own_springs:
        return found
    own = found.again(used, replace(found.problem, elastic=False))
    return min(found, own, key=lambda one: one.rms)


def _taken(found: Found, run: Prediction) -> list[str]:
    sentences, log = [], found.problem.log
    if _at_most(found, run):
        sentences.append(f"how far a stuck joint gives: taken as {STIFFEST:g} of its usual way")
    if not log.varies_sum:
        sentences.append(f"effects of P1 + P2, which stays at {np.mean(log.P1 + log.P2) / BAR:.3g} bar")
    return sentences


def _at_most(found: Found, run: Prediction) -> bool:
    """Return whether the weights of the plays are at their bound."""
    return found.problem.operator(found.x, run.weights).weights[0] <= STIFFEST * (1 + 1e-4)


def _blocks(n: int, count: int) -> list[Mask]:
    """Return the masks (n,) of rows that remain without each of `count` contiguous blocks."""
    return [_block(n, count) != block for block in range(count)]


def _block(n: int, count: int) -> Array:
    return np.asarray(np.arange(n) * count // n, float)


def _left_out(found: Found, rows: Mask, judged: Mask, tell: Callable[[str], object]) -> tuple[Errors, Array]:
    """Return the errors of the rows `judged` (n,) predicted from `rows`: RMS, and each (n,) [rad], else NaN."""
    tell("left-out blocks")
    fitted = found.again(rows)
    error = fitted.problem.log.theta - fitted.run(rows).theta
    return _errors(fitted, rows, judged), np.where(judged, error, np.nan)


def _errors(found: Found, used: Mask, judged: Mask) -> Errors:
    run = found.run(used)
    return Errors.of(found.problem.log.theta - run.theta, judged, found.problem.taut(run))


# --- parameters and their intervals ---------------------------------------------------------------------------------


def _named(found: Found, used: Mask) -> dict[str, float]:
    """Return the parameters of the motion by name."""
    problem, run = found.problem, found.run(used)
    H, values = problem.filled(found.x, run.weights), problem.values(found.x)
    named = {name: values[name] for name in problem.free}
    named["loop_width"] = 2 * sum(w * r for w, r in zip(H.weights[1:], H.thresholds, strict=True))
    if not _at_most(found, run):
        named["stuck_slope"] = H.weights[0]
    if isinstance(problem.static, Equilibrium):
        named["gain"] = _slope(found, used)
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
        if (found := here.again(every, other)).rms < _WORSE * here.rms:
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


def _with_regulators(found: Found, sensed: tuple[Array, Array], used: Mask) -> Found:
    """Return the fit with the regulators of the pressures `sensed` (n,); the delay from command to angle is unknown."""
    before, told = found.problem.values(found.x), fit_regulators(found, sensed, found.problem.log.settled)
    late = before["dead_time"] + sum(before[lag] - told[lag] for lag in ("lag_up", "lag_down")) / 2
    less, _ = found.without(*REGULATOR)
    less = replace(less, assumed=tuple((name, told[name]) for name in REGULATOR if name != "dead_time"))
    rest = found.x[len(found.problem.free) :]
    one = found._replace(problem=less, x=np.concatenate([[before[name] for name in less.free], rest]))
    problem, x = one.extended(used, dead_time=max(late, 0.0))
    return search(problem, used, x)


def _apart(total: dict[str, Estimate], found: Found, sensed: tuple[Array, Array]) -> dict[str, Estimate]:
    """Return the estimates with those of the regulators, and the angle's delay split into dead time and reading age."""
    log, every = found.problem.log, found.problem.log.settled
    jackknife = [fit_regulators(found, sensed, rows & every) for rows in _blocks(log.n, _JACKKNIFE)]
    own = _estimates(fit_regulators(found, sensed, every), jackknife, [], {}, log, 0.0)
    own = {name: estimate for name, estimate in own.items() if estimate.value != ABSENT[name]}
    late, dead = total.get("dead_time"), own.get("dead_time", Estimate(0.0, 0.0, 0.0, 0.0))
    if late is None:
        return total | own
    age, std = max(late.value - dead.value, 0.0), float(np.hypot(late.std, dead.std))
    half = float(np.hypot(late.high - late.low, dead.high - dead.low)) / 2
    return total | own | {"reading_age": Estimate(age, std, max(age - half, 0.0), age + half)}
