"""A moving joint is fitted to its log here: the search, what is left out in turn, and what the log does not show."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.motion.doubt import Bands, possible_changes
from allocator.identification.motion.problem import LOWER, STIFFEST, UPPER, MotionProblem, Prediction
from allocator.identification.motion.result import TRAINED, Errors, Estimate, MotionFit
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.search import Found, extended, search, without
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.joint.antagonist import AntagonistJoint
from allocator.units import BAR, DEG

_MOST_SUPPLY = 2.0  # greatest pressure of a log in the supply of the joint that is given
LEFT_OUT = 5  # contiguous blocks, left out in turn to be predicted
_JACKKNIFE = 10  # contiguous blocks, left out in turn for the intervals
_WORSE = 1.02  # by which the error grows at least without something that the log shows,
_MUCH_WORSE = 1.05  # and without inertia and damping, of which a little can always pass for lag
_UNITS = {"lag_up": "s", "lag_down": "s", "dead_time": "s", "dead_band": "Pa", "base": "-", "damping": "s"}
_UNITS |= {"filling": "s/Pa", "inertia": "s²", "loop_width": "rad", "stuck_slope": "-", "gain": "-"}
_SIGNS = {  # what is told together, and the sentence if it is not; what may pass for something else comes first
    ("dead_band",): "the dead band: small steps up and down about one pressure would show it",
    ("base",): "that the hysteresis grows with P1 + P2: sweeps at several co-contractions would show it",
    ("dead_time",): "the dead time: steps of the pressures, at a higher sample rate, would show it",
    ("lag_up", "lag_down"): "the lags: steps of the pressures would show them",
}
_FILLING = {"filling": 0.1 / BAR}  # [s/Pa] to start from
_MODEL = 0.05  # share by which fits err of plants of another structure, however long the log: `benchmarks.motion_truth`
_MODEL_OF_LOOPS = 0.1  # of what hysteresis is
_TRADED = 0.2  # share of the dead band that hysteresis may pass for, and by which the error may grow
_AT_BOUND = 1.001  # times the least value of the search, up to which an estimate is at its bound
_TAPER = 0.3  # of the widths, at the ends of the range
_LOOPS = ("loop_width", "stuck_slope", "base")
_TIMES = ("dead_time", "lag_up", "lag_down")  # that pass for each other within a sample
_DYNAMIC = {"damping": 0.02, "inertia": 1e-3}  # [s], [s²] to start from
STEPS = 5 + LEFT_OUT + _JACKKNIFE + len(_SIGNS)  # of `progress`


class _Task(NamedTuple):
    problem: MotionProblem
    x: Array


def fit_motion(
    t: ArrayLike,
    theta: ArrayLike,
    P1: ArrayLike,
    P2: ArrayLike,
    *,
    joint: AntagonistJoint | None = None,
    scale_known: bool = True,
    progress: Callable[[str], object] | None = None,
) -> MotionFit:
    """Fit lags, dead time, dead band, hysteresis, inertia and damping to the log of a joint that moves without load.

    Everything is found by free-run prediction: the angle is predicted from the pressures alone, over the whole log.

    Parameters
    ----------
    t
        Times [s], increasing; arrays (n,), as are the others.
    theta
        The angle as the encoder shows it [rad].
    P1, P2
        Pressures of agonist and antagonist [Pa, gauge], commanded or measured: lags are from them to the angle.
    joint
        A joint of the same kind, as `fit_joint` gives it, whose static angle is then corrected; its muscles are fitted
        anew when `MotionFit.joint` is asked for. Without one the static angle is a polynomial, linear in its
        coefficients, of the pressures, and there is no plant to save.
    scale_known
        Whether the joint's forces are right and not only in proportion; where not, neither are those of the result.
    progress
        Called with a word before each of `STEPS` steps.

    Raises
    ------
    InvalidInput
        For what is no log, and for one that moves too little to tell anything, with the experiment that would.
    """
    log = MotionLog.checked(t, theta, P1, P2)
    tell = progress or (lambda step: None)
    greatest = log.greatest_pressure
    if joint is not None:
        _check_supply(joint.pressure_limits[1], greatest)
    static = Difference(greatest) if joint is None else Equilibrium(joint, greatest)
    every = log.settled
    early = every & (np.arange(log.n) < TRAINED * log.n)
    trained, unseen = _seen(MotionProblem.of(log, static), early, tell)
    _check_sign(trained, early)
    tell("all rows")
    found = search(trained.problem, every, trained.x)
    task = _Task(trained.problem, found.x)
    left_out = [_left_out(task, rows & every, every & ~rows, tell) for rows in _blocks(log.n, LEFT_OUT)]
    jackknife = [_fit_without(task, rows & every, tell) for rows in _blocks(log.n, _JACKKNIFE)]
    choices = _other_choices(task, MotionLog.checked(t, theta, P1, P2, medians=False), found.rms, tell)
    run = task.problem.run(task.x, every)
    changes = possible_changes(task.problem, task.x, every, lambda x: _named(_Task(task.problem, x), every))
    errors = np.where(every, np.nansum([error for _, error in left_out], axis=0), np.nan)
    return MotionFit(
        operator=task.problem.operator(task.x, run.weights),
        parameters=_estimates(_named(task, every), jackknife, choices, changes, log, found.rms * DEG),
        error=_errors(task, every, every),
        held_out=_errors(trained, early, every & ~early),
        blocks=tuple(errors for errors, _ in left_out),
        bands=Bands.of(errors, _block(log.n, LEFT_OUT), task.problem.taut(run)),
        unseen=(*unseen, *_taken(task, run)),
        converged=found.converged,
        given=joint,
        scale_known=scale_known,
        problem=task.problem,
        x=task.x,
        x_early=trained.x,
    )


def _check_supply(supply: float, greatest: float) -> None:
    """Refuse pressures [Pa] of the log that the joint's supply does not give."""
    if greatest > _MOST_SUPPLY * supply:
        raise InvalidInput(
            f"the pressures of the log go up to {greatest / BAR:.3g} bar, those of the joint up to "
            f"{supply / BAR:.3g} bar: check the unit of P1 and P2 [Pa], or the joint's supply"
        )


