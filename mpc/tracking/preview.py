"""Checked references, and the prediction over the dead time.

A command given now acts after the dead time. Until then the plant follows the commands under way; their motion gives
the state in which the new command begins to act. The torque of a joint during and after the dead time contains the
friction of the intended motion. The commands sent are the inverse of the dead band at those that should act, within the
limits of commands.

Any numbers give a task. Measurements that no plant can produce count as missing and are replaced by the prediction.
Before the angles have ever been measured, the plant is assumed to be at its reference, and the task reports that the
angles are unknown. Implausible references are refused, with one warning.
"""

import warnings
from collections.abc import Callable
from math import inf, isfinite, pi
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.friction.contact import Contacts
from mpc.model.machine import Machine
from mpc.observer.base import BadNumbers
from mpc.observer.gating import Gate
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import Deferred, PlanStatus

_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] range that `checks` accepts
CORRECTED = 0.1  # [-] of an angle error counts as motion that friction opposes


class Meaningless(Exception):
    """Implausible numbers."""


class Task(NamedTuple):
    """State, references and torques over N+1 samples, from the time at which a command given now acts.

    For n joints, θ and d are (N+1, n) and K is (N+1, n, n).
    """

    seen: Array  # (2n + m,) measured state now; NaN for missing entries
    x: Array  # (2n + m,) state at the first sample
    theta: Array  # (N+1,) reference [rad]
    K: Array  # (N+1,) reference [N·m/rad]
    d: Array  # (N+1,) external and friction torque [N·m]
    measured: bool  # whether the whole state was measured
    blind: float  # time since all angles were measured [s]; inf: never
    refused: bool  # whether the references are implausible and were replaced by substitutes
    expected: Array  # (n,) angles predicted for now [rad]; NaN at first
    now: float  # reference of the first angle now [rad]
    known: Value  # known external torque [N·m], (n,) for arms
    sent: Array  # (m,) commands sent last; at first the measured pressures [Pa]

    def halted(self, patience: float) -> PlanStatus | None:
        """Return the reason for holding the pressures, or None; the angle may be predicted for `patience` [s]."""
        if self.refused:
            return PlanStatus.BAD_INPUT
        return PlanStatus.BLIND if self.blind > patience * (1 + 1e-9) else None


