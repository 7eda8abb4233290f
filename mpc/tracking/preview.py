"""The preview is what a controller sees of the future by a `Compensation`: dead time, friction, dead band.

A command given now acts after the dead time. Until then the joint follows the commands under way; their motion
gives the state in which the new command begins to act. The torque on the way and beyond contains the friction of the
intended motion. What is sent is the inverse of the dead band at what should act, within the limits of commands.

Whatever numbers come, there is a task. What no joint can measure counts as not measured, and is what was predicted for
it; before the angle has ever been measured the joint is taken to be at its reference, and whoever takes it for that
is told that the angle is not known. References that cannot be meant are refused, with a warning once.
"""

import warnings
from collections.abc import Callable
from math import inf, isfinite, pi
from typing import Any, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.deferred import Deferred
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.contact import Contact
from mpc.model.plant import NX, Plant
from mpc.observer.gating import Gate
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import PlanStatus

_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] what `checks` lets pass
CORRECTED = 0.1  # [-] of an error of the angle counts as motion that friction opposes


class _Meaningless(Exception):
    """The numbers cannot be meant."""


class BadNumbers(UserWarning):
    """A reference or a torque cannot be meant: the controller holds the pressures."""


class Task(NamedTuple):
    """A task is what a command given now has to deal with, from the moment on at which it acts; N+1 samples."""

    seen: Array  # (4,) what is measured of the state now; NaN for what is not
    x: Array  # (4,) the state then
    theta: Array  # (N+1,) reference [rad]
    K: Array  # (N+1,) reference [N·m/rad]
    d: Array  # (N+1,) torque from outside and of friction [N·m]
    measured: bool  # whether all of the state was
    blind: float  # for how long the angle has not been [s]; inf: never
    refused: bool  # whether the references cannot be meant: those here are substitutes
    expected: float  # the angle that was predicted for now [rad]; NaN at first
    now: float  # the reference of the angle now [rad]
    known: float  # the torque from outside that is known to act [N·m]

    def halted(self, patience: float) -> PlanStatus | None:
        """Return why the pressures have to be held, if they have to; the angle may be predicted for `patience` [s]."""
        if self.refused:
            return PlanStatus.BAD_INPUT
        return PlanStatus.BLIND if self.blind > patience * (1 + 1e-9) else None


