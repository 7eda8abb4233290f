"""Named control loops for comparisons, each of a controller and its observer.

`robust_weights` are those of the fastest robust loop of a tracking MPC. `Weights.calm` has one parameter that trades
speed for robustness, its detuning s. The sensitivity peak M_s of the loop on its model falls with it: M_s - 1 is nearly
a power of s, so that a secant in logarithms finds M_s = 2 in a few steps. On joints that differ from the model
(`benchmarks.strangers`), errors under load are approximately least there.

Tuned numbers of a control loop: their names, the resulting settings, and the table [tuning] of a plant's file.

[tuning]                       # SI units; written by `antagonist tune`, used by `track`, `run` and `export`
controller = "mpc"             # the loop of these numbers
theta_error = 0.0028           # error that costs one half, 1/√weight [rad]; and so on
…

These numbers take the place of the defaults.
"""

import warnings
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from math import exp, isfinite, log
from types import MappingProxyType
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput, MissingBackend
from allocator.files.text import FilePath
from allocator.files.toml import Table, section
from allocator.units import BAR, DEG
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine, check_machine
from mpc.model.plant import Plant
from mpc.observer.base import Differentiator, Observer
from mpc.observer.filter import CALM_NOISE, Noise
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.base import BaseController
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.cost import CALM, Weights
from mpc.tracking.qp.step import CompilingBeside, SlowStep
from mpc.trials.margins import ROBUST, Margins, in_range, linear, linear_model, margins, usual_postures
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller
from mpc.yardsticks.baselines import (
    FeedForwardControl,
    LQRControl,
    NonlinearMPC,
    PIControl,
    PIDControl,
    PIDGains,
    PredictivePIDControl,
)


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

    There are none if the `driver`, the loop's controller, is slow: an NLP, or a step without compiled code.
    """
    if name == "nmpc" or getattr(driver, "implementation", "compiled") != "compiled":
        return []
    posture = _within_reach(settings.plant, reference) or usual_postures(settings.plant)[1]
    return sliding_margins(name, settings, [posture])[0].sentences


def _within_reach(plant: Machine, reference: Reference) -> tuple[Value, Value] | None:
    """Return the middle of a reference, or None beyond the joint's range or limits, at which a loop is not linear."""
    theta, K = reference.middle
    if not in_range(plant, theta):
        return None
    reached = plant.tracked_stiffness(plant.at_rest(theta, K))
    return (theta, K) if np.linalg.norm(reached - K) <= _NEAR * np.linalg.norm(K) else None


