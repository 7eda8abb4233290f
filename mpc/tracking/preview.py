"""The preview is what a controller sees of the future: references checked, the dead time gone through.

A command given now acts after the dead time. Until then the plant follows the commands under way; their motion gives
the state in which the new command begins to act. The torque of a joint on the way and beyond contains the friction of
the intended motion. The commands that are sent are the inverse of the dead band at those that should act, within the
limits of commands.

Whatever numbers come, there is a task. What no plant can measure counts as not measured, and is what was predicted for
it; before the angles have ever been measured the plant is taken to be at its reference, and whoever takes it for that
is told that the angles are not known. References that cannot be meant are refused, with a warning once.
"""

import warnings
from collections.abc import Callable
from math import inf, isfinite, pi
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from mpc.deferred import Deferred
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.friction.contact import Contacts
from mpc.model.machine import Machine
from mpc.observer.gating import Gate
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import PlanStatus

_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] what `checks` lets pass
CORRECTED = 0.1  # [-] of an error of the angle counts as motion that friction opposes


class Meaningless(Exception):
    """The numbers cannot be meant."""


class BadNumbers(UserWarning):
    """A reference or a torque cannot be meant: the controller holds the pressures."""


class Task(NamedTuple):
    """A task is what a command given now has to deal with, from the moment on at which it acts; N+1 samples.

    Of n joints rows θ (N+1, n) and d (N+1, n), and K (N+1, n, n).
    """

    seen: Array  # (2n + m,) what is measured of the state now; NaN for what is not
    x: Array  # (2n + m,) the state then
    theta: Array  # (N+1,) reference [rad]
    K: Array  # (N+1,) reference [N·m/rad]
    d: Array  # (N+1,) torque from outside and of friction [N·m]
    measured: bool  # whether all of the state was
    blind: float  # for how long not all angles have been [s]; inf: never
    refused: bool  # whether the references cannot be meant: those here are substitutes
    expected: Array  # (n,) the angles as they were predicted for now [rad]; NaN at first
    now: float  # its reference now [rad]
    known: Value  # the torque from outside that is known to act [N·m], (n,) of arms

    def halted(self, patience: float) -> PlanStatus | None:
        """Return why the pressures have to be held, if they have to; the angle may be predicted for `patience` [s]."""
        if self.refused:
            return PlanStatus.BAD_INPUT
        return PlanStatus.BLIND if self.blind > patience * (1 + 1e-9) else None


