"""Weights for the fastest robust loop of a tracking MPC.

`Weights.calm` has one parameter that trades speed for robustness, its detuning s. The sensitivity peak M_s of the loop
on its model falls with it: M_s - 1 is nearly a power of s, so that a secant in logarithms finds M_s = 2 in a few steps.
On joints that differ from the model (`benchmarks.strangers`), errors under load are approximately least there.
"""

import warnings
from collections.abc import Callable
from math import exp, isfinite, log

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput, notice
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine, check_machine
from mpc.observer.filter import Noise
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import Weights
from mpc.tracking.qp.step import CompilingBeside, SlowStep
from mpc.trials.margins import ROBUST, SLACK, linear, linear_model, margins, middle_posture

QUICKEST, SLOWEST = 0.75, 32.0  # detuning; a faster loop has a delay margin below two samples
_LISTEN = 1.5  # [s], enough for the peak
_ACCURACY = 0.02  # of log(M_s - 1)
_SLOPE = -0.7  # usual slope of log(M_s - 1) over log s
_TRIALS = 8


class NotRobust(UserWarning):
    """Warning that no detuning reaches the sensitivity peak that was asked for."""


def robust_weights(
    plant: Machine,
    dt: float = 0.01,
    N: int = 20,
    compensation: Compensation | None = None,
    *,
    posture: tuple[Value, Value] | None = None,
    sensitivity_peak: float = ROBUST,
    noise: Noise | None = None,
    wait: bool = True,
    compiled: bool = True,
) -> Weights:
    """Return `Weights.calm(s)` with the s for which the loop's M_s is `sensitivity_peak` at a `posture`.

    A posture is a pair (θ [rad], K [N·m/rad]), (n,) and (k, k) for an arm; None is that of `usual_postures` nearest to
    the middle. The loop is that of `TrackingMPC(plant, dt, N)` and `KalmanObserver(plant, dt, noise)`, both with
    `compensation`, `wait` and `compiled`; dt is in seconds. s is limited to 0.75 to 32. If the peak remains higher, as
    with a long dead time or an observer that is too fast for the joint, the slowest weights are returned with the
    warning `NotRobust`. Raises `InvalidInput` for a peak that is not above 1, for a machine that holds none of these
    postures, and for values that `TrackingMPC` refuses.
    """
    check_machine(plant)
    checks.instance("compensation", compensation, Compensation | None, "a Compensation")
    wanted = checks.number("sensitivity_peak", sensitivity_peak, "-")
    if not wanted > 1:
        raise InvalidInput(f"sensitivity_peak = {wanted:g} has to be above 1, which no loop with a lag stays below")
    model, told = linear_model(plant), linear(compensation or Compensation())
    place = posture or middle_posture(plant)
    if place is None:
        raise InvalidInput("robust_weights: the machine holds none of its usual postures; give a posture")

    def excess(s: float) -> float:
        """Return log((M_s - 1)/(wanted - 1)); infinite for a loop that does not settle."""
        controller = TrackingMPC(model, dt, N, Weights.calm(s), compensation=told, wait=wait, compiled=compiled)
        observer = KalmanObserver(model, dt, noise, told, wait=wait, compiled=compiled)
        peak = margins(controller, observer, [place], listen=_LISTEN, inertia=False)[0].sensitivity_peak
        return log((peak - 1) / (wanted - 1))

    with warnings.catch_warnings():
        for told_by_the_loop_itself in (CompilingBeside, SlowStep):
            warnings.simplefilter("ignore", told_by_the_loop_itself)
        s, left = _root(excess)
    reached = 1 + (wanted - 1) * exp(left)
    if reached > wanted + SLACK:
        peak = f"M_s = {reached:.2f} at best" if isfinite(reached) else "the loop does not settle"
        notice(
            f"no weights reach M_s = {wanted:g}: {peak} with the slowest ones; use less dead time, a smaller "
            "`Noise.d_walk` of the observer, or `antagonist tune`, which searches both",
            NotRobust,
        )
    return Weights.calm(round(s, 2))


def _root(excess: Callable[[float], float]) -> tuple[float, float]:
    """Return the zero of `excess`, or the end of the range nearest to it, and its last value."""
    at, value, slope = 0.0, excess(1.0), _SLOPE
    for _ in range(_TRIALS):
        step = -value / slope if isfinite(value) else log(2.0)
        after = min(max(at + step, log(QUICKEST)), log(SLOWEST))
        if abs(value) < _ACCURACY or after == at:
            break
        new = excess(exp(after))
        if isfinite(value) and isfinite(new):
            slope = min((new - value) / (after - at), _SLOPE / 4)  # always falling
        at, value = after, new
    return exp(at), value
