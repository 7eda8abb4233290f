"""Named control loops for comparisons, each of a controller and its observer."""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Value
from allocator.errors import InvalidInput, MissingBackend
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.observer.base import Differentiator, Observer
from mpc.observer.filter import CALM_NOISE, Noise
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.base import BaseController
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import CALM, Weights
from mpc.trials.margins import UNHELD, Margins, in_range, linear, linear_model, margins, middle_posture
from mpc.trials.motions.reference import Reference
from mpc.trials.robust import robust_weights
from mpc.trials.simulation import Controller
from mpc.yardsticks.baselines import (
    FeedForwardControl,
    LQRControl,
    PIControl,
    PIDControl,
    PIDGains,
    PredictivePIDControl,
)
from mpc.yardsticks.nonlinear import NonlinearMPC


class Settings(NamedTuple):
    """Settings of all loops."""

    plant: Any  # the model, a `Plant`, or an `Arm` for mpc
    dt: float = 0.01  # [s]
    N: int = 20  # horizon [samples]
    compensation: Compensation = Compensation()
    weights: Weights = Weights()
    noise: Noise = Noise()  # of the observer
    gains: PIDGains | None = None  # of the PIDs; None: each one's own
    solver: Any = None  # of the QPs or the NLPs: a name, options or a value; None: the controller's own choice
    wait: bool = True  # see `TrackingMPC`

    @property
    def calm(self) -> "Settings":
        """Settings with the usual weights and noise for machines that differ from their model."""
        return self._replace(weights=CALM, noise=CALM_NOISE)

    @property
    def sliding(self) -> "Settings":
        """Settings of the linear loop: without friction and dead band, and with one lag for both ways."""
        return self._replace(plant=linear_model(self.plant), compensation=linear(self.compensation))


def _mpc(s: Settings) -> Controller:
    solver = s.solver or "riccati"
    return TrackingMPC(s.plant, s.dt, s.N, s.weights, solver, compensation=s.compensation, wait=s.wait)


def _nmpc(s: Settings) -> Controller:
    return NonlinearMPC(_joint(s), s.dt, s.N, s.weights, s.solver or "ipopt", compensation=s.compensation)


def _joint(s: Settings) -> Plant:
    """Return the model of a joint. Raises `InvalidInput` for an arm."""
    if not isinstance(s.plant, Plant):
        raise InvalidInput(f"this controller is for one joint; an arm with n = {s.plant.n} joints has mpc")
    return s.plant


def _lqr(s: Settings) -> Controller:
    # it does not predict the slew limit, and with the MPC's own weight it would always be at it
    weights = replace(s.weights, rate=4 * s.weights.rate)
    return LQRControl(_joint(s), s.dt, s.compensation, weights)


def _feed_forward(s: Settings) -> Controller:
    return FeedForwardControl(_joint(s), s.dt, s.compensation)


def _with_gains(kind: type[PIDControl]) -> Callable[[Settings], Controller]:
    return lambda s: kind(_joint(s), s.dt, s.compensation, s.gains)


CONTROLLERS: dict[str, tuple[Callable[[Settings], Controller], bool]] = {
    "mpc": (_mpc, True),
    "nmpc": (_nmpc, True),
    "pid": (_with_gains(PIDControl), False),
    "pi": (_with_gains(PIControl), False),
    "predictive-pid": (_with_gains(PredictivePIDControl), True),
    "lqr": (_lqr, True),
    "feedforward": (_feed_forward, False),
}
"""By name: function that builds the loop, and whether it has an observer by default."""

GAINS = {"pid": PIDControl.GAINS, "pi": PIControl.GAINS, "predictive-pid": PredictivePIDControl.GAINS}
"""Usual gains of controllers with gains."""


WEIGHED = "mpc", "nmpc", "lqr"  # controllers with `Weights`
_NEAR = 0.1  # relative distance of a stiffness that still counts as reached


def loop(name: str, settings: Settings, observer: bool | None = None) -> tuple[Controller, Observer]:
    """Return the controller `name` and its observer; `observer` adds or omits the latter (None: the usual choice)."""
    if name not in CONTROLLERS:
        raise MissingBackend("controller", name, CONTROLLERS)
    if settings.solver is not None and name not in ("mpc", "nmpc"):
        raise InvalidInput(f"solver = {settings.solver!r} belongs to the controllers mpc and nmpc, not {name}")
    build, watched = CONTROLLERS[name]
    if watched if observer is None else observer:
        s = settings
        return build(s), KalmanObserver(s.plant, s.dt, s.noise, s.compensation, wait=s.wait)
    return build(settings), Differentiator(settings.dt, settings.plant.n)


def robust(name: str, settings: Settings, reference: Reference | None = None) -> Settings:
    """Return the settings with the weights of `robust_weights`, for a controller `name` with weights.

    The weights are those for the middle of a `reference`, or of the joint for None and for a middle out of reach.
    """
    if name not in WEIGHED:
        return settings
    known = settings.plant, settings.dt, settings.N, settings.compensation
    posture = None if reference is None else _within_reach(settings.plant, reference)
    return settings._replace(weights=robust_weights(*known, posture=posture, noise=settings.noise, wait=settings.wait))


def sliding_margins(
    name: str, settings: Settings, postures: Iterable[tuple[Value, Value]] | None = None
) -> tuple[Margins, ...]:
    """Return the margins of the loop `name` with these settings, without friction and dead band."""
    controller, observer = loop(name, settings.sliding)
    assert isinstance(controller, BaseController)
    return margins(controller, observer, postures)


def margins_in_words(name: str, settings: Settings, reference: Reference, driver: Controller) -> list[str]:
    """Return sentences on the margins of the loop `name`, at the middle of a reference or of the joint, see `robust`.

    Margins need many short runs. An NLP gets no sentence, as these would take minutes. If the `driver`, the loop's
    controller, is not compiled, the only sentence reports that margins are left out.
    """
    if name == "nmpc":
        return []
    if getattr(driver, "implementation", "compiled") != "compiled":
        return ["margins of the loop are computed once its controller is compiled"]
    posture = _within_reach(settings.plant, reference) or middle_posture(settings.plant)
    return [UNHELD] if posture is None else sliding_margins(name, settings, [posture])[0].sentences


def _within_reach(plant: Machine, reference: Reference) -> tuple[Value, Value] | None:
    """Return the middle of a reference, or None beyond the joint's range or limits, at which a loop is not linear."""
    theta, K = reference.middle
    if not in_range(plant, theta):
        return None
    reached = plant.tracked_stiffness(plant.at_rest(theta, K))
    return (theta, K) if np.linalg.norm(reached - K) <= _NEAR * np.linalg.norm(K) else None