QUICKEST, SLOWEST = 0.75, 32.0  # detuning; a faster loop has a delay margin below two samples
_LISTEN = 1.5  # [s], enough for the peak
_ACCURACY = 0.02  # of log(M_s - 1)
_SLOPE = -0.7  # usual slope of log(M_s - 1) over log s
_TRIALS = 8


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

    A posture is a pair (θ [rad], K [N·m/rad]), (n,) and (k, k) for an arm; None is the middle of `usual_postures`. The
    loop is that of `TrackingMPC(plant, dt, N)` and `KalmanObserver(plant, dt, noise)`, both with `compensation`, `wait`
    and `compiled`; dt is in seconds. s is limited to 0.75 to 32, so that a long dead time can lead to a greater peak.
    Raises `InvalidInput` for a peak that is not above 1, and for values that `TrackingMPC` refuses.
    """
    check_machine(plant)
    checks.instance("compensation", compensation, Compensation | None, "a Compensation")
    wanted = checks.number("sensitivity_peak", sensitivity_peak, "-")
    if not wanted > 1:
        raise InvalidInput(f"sensitivity_peak = {wanted:g} has to be above 1, which no loop with a lag stays below")
    model, told = linear_model(plant), linear(compensation or Compensation())
    place = posture or usual_postures(plant)[1]

    def excess(s: float) -> float:
        """Return log((M_s - 1)/(wanted - 1)); infinite for a loop that does not settle."""
        controller = TrackingMPC(model, dt, N, Weights.calm(s), compensation=told, wait=wait, compiled=compiled)
        observer = KalmanObserver(model, dt, noise, told, wait=wait, compiled=compiled)
        peak = margins(controller, observer, [place], listen=_LISTEN, inertia=False)[0].sensitivity_peak
        return log((peak - 1) / (wanted - 1))

    with warnings.catch_warnings():
        for told_by_the_loop_itself in (CompilingBeside, SlowStep):
            warnings.simplefilter("ignore", told_by_the_loop_itself)
        return Weights.calm(round(_root(excess), 2))


def _root(excess: Callable[[float], float]) -> float:
    """Return the zero of `excess`, or the end of the range nearest to it."""
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
    return exp(at)


TABLE = "tuning"


class Parameter(NamedTuple):
    """Tunable number on a logarithmic scale."""

    start: Callable[[Settings], float]  # its default
    low: float
    high: float
    unit: str  # in SI
    shown: float = 1.0  # the tables' unit, in SI
    symbol: str = ""  # symbol of that unit


@dataclass(frozen=True)
class Tuning:
    """Tuned numbers of one kind of loop, SI units; immutable.

    Raises `InvalidInput` for loops without such numbers, other names, and numbers that are not positive.
    """

    controller: str
    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        """Check names and numbers."""
        parameters = parameters_of(self.controller)
        if set(self.numbers) != set(parameters):
            raise InvalidInput(f"the tuning of {self.controller} consists of {', '.join(parameters)}")
        numbers = {name: checks.positive(name, self.numbers[name], p.unit) for name, p in parameters.items()}
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the numbers as a dictionary."""
        return type(self), (self.controller, dict(self.numbers))

    @classmethod
    def start(cls, controller: str, settings: Settings) -> Self:
        """Return the defaults."""
        return cls(controller, {name: p.start(settings) for name, p in parameters_of(controller).items()})

    @classmethod
    def load(cls, path: FilePath) -> Self | None:
        """Read the table [tuning] of a plant's file; None if it has none. Raises `InvalidFile`."""
        table = Table.read(path).table(TABLE)
        if table is None:
            return None
        entries = dict(table.entries)
        controller = entries.pop("controller", "")
        try:
            return cls(controller, entries)
        except (InvalidInput, MissingBackend) as error:
            raise table.fault(error) from None

    def lines(self) -> list[str]:
        """Return the lines of the table [tuning]."""
        return section(TABLE, {"controller": self.controller, **self.numbers}, "SI units; from `antagonist tune`")

    def applied(self, settings: Settings) -> Settings:
        """Return the settings with these numbers."""
        n = self.numbers
        errors = {name: n[f"{name}_error"] ** -2 for name in ("theta", "omega", "rate") if f"{name}_error" in n}
        noises = {name: n[key] for name, key in (("theta", "theta_noise"), ("d_walk", "d_walk")) if key in n}
        gains = {name: n[name] for name in _GAIN_UNITS if name in n}
        known, share = settings.compensation, n["friction_share"]
        frictions = tuple(one.share(share) for one in known.frictions)
        return settings._replace(
            weights=replace(settings.weights, **errors),
            noise=replace(settings.noise, **noises),
            gains=replace(PIDGains(1.0, 0.0, 0.0, 0.0), **gains) if gains else settings.gains,
            compensation=replace(known, friction=known.friction.share(share), frictions=frictions),
        )

    @property
    def summary(self) -> str:
        """One line with the numbers, in the units of tables."""
        parameters = parameters_of(self.controller)
        shown = (
            f"{name.replace('_', ' ')} {value / p.shown:.3g} {p.symbol}".strip()
            for (name, value), p in zip(self.numbers.items(), parameters.values(), strict=True)
        )
        return f"tuning of {self.controller} for this plant: {', '.join(shown)}"


def parameters_of(controller: str) -> Mapping[str, Parameter]:
    """Return the tunable numbers of a controller. Raises `MissingBackend` for an unknown one."""
    if controller not in list(TUNABLE):
        raise MissingBackend("controller to tune", controller, TUNABLE)
    return TUNABLE[controller]


_GAIN_UNITS = {"proportional": "N·m/rad", "integral": "N·m/rad/s", "derivative": "N·m·s/rad", "filter_time": "s"}
_RANGE = 20.0  # range of gains, relative to the usual ones


def _gains(controller: str) -> dict[str, Parameter]:
    """Return the nonzero gains of a PID."""
    usual = {name: float(getattr(GAINS[controller], name)) for name in _GAIN_UNITS}
    return {
        name: Parameter(lambda s, at=at: at, at / _RANGE, at * _RANGE, _GAIN_UNITS[name], 1.0, _GAIN_UNITS[name])  # type: ignore[misc]
        for name, at in usual.items()
        if at
    }


_SHARE = {"friction_share": Parameter(lambda s: 1.0, 0.5, 1.0, "-")}
_NOISES = {
    "theta_noise": Parameter(lambda s: s.noise.theta, 0.001 * DEG, 0.2 * DEG, "rad", DEG, "°"),
    "d_walk": Parameter(lambda s: s.noise.d_walk, 0.05, 20.0, "N·m/√s", 1.0, "N·m/√s"),
}
_ERRORS = {
    "theta_error": Parameter(lambda s: s.weights.theta**-0.5, 0.01 * DEG, 2 * DEG, "rad", DEG, "°"),
    "omega_error": Parameter(lambda s: s.weights.omega**-0.5, 0.5 * DEG, 200 * DEG, "rad/s", DEG, "°/s"),
    "rate_error": Parameter(lambda s: s.weights.rate**-0.5, 0.02 * BAR, 20 * BAR, "Pa/s", BAR, "bar/s"),
}

TUNABLE: Mapping[str, Mapping[str, Parameter]] = {
    "mpc": _ERRORS | _NOISES | _SHARE,
    "lqr": _ERRORS | _NOISES | _SHARE,
    "predictive-pid": _gains("predictive-pid") | _NOISES | _SHARE,
    "pid": _gains("pid") | _SHARE,
    "pi": _gains("pi") | _SHARE,
}
"""Tunable numbers, by the names of the loops."""
