"""A moving joint is fitted to its log here: the search, what is left out in turn, and what the log does not show."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask
from allocator.identification.motion.problem import UPPER, MotionProblem, Prediction
from allocator.identification.motion.result import Errors, Estimate, MotionFit
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.search import Found, extended, search, without
from allocator.identification.motion.static import Difference, Equilibrium
from allocator.joint.antagonist import AntagonistJoint
from allocator.units import BAR

TRAINED = 0.6  # the share of the log that the held-out rest is predicted from
LEFT_OUT = 5  # contiguous blocks, left out in turn to be predicted
_JACKKNIFE = 10  # contiguous blocks, left out in turn for the intervals
_WORSE = 1.01  # by which the error grows at least without something that the log shows
_UNITS = {"lag_up": "s", "lag_down": "s", "dead_time": "s", "dead_band": "Pa", "base": "-", "damping": "s"}
_UNITS |= {"inertia": "s²", "loop_width": "rad", "stuck_slope": "-", "gain": "-"}
_SIGNS = {  # what is told together, and the sentence if it is not
    ("lag_up", "lag_down"): "the lags: steps of the pressures would show them",
    ("dead_time",): "the dead time: steps of the pressures, at a higher sample rate, would show it",
    ("dead_band",): "the dead band: small steps up and down about one pressure would show it",
    ("base",): "that the hysteresis grows with P1 + P2: sweeps at several co-contractions would show it",
}
_DYNAMIC = ("damping", "inertia")
STEPS = 4 + LEFT_OUT + _JACKKNIFE + len(_SIGNS)  # of `progress`


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
    progress: Callable[[str], Any] | None = None,
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
    static = Difference(greatest) if joint is None else Equilibrium(joint, greatest)
    every, early = np.ones(log.n, bool), np.arange(log.n) < TRAINED * log.n
    tell("first rows")
    trained = _fitted(MotionProblem(log, static), early)
    tell("all rows")
    task, found = _with_dynamics(_fitted(trained.problem, every, trained.x), every, tell)
    tell("held out")
    held = _fitted(*_like(task.problem, trained), early)
    errors = {"all": _errors(task.problem, task.x, every, every), "held": _held(held, early)}
    blocks = [_left_out(task, rows, tell) for rows in _blocks(log.n, LEFT_OUT)]
    estimates = _estimates(task, [_fit_without(task, rows, tell) for rows in _blocks(log.n, _JACKKNIFE)])
    unseen = _unseen(task, found, every, tell)
    run = task.problem.run(task.x, every)
    return MotionFit(
        operator=task.problem.operator(task.x, run.weights),
        parameters={name: e._replace(seen=not any(name in names for names in unseen)) for name, e in estimates.items()},
        error=errors["all"],
        held_out=errors["held"],
        blocks=tuple(blocks),
        unseen=tuple(unseen.values()),
        converged=found.converged,
        given=joint,
        scale_known=scale_known,
        problem=task.problem,
        x=task.x,
    )


def _fitted(problem: MotionProblem, used: Mask, x: Array | None = None) -> _Task:
    return _Task(problem, search(problem, used, x).x)


def _with_dynamics(task: _Task, used: Mask, tell: Callable[[str], Any]) -> tuple[_Task, Found]:
    """Return the fit with inertia and damping if they better it, else without."""
    plain = search(task.problem, used, task.x)
    tell("inertia and damping")
    more, x = extended(task.problem, plain.x, damping=0.02, inertia=1e-3)
    found = search(more, used, x)
    if found.rms * _WORSE**2 < plain.rms:
        return _Task(more, found.x), found
    return _Task(task.problem, plain.x), plain


def _like(problem: MotionProblem, task: _Task) -> tuple[MotionProblem, Mask, Array]:
    """Return what searches the unknowns of `problem` on the rows of the first search, from what that has found."""
    more = {name: 0.02 if name == "damping" else 1e-3 for name in _DYNAMIC if name in problem.free}
    extended_problem, x = extended(task.problem, task.x, **more)
    return extended_problem, np.arange(problem.log.n) < TRAINED * problem.log.n, x


def _blocks(n: int, count: int) -> list[Mask]:
    """Return which rows (n,) are left in each time, without one of `count` contiguous blocks."""
    place = np.arange(n) * count // n
    return [place != block for block in range(count)]


def _fit_without(task: _Task, rows: Mask, tell: Callable[[str], Any]) -> dict[str, float]:
    tell("intervals")
    x = search(task.problem, rows, task.x).x
    return _named(task.problem, x, task.problem.run(x, rows))


def _left_out(task: _Task, rows: Mask, tell: Callable[[str], Any]) -> Errors:
    tell("left-out blocks")
    return _errors(task.problem, search(task.problem, rows, task.x).x, rows, ~rows)


def _held(task: _Task, early: Mask) -> Errors:
    return _errors(task.problem, task.x, early, ~early)


def _errors(problem: MotionProblem, x: Array, used: Mask, judged: Mask) -> Errors:
    run = problem.run(x, used)
    return Errors.of(problem.log.theta - run.theta, judged, problem.taut(run))


# --- parameters and their intervals ---------------------------------------------------------------------------------


def _named(problem: MotionProblem, x: Array, run: Prediction) -> dict[str, float]:
    """Return all that is told about the motion, by name."""
    H, values = problem.operator(x, run.weights), problem.values(x)
    named = {name: values[name] for name in problem.free}
    named["loop_width"] = 2 * sum(w * r for w, r in zip(H.weights[1:], H.thresholds, strict=True))
    named["stuck_slope"] = H.weights[0]
    if isinstance(problem.static, Equilibrium):
        q = problem.static(run.P1, run.P2)
        named["gain"] = float(np.polyfit(q, run.static, 1)[0])
    return named


def _estimates(task: _Task, others: list[dict[str, float]]) -> dict[str, Estimate]:
    """Return values and 95 % intervals by the jackknife over contiguous blocks: errors are correlated within them."""
    from scipy.stats import t as student

    n, here = len(others), _named(task.problem, task.x, task.problem.run(task.x, np.ones(task.problem.log.n, bool)))
    factor = float(student.ppf(0.975, n - 1))
    found = {}
    for name, value in here.items():
        spread = np.array([other[name] for other in others])
        std = float(np.sqrt((n - 1) / n * np.sum((spread - spread.mean()) ** 2)))
        low, high = max(value - factor * std, 0.0), min(value + factor * std, UPPER.get(name, np.inf))
        found[name] = Estimate(value, std, low, high, _UNITS[name], True)
    return found


def _unseen(task: _Task, found: Found, used: Mask, tell: Callable[[str], Any]) -> dict[tuple[str, ...], str]:
    """Return the sentences about what the log does not show: without it the rest explains the angle as well."""
    unseen = {}
    for names, sentence in _SIGNS.items():
        tell("what is seen")
        problem, x = without(task.problem, task.x, *names)
        if search(problem, used, x).rms < _WORSE * found.rms:
            unseen[names] = sentence
    if "inertia" not in task.problem.free:
        unseen[_DYNAMIC] = "inertia and damping: faster steps, of a joint that swings, would show them"
    if not task.problem.log.varies_sum:
        unseen[("sum",)] = f"what depends on P1 + P2, which stays at {_mean_sum(task.problem.log) / BAR:.3g} bar"
    return unseen


def _mean_sum(log: MotionLog) -> float:
    return float(np.mean(log.P1 + log.P2))


__all__ = ["LEFT_OUT", "STEPS", "TRAINED", "fit_motion"]