def _check_sign(task: _Task, used: Mask) -> None:
    """Refuse a static angle that falls where P1 rises, or P2 falls."""
    if _slope(task.problem, task.problem.run(task.x, used)) < 0:
        raise InvalidInput(
            "θ falls with P1 and rises with P2: the muscles are swapped, or the angle has the other sign; pass P2 as "
            "P1 and P1 as P2, or -theta"
        )


def _slope(problem: MotionProblem, run: Prediction) -> float:
    """Return by how much the static angle [rad] rises with q, in the mean over the rows."""
    return float(np.polyfit(problem.static(run.P1, run.P2), run.static, 1)[0])


def _seen(problem: MotionProblem, used: Mask, tell: Callable[[str], object]) -> tuple[_Task, list[str]]:
    """Return the fit with what the rows `used` show, and the sentences about what they do not."""
    tell("first rows")
    found = search(problem, used)
    unseen: list[str] = []
    tell("inertia and damping")
    problem, found = _if_better(problem, found, used, **_DYNAMIC)
    tell("filling")
    if "lag_up" in problem.free:
        problem, found = _if_better(problem, found, used, **_FILLING)
    if "filling" not in problem.free:
        unseen.append("how fast the valves can fill the muscles: great steps of the pressures would show it")
    best = found.rms
    for names, sentence in _SIGNS.items():
        tell("what is seen")
        if not any(name in problem.free for name in names):
            unseen.append(sentence)
            continue
        problem, found = _if_needed(problem, found, best, used, names)
        if not any(name in problem.free for name in names):
            unseen.append(sentence)
    if not problem.swings:
        problem, found = _if_better(problem, found, used, **_DYNAMIC)
    if not problem.swings:
        unseen.append("inertia and damping: faster steps, of a joint that swings, show them")
    else:
        problem, found = _if_needed(problem, found, best, used, ("inertia",))
        if "inertia" not in problem.free:
            unseen.append("the inertia: faster steps, of a joint that swings, show it")
    return _Task(problem, found.x), unseen


def _if_needed(
    problem: MotionProblem, found: Found, best: float, used: Mask, names: tuple[str, ...]
) -> tuple[MotionProblem, Found]:
    """Return the fit without these unknowns, unless its error is greater than `best` then."""
    less, x = without(problem, found.x, *names)
    other = search(less, used, x)
    return (less, other) if other.rms < _WORSE * best else (problem, found)


def _if_better(problem: MotionProblem, found: Found, used: Mask, **more: float) -> tuple[MotionProblem, Found]:
    """Return the fit with these unknowns besides, which begin at these values, if the log shows them."""
    if not problem.log.varies_speed:
        return problem, found
    richer, x = extended(problem, found.x, used, **more)
    other = search(richer, used, x)
    return (richer, other) if other.rms * _MUCH_WORSE < found.rms else (problem, found)


def _taken(task: _Task, run: Prediction) -> list[str]:
    """Return the sentences about what was taken for granted."""
    sentences = []
    if _at_most(task, run):
        sentences.append(f"how far a stuck joint gives: taken as {STIFFEST:g} of its usual way")
    if not task.problem.log.varies_sum:
        total = float(np.mean(task.problem.log.P1 + task.problem.log.P2))
        sentences.append(f"what depends on P1 + P2, which stays at {total / BAR:.3g} bar")
    return sentences