class Preview(Deferred):
    """A preview of N samples knows dead time, friction and dead band of `compensation` for a controller of `plant`."""

    _put_off = "waiting", "last_sent", "expected", "_blind", "friction"

    def __init__(self, plant: Plant, dt: float, N: int, compensation: Compensation, limits: Limits) -> None:
        self.plant, self.dt, self.compensation, self.limits = plant, dt, compensation, limits
        self.delay = compensation.delay(dt)
        self.ahead = N + self.delay  # samples of preview wanted
        self.frictionless = compensation.friction.absent
        self._under_way = Predictor(plant, dt, self.delay)
        gate = Gate.of(plant, dt)
        self.strict = False  # raises `InvalidInput` for references that cannot be meant, instead of warning
        self.lower = np.array([gate.lower[0], -gate.max_speed, *gate.lower[1:]])
        self.upper = np.array([gate.upper[0], gate.max_speed, *gate.upper[1:]])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.catch_up()
        self.waiting: list[Array] = []  # commands as they will act, oldest first
        self.last_sent: Array | None = None  # (2,)
        self.expected: Array | None = None  # the state that was predicted for the next sample (4,)
        self._blind = inf  # samples since the angle was measured
        self._warned = False
        self.friction = FrictionState(self.compensation.friction)

    def task(self, x: object, theta_ref: object, K_ref: object, d: object, ringing: bool = False) -> Task:
        """Check what `step` of a controller was given and look ahead by the dead time.

        Of a joint that is `ringing` no correction of the angle is expected to meet friction.
        """
        expected = np.nan if self.expected is None else float(self.expected[0])
        x, seen = self._state(x)
        measured = bool(np.isfinite(seen).all())
        try:
            theta = self._reference("theta_ref", theta_ref, checks.angle, (-_TURN, _TURN))
            K = self._reference("K_ref", K_ref, checks.stiffness, (_LEAST, inf))
            torque, refused = self._torque(d), False
        except _Meaningless as meaningless:
            self._warn(meaningless)
            theta, K = np.full(self.ahead + 1, x[0]), np.ones(self.ahead + 1)
            torque, refused = 0.0, True
        if self._blind == inf and not refused:
            x[0] = min(max(theta[0], self.limits.theta[0]), self.limits.theta[1])
        torques = torque - self._friction_ahead(x, theta, 0.0 if ringing else CORRECTED)
        if self.last_sent is None:
            self.last_sent = self.limits.commandable(x[2:])
        m, then = self.delay, x
        if m:
            self.waiting = self.waiting or [x[2:]] * m
            path = self._under_way.motion(x, np.array(self.waiting), torques[:m]).x
            self._expect(path[1])
            then = path[m]
        blind, now = self._blind * self.dt, float(theta[0])
        return Task(seen, then, theta[m:], K[m:], torques[m:], measured, blind, refused, expected, now, torque)

    def sent(self, u: Array, x: Array, side: float = 0.0) -> Array:
        """Return the commands (N, 2) to send for `u` (N, 2) to act in the states `x` (N+1, 4), as the limits allow.

        A `side` of ±1 says on which edge of the dead band the regulators are to hold `u`, whatever the pressures are.
        """
        self.waiting = [*self.waiting[1:], u[0]] if self.delay else []
        if not self.delay:
            self._expect(x[1])
        if self.compensation.dead_band:
            assert self.last_sent is not None  # `task` comes first
            edge = u + side * self.compensation.dead_band / 2
            u = self.limits.limited(
                self.last_sent, edge if side else self.compensation.inverse_dead_band(u, x[:-1, 2:])
            )
        self.last_sent = u[0]
        return u

    def go_on(self, sent: Array, expected: Array, waiting: list[Array], friction: FrictionState) -> None:
        """Take note of an ordinary sample: what was `sent` (2,), the state `expected` (4,) next, what is `waiting`, and
        the `friction` followed.
        """
        self.last_sent, self.expected, self.waiting, self.friction = sent, expected, waiting, friction
        self._blind = 0

    # --- the pieces -------------------------------------------------------------------------------------------------

    def _state(self, x: object) -> tuple[Array, Array]:
        """Return the state to start from, and what of it is measured."""
        array = np.array(x, float)
        if array.shape != (NX,):
            raise InvalidInput(f"x has the shape {array.shape}, not ({NX},): (theta [rad], omega [rad/s], P1, P2 [Pa])")
        known = (self.lower <= array) & (array <= self.upper)  # NaN is not
        if known[0]:
            self._blind = 0
        else:
            self._blind += 1
        if known.all():
            return array, array
        otherwise = self._unmeasured if self.expected is None else self.expected
        return np.where(known, array, otherwise), np.where(known, array, np.nan)

    @property
    def _unmeasured(self) -> Array:
        """An unmeasured state (4,) is without pressure in the middle of the joint range: nothing is known."""
        low, _ = self.limits.pressure
        return np.array([np.mean(self.limits.theta), 0.0, low, low])

    def _torque(self, d: object) -> float:
        """Return the torque from outside."""
        if type(d) is float and isfinite(d):
            return d
        torque = checks.floats("d", d, "N·m")
        if torque.shape != ():
            raise InvalidInput(f"d has the shape {torque.shape}; give one torque [N·m]")
        if not np.isfinite(torque):
            raise _Meaningless(f"d = {float(torque)} N·m is not finite")
        return float(torque)

    def _warn(self, reason: Exception) -> None:
        if self.strict:
            raise InvalidInput(str(reason))
        if not self._warned:
            warnings.warn(
                f"{reason}; the pressures are held", BadNumbers, stacklevel=6
            )  # which is who calls `step`, beyond np.errstate
            self._warned = True

    def _expect(self, x: Array) -> None:
        if all(map(isfinite, x.tolist())):
            self.expected = x

    def _reference(
        self, name: str, given: object, check: Callable[[str, Any], Array], usual: tuple[float, float]
    ) -> Array:
        """Return a preview (ahead + 1,) of its own; `check` is what finds out what is wrong with one that looks
        unusual.
        """
        if type(given) is np.ndarray and given.dtype == np.float64 and given.shape == (self.ahead + 1,):
            values = given.tolist()
            if isfinite(sum(values)) and usual[0] <= min(values) and max(values) <= usual[1]:
                return given.copy()
        reference = checks.floats(name, given, "SI unit")
        if reference.shape not in ((), (self.ahead + 1,)):
            raise InvalidInput(
                f"{name} has the shape {reference.shape}; give one value or a preview ({self.ahead + 1},)"
            )
        try:
            check(name, given)
        except InvalidInput as wrong:
            raise _Meaningless(str(wrong)) from None
        return np.full(self.ahead + 1, reference) if reference.shape == () else reference.copy()

    def _friction_ahead(self, x: Array, theta: Array, corrected: float) -> Array:
        """Return the friction torque (ahead + 1,) [N·m] if the joint moves on from `x` as the preview `theta` does.

        It has to come back to the preview first. At rest presliding friction makes the joint several times as stiff as
        its muscles, and an error would hardly move a controller that does not count with it; one that counts with all
        of it would shake a joint without friction.
        """
        if self.frictionless:
            return np.zeros(self.ahead + 1)
        contact, friction = Contact(self.plant, x), self.compensation.friction
        memory = self.friction.follow(float(x[0]), contact)
        back = theta[0] + corrected * (float(x[0]) - theta[0])
        torques = friction.torque(friction.along(memory, np.append(back, theta[1:]), contact), contact)
        # the motion from a state without a finite torque will not be, either: the controller finds that out
        return np.asarray(torques) if np.isfinite(torques).all() else np.zeros(theta.shape)