class Preview(Deferred):
    """Preview of N samples for a controller of `plant`, with dead time, friction and dead band of `compensation`."""

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
        self.ahead: int = N + self.delay  # samples of preview after the present one
        self.strict = False  # whether to raise `InvalidInput` for implausible references instead of warning
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self.catch_up()
        self.waiting: list[Array] = []  # commands as they will act, oldest first
        self.last_sent: Array | None = None  # (m,)
        self.expected: Array | None = None  # state predicted for the next sample (2n + m,)
        self._blind = inf  # samples since all angles were measured
        self._warned = False
        self.frictions = tuple(map(FrictionState, self._known_friction))  # of each joint

    def task(self, x: object, theta_ref: object, K_ref: object, d: object, ringing: bool = False) -> Task:
        """Check the arguments of a controller's `step` and predict over the dead time.

        For a `ringing` joint, no friction is expected to oppose corrections of the angle.
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
            path = self._under_way.states(x, np.array(self.waiting), torques[:k])
            self._expect(path[1])
            then = path[k]
        blind, now = self._blind * self.dt, float(np.ravel(theta[0])[0])
        return Task(
            seen, then, theta[k:], K[k:], torques[k:], measured, blind, refused, expected, now, torque, self.last_sent
        )

    def sent(self, u: Array, x: Array, side: float = 0.0) -> Array:
        """Return the commands (N, m) to send for `u` (N, m) to act in the states `x` (N+1, 2n + m), within the limits.

        A `side` of ±1 selects the edge of the dead band on which the regulators hold `u`, whatever the pressures are.
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
        """Record an ordinary sample: commands `sent` (m,), the state `expected` (2n + m,) next, commands `waiting`, and
        the updated `frictions` of the joints.
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
        """Return the external torque, (n,) for an arm."""
        shape = self.plant.angle_shape
        if type(d) is float and isfinite(d) and shape == ():
            return d
        if type(d) is np.ndarray and d.dtype == np.float64 and d.shape == shape != () and np.isfinite(d).all():
            return d.copy()
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
        """Return a new preview (ahead + 1, *shape) from a preview or from a value to hold.

        `check` raises `InvalidInput` for implausible values; numbers in the `usual` range need no check.
        """
        whole = (self.ahead + 1, *shape)
        ready = type(given) is np.ndarray and given.dtype == np.float64 and given.shape == whole
        if shape == () and ready:
            values = given.tolist()  # type: ignore[attr-defined]
            if isfinite(sum(values)) and usual[0] <= min(values) and max(values) <= usual[1]:
                return np.array(given)
        reference = np.array(given) if ready else checks.floats(name, given, "SI unit")
        if reference.shape not in (shape, whole):
            value = f"a value {shape}" if shape else "one value"
            raise InvalidInput(f"{name} has the shape {reference.shape}; give {value} or a preview {whole}")
        try:
            check(name, given if shape == () else reference if ready else np.broadcast_to(reference, whole))
        except InvalidInput as wrong:
            raise Meaningless(str(wrong)) from None
        return reference if ready else np.broadcast_to(reference, whole).copy()

    def _substitutes(self, x: Array) -> tuple[Array, Array, Value]:
        """Return substitutes for implausible angles, stiffness and torque."""
        shape, square, rows = self.plant.angle_shape, self.plant.stiffness_shape, (self.ahead + 1,)
        K = np.eye(square[0]) if square else np.ones(())
        angles = np.broadcast_to(x[: self.n].reshape(shape), rows + shape).copy()
        return angles, np.broadcast_to(K, rows + square).copy(), np.zeros(shape) if shape else 0.0

    def _torques(self, x: Array, theta: Array, torque: Value, ringing: bool) -> Array:
        """Return the external and friction torque (ahead + 1, …)."""
        outside = np.full(theta.shape, torque)
        return outside - self._friction_ahead(x, theta, 0.0 if ringing else CORRECTED)

    def _friction_ahead(self, x: Array, theta: Array, corrected: float) -> Array:
        """Return the friction torque (ahead + 1, …) [N·m] if the joints move on from `x` as the preview `theta` does.

        The angles return to the preview first. At rest, presliding friction makes a joint several times as stiff as its
        muscles. A controller that neglects it hardly corrects errors; one that assumes all of it shakes a joint without
        friction.
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
        # a torque that is not finite leads to a motion that is not: the controller rejects that one
        return torques.reshape(theta.shape) if np.isfinite(torques).all() else np.zeros(theta.shape)

    # --- the pieces -------------------------------------------------------------------------------------------------

    def _state(self, x: object) -> tuple[Array, Array]:
        """Return the initial state, and its measured entries (others NaN)."""
        array = np.array(checks.floats("x", x, "rad, rad/s, Pa"))
        if array.shape != self.lower.shape:
            raise InvalidInput(
                f"x has the shape {array.shape}, not {self.lower.shape}: n = {self.n} angles [rad], as many velocities "
                f"[rad/s], m = {self.m} pressures [Pa]"
            )
        known = (self.lower <= array) & (array <= self.upper)  # False for NaN
        self._blind = 0 if known[: self.n].all() else self._blind + 1
        if known.all():
            return array, array
        otherwise = self._unmeasured if self.expected is None else self.expected
        return np.where(known, array, otherwise), np.where(known, array, np.nan)

    @property
    def _unmeasured(self) -> Array:
        """State before any measurement: no pressure, in the middle of all ranges."""
        (low, _), (left, right) = self.limits.pressure, self.limits.theta
        return np.concatenate([np.atleast_1d((left + right) / 2), np.zeros(self.n), np.full(self.m, low)])

    def _warn(self, reason: Exception) -> None:
        if self.strict:
            raise InvalidInput(str(reason))
        if not self._warned:
            # points to the caller of `step`, beyond np.errstate
            warnings.warn(f"{reason}; the pressures are held", BadNumbers, stacklevel=6)
            self._warned = True

    def _expect(self, x: Array) -> None:
        if all(map(isfinite, x.tolist())):
            self.expected = x