class Preview(Deferred):
    """A preview of N samples knows dead time, friction and dead band of `compensation` for a controller of `plant`."""

    _put_off = "waiting", "last_sent", "expected", "_blind", "frictions"

    def __init__(self, plant: Machine, dt: float, N: int, compensation: Compensation, limits: Limits) -> None:
        self.plant, self.compensation, self.n, self.m = plant, compensation, plant.n, plant.m
        self.frictionless, self._known_friction = compensation.frictionless, compensation.of_joints(plant.n)
        self._contacts = None if self.frictionless else Contacts(plant)
        gate, fast = Gate.of(plant, dt), np.ones(self.n)
        ends = (gate.lower, -gate.max_speed * fast), (gate.upper, gate.max_speed * fast)
        self.lower, self.upper = (np.concatenate([read[: self.n], speed, read[self.n :]]) for read, speed in ends)
        self.dt, self.delay, self.limits = dt, compensation.delay(dt), limits
        self._under_way = Predictor(plant, dt, self.delay)
        self.ahead: int = N + self.delay  # samples of preview wanted
        self.strict = False  # raises `InvalidInput` for references that cannot be meant, instead of warning
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.catch_up()
        self.waiting: list[Array] = []  # commands as they will act, oldest first
        self.last_sent: Array | None = None  # (m,)
        self.expected: Array | None = None  # the state that was predicted for the next sample (2n + m,)
        self._blind = inf  # samples since all angles were measured
        self._warned = False
        self.frictions = tuple(map(FrictionState, self._known_friction))  # of each joint

    def task(self, x: object, theta_ref: object, K_ref: object, d: object, ringing: bool = False) -> Task:
        """Check what `step` of a controller was given and look ahead by the dead time.

        Of a joint that is `ringing` no correction of the angle is expected to meet friction.
        """
        expected = np.full(self.n, np.nan) if self.expected is None else self.expected[: self.n]
        x, seen = self._state(x)
        measured = bool(np.isfinite(seen).all())
        try:
            theta, K, torque, refused = self._angles(theta_ref), self._stiffness(K_ref), self._torque(d), False
        except Meaningless as meaningless:
            self._warn(meaningless)
            (theta, K, torque), refused = self._substitutes(x), True
        if self._blind == inf and not refused:
            x[: self.n] = np.clip(theta[0], *self.limits.theta)
        torques = self._torques(x, theta, torque, ringing)
        if self.last_sent is None:
            self.last_sent = self.limits.commandable(x[2 * self.n :])
        k, then = self.delay, x
        if k:
            self.waiting = self.waiting or [x[2 * self.n :]] * k
            path = self._under_way.motion(x, np.array(self.waiting), torques[:k]).x
            self._expect(path[1])
            then = path[k]
        blind, now = self._blind * self.dt, float(np.ravel(theta[0])[0])
        return Task(seen, then, theta[k:], K[k:], torques[k:], measured, blind, refused, expected, now, torque)

    def sent(self, u: Array, x: Array, side: float = 0.0) -> Array:
        """Return the commands (N, m) to send for `u` (N, m) to act in the states `x` (N+1, 2n + m), as the limits
        allow.

        A `side` of ±1 says on which edge of the dead band the regulators are to hold `u`, whatever the pressures are.
        """
        self.waiting = [*self.waiting[1:], u[0]] if self.delay else []
        if not self.delay:
            self._expect(x[1])
        if self.compensation.dead_band:
            assert self.last_sent is not None  # `task` comes first
            edge = u + side * self.compensation.dead_band / 2
            wanted = edge if side else self.compensation.inverse_dead_band(u, x[:-1, 2 * self.n :])
            u = self.limits.limited(self.last_sent, wanted)
        self.last_sent = u[0]
        return u

    def go_on(self, sent: Array, expected: Array, waiting: list[Array], frictions: tuple[FrictionState, ...]) -> None:
        """Take note of an ordinary sample: what was `sent` (m,), the state `expected` (2n + m,) next, what is
        `waiting`, and the `frictions` of the joints followed.
        """
        self.last_sent, self.expected, self.waiting, self.frictions = sent, expected, waiting, frictions
        self._blind = 0

    # --- references and torques -------------------------------------------------------------------------------------

    def _angles(self, given: object) -> Array:
        """Return the reference (ahead + 1, …) of the angles. Raises `Meaningless`, as the next two do."""
        return self._reference("theta_ref", given, self.plant.angle_shape, self.plant.check_angles, (-_TURN, _TURN))

    def _stiffness(self, given: object) -> Array:
        """Return the reference (ahead + 1, …) of the stiffness."""
        return self._reference("K_ref", given, self.plant.stiffness_shape, self.plant.check_stiffness, (_LEAST, inf))

    def _torque(self, d: object) -> Value:
        """Return the torque from outside, (n,) of an arm."""
        shape = self.plant.angle_shape
        if type(d) is float and isfinite(d) and shape == ():
            return d
        torque = checks.floats("d", d, "N·m")
        if torque.shape not in ((), shape):
            several = f", or n = {self.n} of them" if shape else ""
            raise InvalidInput(f"d has the shape {torque.shape}; give one torque [N·m]{several}")
        if not np.isfinite(torque).all():
            raise Meaningless(f"d = {checks.brief(d)} N·m is not finite")
        return np.broadcast_to(torque, shape).copy() if shape else float(torque)

    def _reference(
        self,
        name: str,
        given: object,
        shape: tuple[int, ...],
        check: Callable[[str, Value], None],
        usual: tuple[float, float],
    ) -> Array:
        """Return a preview (ahead + 1, *shape) of its own, from one or from a value that is held.

        `check` finds out what is wrong with one; numbers in the `usual` range pass at once.
        """
        whole = (self.ahead + 1, *shape)
        if shape == () and type(given) is np.ndarray and given.dtype == np.float64 and given.shape == whole:
            values = given.tolist()
            if isfinite(sum(values)) and usual[0] <= min(values) and max(values) <= usual[1]:
                return given.copy()
        reference = checks.floats(name, given, "SI unit")
        if reference.shape not in (shape, whole):
            value = f"a value {shape}" if shape else "one value"
            raise InvalidInput(f"{name} has the shape {reference.shape}; give {value} or a preview {whole}")
        try:
            check(name, given if shape == () else np.broadcast_to(reference, whole))
        except InvalidInput as wrong:
            raise Meaningless(str(wrong)) from None
        return np.broadcast_to(reference, whole).copy()

    def _substitutes(self, x: Array) -> tuple[Array, Array, Value]:
        """Return angles, stiffness and torque in the place of those that cannot be meant."""
        shape, square, rows = self.plant.angle_shape, self.plant.stiffness_shape, (self.ahead + 1,)
        K = np.eye(square[0]) if square else np.ones(())
        angles = np.broadcast_to(x[: self.n].reshape(shape), rows + shape).copy()
        return angles, np.broadcast_to(K, rows + square).copy(), np.zeros(shape) if shape else 0.0

    def _torques(self, x: Array, theta: Array, torque: Value, ringing: bool) -> Array:
        """Return the torque (ahead + 1, …) from outside and of friction."""
        outside = np.broadcast_to(torque, theta.shape)
        return outside - self._friction_ahead(x, theta, 0.0 if ringing else CORRECTED)

    def _friction_ahead(self, x: Array, theta: Array, corrected: float) -> Array:
        """Return the friction torque (ahead + 1, …) [N·m] if the joints move on from `x` as the preview `theta` does.

        They have to come back to the preview first. At rest presliding friction makes a joint several times as stiff as
        its muscles, and an error would hardly move a controller that does not count with it; one that counts with all
        of it would shake a joint without friction.
        """
        if self._contacts is None:
            return np.zeros(theta.shape)
        ways = theta.reshape(len(theta), self.n)
        torques = np.empty(ways.shape)
        for i, (state, loads) in enumerate(zip(self.frictions, self._contacts(x), strict=True)):
            friction, now, way = state.friction, float(x[i]), ways[:, i]
            back = way[0] + corrected * (now - way[0])
            memories = friction.along(state.follow(now, loads), np.append(back, way[1:]), loads)
            torques[:, i] = friction.torque(memories, loads)
        # the motion from a state without a finite torque will not be, either: the controller finds that out
        return torques.reshape(theta.shape) if np.isfinite(torques).all() else np.zeros(theta.shape)

    # --- the pieces -------------------------------------------------------------------------------------------------

    def _state(self, x: object) -> tuple[Array, Array]:
        """Return the state to start from, and what of it is measured."""
        array = np.array(x, float)
        if array.shape != self.lower.shape:
            raise InvalidInput(
                f"x has the shape {array.shape}, not {self.lower.shape}: n = {self.n} angles [rad], as many velocities "
                f"[rad/s], m = {self.m} pressures [Pa]"
            )
        known = (self.lower <= array) & (array <= self.upper)  # NaN is not
        self._blind = 0 if known[: self.n].all() else self._blind + 1
        if known.all():
            return array, array
        otherwise = self._unmeasured if self.expected is None else self.expected
        return np.where(known, array, otherwise), np.where(known, array, np.nan)

    @property
    def _unmeasured(self) -> Array:
        """An unmeasured state is without pressure in the middle of all ranges: nothing is known."""
        (low, _), (left, right) = self.limits.pressure, self.limits.theta
        return np.concatenate([np.atleast_1d((left + right) / 2), np.zeros(self.n), np.full(self.m, low)])

    def _warn(self, reason: Exception) -> None:
        if self.strict:
            raise InvalidInput(str(reason))
        if not self._warned:
            # the caller of `step`, beyond np.errstate
            warnings.warn(f"{reason}; the pressures are held", BadNumbers, stacklevel=6)
            self._warned = True

    def _expect(self, x: Array) -> None:
        if all(map(isfinite, x.tolist())):
            self.expected = x
