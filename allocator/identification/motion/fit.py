"""Fit of a moving joint to its log: search, blocks left out in turn, and unobservable parameters."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.motion import intervals
from allocator.identification.motion.doubt import Bands
from allocator.identification.motion.problem import REGULATOR, STIFFEST, MotionProblem, Prediction
from allocator.identification.motion.result import TRAINED, Errors, MotionFit
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.search import Found, fit_regulators, search, sensed_at
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.assumption import with_volumes
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.units import BAR

_MOST_SUPPLY = 2.0  # greatest pressure of a log relative to the supply of the given joint
LEFT_OUT = 5  # contiguous blocks, left out in turn for prediction
_MUCH_WORSE = 1.05  # least growth of the error without inertia and damping, small values of which imitate lag
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
_DYNAMIC = {"damping": 0.02, "inertia": 1e-3}  # [s], [s²] to start from
_USUAL = {"lag_up": 0.1, "lag_down": 0.13, "dead_time": 0.03, "dead_band": 0.08 * BAR, "filling": 0.15 / BAR}
_USUAL |= {"lag_ratio": 1.0, "volume": 1.3, "base": 0.8, "damping": 0.03, "inertia": 6e-3}  # starts of all at once
_BY_SUM = "base", "lag_ratio"  # identified only if P1 + P2 varies
_SPRING = 0.02  # κ_i of each stop
STEPS = 9 + LEFT_OUT + intervals.JACKKNIFE + 2 * len(_SIGNS)  # of `progress`, at most


def fit_motion(
    t: ArrayLike,
    theta: ArrayLike,
    P1: ArrayLike,
    P2: ArrayLike,
    *,
    joint: AntagonistJoint | None = None,
    zero: float = 0.0,
    hold_zero: bool = False,
    gravity: Gravity = NO_GRAVITY,
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
    hold_zero
        Whether that reading is known, and stays.
    gravity
        The known gravity of the link of `joint`, `JointFit.gravity`, which its muscles do not contain.
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
    every = log.settled
    early = every & (np.arange(log.n) < TRAINED * log.n)
    full, taken, kinds = joint, "", [False]
    if joint is not None and gas is not False:
        (full, taken), kinds = with_volumes(joint), [True] if gas else [False, True]
    problems = [MotionProblem.of(log, _static(full, log.greatest_pressure, held, zero, gravity)) for held in kinds]
    sensed = None if measured is None or not log.varies_speed else sensed_at(log.t, t, measured)
    trained, unseen = _trained(problems, early, sensed, tell)
    tell("all rows")
    found = trained.again(every)
    others = intervals.without_blocks(log.n, LEFT_OUT)
    left_out = [_left_out(found, rows & every, every & ~rows, tell) for rows in others]
    errors = np.where(every, np.nansum([error for _, error in left_out], axis=0), np.nan)
    parameters = intervals.parameters_of(found, MotionLog.checked(t, theta, P1, P2, medians=False), tell)
    if sensed is not None:
        parameters = intervals.with_regulators(parameters, found, sensed)
    run = found.run(every)
    return MotionFit(
        operator=found.problem.filled(found.x, run.weights),
        parameters=parameters,
        error=_errors(found, every, every),
        held_out=_errors(trained, early, every & ~early),
        blocks=tuple(errors for errors, _ in left_out),
        bands=Bands.of(errors, intervals.block_of(log.n, LEFT_OUT), found.problem.taut(run)),
        unseen=(*unseen, *_taken(found, run), *([taken] if taken and found.problem.gas else [])),
        converged=found.converged,
        given=full if found.problem.gas else joint,
        zero=zero,
        gravity=gravity,
        hold_zero=hold_zero,
        scale_known=scale_known,
        problem=found.problem,
        x=found.x,
        x_early=trained.x,
    )


def _static(
    joint: AntagonistJoint | None, greatest: float, gas: bool, zero: float, gravity: Gravity
) -> Difference | Equilibrium:
    """Return the variable of the static angle's polynomial, for pressures up to `greatest` [Pa]."""
    if joint is None:
        return Difference(greatest)
    if greatest > _MOST_SUPPLY * (supply := joint.pressure_limits[1]):
        raise InvalidInput(
            f"the pressures of the log go up to {greatest / BAR:.3g} bar, those of the joint up to {supply / BAR:.3g} "
            "bar: check the unit of P1 and P2 [Pa], or the joint's supply"
        )
    return Equilibrium(joint, greatest, gas, zero, gravity)


def _trained(
    problems: list[MotionProblem], used: Mask, sensed: tuple[Array, Array] | None, tell: Callable[[str], object]
) -> tuple[Found, list[str]]:
    """Return the best fit to the rows `used`, with the regulators of `sensed` pressures, and what it leaves open."""
    found, unseen = min((_seen(problem, used, tell) for problem in problems), key=lambda seen: seen[0].rms)
    if sensed is not None:
        found, unseen = _with_regulators(found, sensed, used), [one for one in unseen if one not in _OF_REGULATORS]
    elif "dead_time" in found.problem.free:
        unseen.append(_AGE)
    _check_sign(found, used)
    return found, unseen


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


def _check_sign(found: Found, used: Mask) -> None:
    if found.slope(used) < 0:
        raise InvalidInput(
            "θ falls with P1 and rises with P2: the muscles are swapped, or the angle has the other sign; pass P2 as "
            "P1 and P1 as P2, or -theta"
        )


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
    return other if other.rms < intervals.WORSE * best else found


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
    if found.problem.stiffest(found.x, run.weights):
        sentences.append(f"how far a stuck joint gives: taken as {STIFFEST:g} of its usual way")
    if not log.varies_sum:
        sentences.append(f"effects of P1 + P2, which stays at {np.mean(log.P1 + log.P2) / BAR:.3g} bar")
    return sentences


def _left_out(found: Found, rows: Mask, judged: Mask, tell: Callable[[str], object]) -> tuple[Errors, Array]:
    """Return the errors of the rows `judged` (n,) predicted from `rows`: RMS, and each (n,) [rad], else NaN."""
    tell("left-out blocks")
    fitted = found.again(rows)
    error = fitted.problem.log.theta - fitted.run(rows).theta
    return _errors(fitted, rows, judged), np.where(judged, error, np.nan)


def _errors(found: Found, used: Mask, judged: Mask) -> Errors:
    run = found.run(used)
    return Errors.of(found.problem.log.theta - run.theta, judged, found.problem.taut(run))