def _at_most(task: _Task, run: Prediction) -> bool:
    """Return whether the plays have all the weight that they may have."""
    return task.problem.operator(task.x, run.weights).weights[0] <= STIFFEST * (1 + 1e-6)


def _blocks(n: int, count: int) -> list[Mask]:
    """Return which rows (n,) are left in each time, without one of `count` contiguous blocks."""
    return [_block(n, count) != block for block in range(count)]


def _block(n: int, count: int) -> Array:
    """Return in which of `count` contiguous blocks each row (n,) is."""
    return np.asarray(np.arange(n) * count // n, float)


def _fitted(task: _Task, used: Mask) -> _Task:
    return _Task(task.problem, search(task.problem, used, task.x).x)


def _fit_without(task: _Task, rows: Mask, tell: Callable[[str], object]) -> dict[str, float]:
    tell("intervals")
    return _named(_fitted(task, rows), rows)


def _left_out(task: _Task, rows: Mask, judged: Mask, tell: Callable[[str], object]) -> tuple[Errors, Array]:
    """Return the errors of the rows `judged` (n,) predicted from `rows`: RMS, and each one (n,) [rad], else NaN."""
    tell("left-out blocks")
    fitted = _fitted(task, rows)
    error = task.problem.log.theta - fitted.problem.run(fitted.x, rows).theta
    return _errors(fitted, rows, judged), np.where(judged, error, np.nan)


def _errors(task: _Task, used: Mask, judged: Mask) -> Errors:
    run = task.problem.run(task.x, used)
    return Errors.of(task.problem.log.theta - run.theta, judged, task.problem.taut(run))


# --- parameters and their intervals ---------------------------------------------------------------------------------


def _named(task: _Task, used: Mask) -> dict[str, float]:
    """Return all that is told about the motion, by name."""
    problem, run = task.problem, task.problem.run(task.x, used)
    H, values = problem.operator(task.x, run.weights), problem.values(task.x)
    named = {name: values[name] for name in problem.free}
    named["loop_width"] = 2 * sum(w * r for w, r in zip(H.weights[1:], H.thresholds, strict=True))
    if not _at_most(task, run):
        named["stuck_slope"] = H.weights[0]
    if isinstance(problem.static, Equilibrium):
        named["gain"] = _slope(problem, run)
    return named


def _other_choices(task: _Task, noisy: MotionLog, rms: float, tell: Callable[[str], object]) -> list[dict[str, float]]:
    """Return what is found with other choices: other half widths, the pressures with their noise, one lag for both
    directions if it explains the log as well, less of a dead band where it looks like hysteresis, and widths that are
    less at the ends of the range, as those of friction are where muscles stiffen.
    """
    tell("other choices")
    problem, every = task.problem, task.problem.log.settled
    others = [_fitted(_Task(replace(problem, finest=problem.finest * 1.3), task.x), every)]
    if not (np.array_equal(noisy.P1, problem.log.P1) and np.array_equal(noisy.P2, problem.log.P2)):
        others.append(_fitted(_Task(replace(problem, log=noisy), task.x), every))
    if "lag_up" in problem.free:
        found = search(replace(problem, one_lag=True), every, task.x)
        if found.rms < _WORSE * rms:
            others.append(_Task(replace(problem, one_lag=True), found.x))
    if "dead_band" in problem.free and problem.log.swept:  # in sweeps it looks like hysteresis
        less, x = without(problem, task.x, "dead_band")
        less = replace(less, assumed=(("dead_band", (1 - _TRADED) * problem.values(task.x)["dead_band"]),))
        found = search(less, every, x)
        if found.rms < (1 + _TRADED) * rms:  # what is left is the error of the model, which proves no more
            others.append(_Task(less, found.x))
    tapered = replace(problem, taper=_TAPER)
    found = search(tapered, every, task.x)
    if found.rms < _WORSE * rms:
        others.append(_Task(tapered, found.x))
    return [_named(other, every) | dict(other.problem.assumed) for other in others]


def _estimates(
    here: dict[str, float],
    jackknife: list[dict[str, float]],
    choices: list[dict[str, float]],
    changes: dict[str, float],
    log: MotionLog,
    rms: float,
) -> dict[str, Estimate]:
    """Return values and 95 % intervals by the jackknife over contiguous blocks, since errors are correlated in them.

    Each of these counts as one standard deviation more: the effect of another choice; the `changes` that the structure
    of the residual leaves possible; the time within a sample at which a command began to act; the usual distance of the
    model from a joint; the spread of the stiffness; for the loop, the unexplained angle `rms` [rad].
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
        found[name] = Estimate(value, std, low, high, _UNITS[name])
    return found
