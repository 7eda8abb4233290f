"""The preview of an arm is what its controller sees of the future: references checked, the dead time gone through.

As `mpc.tracking.preview` for a joint: whatever numbers come, there is a `Task`. What no arm can measure counts as not
measured, and is what was predicted for it; references that cannot be meant are refused, with a warning once.
"""

import warnings
from math import inf
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.arm.model import Arm
from mpc.arm.tracking.prediction import predictor_of
from mpc.tracking.limits import Limits
from mpc.tracking.preview import BadNumbers, Task

_BEYOND = 10 * DEG  # an angle may be read beyond its range
_FASTEST = 60.0  # [rad/s] of a joint
_BELOW, _ABOVE = 0.3 * BAR, 0.5 * BAR  # a pressure may be read beyond the supply
_TURN = 2 * np.pi
_SYMMETRIC = 1e-9  # of the greatest entry


class ArmPreview:
    """A preview of N samples knows the `delay` [samples] of the commands of a controller of `arm`."""

    def __init__(self, arm: Arm, dt: float, N: int, delay: int, limits: Limits) -> None:
        self.arm, self.dt, self.delay, self.limits = arm, dt, delay, limits
        self.ahead = N + delay  # samples of preview wanted
        self.strict = False  # raises `InvalidInput` for references that cannot be meant, instead of warning
        self._under_way = predictor_of(arm, dt, delay)
        (low, high), (left, right) = limits.pressure, limits.theta
        fast, of_muscles = np.full(arm.n, _FASTEST), np.ones(arm.m)
        self._lower = np.concatenate([left - _BEYOND, -fast, (low - _BELOW) * of_muscles])
        self._upper = np.concatenate([right + _BEYOND, fast, (high + _ABOVE) * of_muscles])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._waiting: list[Array] = []  # commands as they will act, oldest first
        self._expected: Array | None = None  # the state that was predicted for the next sample (2n + m,)
        self._blind = inf  # samples since all angles were measured
        self._warned = False

    def task(self, x: Any, q_ref: Any, K_ref: Any, d: Any, ringing: bool = False) -> Task:
        """Check what `step` of the controller was given and look ahead by the dead time."""
        n, expected = self.arm.n, np.nan if self._expected is None else self._expected[0]
        x, seen = self._state(x)
        measured = bool(np.isfinite(seen).all())
        try:
            q, K = self._angles(q_ref), self._stiffness(K_ref)
            torque, refused = self._torques(d), False
        except _Meaningless as meaningless:
            self._warn(meaningless)
            rows = self.ahead + 1
            q, K, torque = np.tile(x[:n], (rows, 1)), np.tile(np.eye(self.arm.tracked), (rows, 1, 1)), np.zeros(n)
            refused = True
        if self._blind == inf and not refused:
            x[:n] = np.clip(q[0], *self.limits.theta)
        torques, then, k = np.tile(torque, (self.ahead + 1, 1)), x, self.delay
        if k:
            self._waiting = self._waiting or [x[2 * n :]] * k
            path = self._under_way.motion(x, np.array(self._waiting), torques[:k]).x
            self._expect(path[1])
            then = path[k]
        blind = self._blind * self.dt
        known: Any = torque
        return Task(seen, then, q[k:], K[k:], torques[k:], measured, blind, refused, float(expected), q[0, 0], known)

    def sent(self, u: Array, x: Array, side: float = 0.0) -> Array:
        """Return the commands `u` (N, m) to send, and remember the first of them."""
        self._waiting = [*self._waiting[1:], u[0]] if self.delay else []
        if not self.delay:
            self._expect(x[1])
        return u

    # --- the pieces -------------------------------------------------------------------------------------------------

    def _state(self, x: Any) -> tuple[Array, Array]:
        """Return the state to start from, and what of it is measured."""
        array, n = np.array(x, float), self.arm.n
        if array.shape != self._lower.shape:
            raise InvalidInput(
                f"x has the shape {array.shape}, not ({self.arm.size},): n = {n} angles [rad], velocities [rad/s], m = "
                f"{self.arm.m} pressures [Pa]"
            )
        known = (self._lower <= array) & (array <= self._upper)  # NaN is not
        self._blind = 0 if known[:n].all() else self._blind + 1
        if known.all():
            return array, array
        otherwise = self._unmeasured if self._expected is None else self._expected
        return np.where(known, array, otherwise), np.where(known, array, np.nan)

    @property
    def _unmeasured(self) -> Array:
        """An unmeasured state is without pressure in the middle of the joints' ranges: nothing is known."""
        (low, _), (left, right) = self.limits.pressure, self.limits.theta
        return np.concatenate([(left + right) / 2, np.zeros(self.arm.n), np.full(self.arm.m, low)])

    def _angles(self, given: Any) -> Array:
        """Return the reference (ahead + 1, n) of the angles."""
        array = self._reference("q_ref", given, (self.arm.n,), "rad")
        if np.abs(array).max() > _TURN:
            raise _Meaningless(f"q_ref = {np.abs(array).max():g} rad is more than a turn; if degrees, divide by 57.3")
        if (endpoint := self.arm.endpoint) is not None:
            try:
                endpoint.check_rank(endpoint.at(np.clip(array, *self.limits.theta)))
            except InvalidInput as singular:
                raise _Meaningless(f"q_ref: {singular}") from None
        return array

    def _stiffness(self, given: Any) -> Array:
        """Return the reference (ahead + 1, n, n) of the stiffness."""
        K = self._reference("K_ref", given, (self.arm.tracked, self.arm.tracked), self.arm.stiffness_unit)
        if np.abs(K - K.swapaxes(-1, -2)).max() > _SYMMETRIC * np.abs(K).max():
            raise _Meaningless("K_ref is not symmetric: a stiffness is, K_ij = K_ji")
        try:
            np.linalg.cholesky(K)
        except np.linalg.LinAlgError:
            raise _Meaningless("K_ref is not positive definite: such a posture does not hold itself") from None
        return K

    def _torques(self, d: Any) -> Array:
        """Return the torques from outside (n,)."""
        torque = checks.floats("d", d, "N·m")
        if torque.shape not in ((), (self.arm.n,)):
            raise InvalidInput(f"d has the shape {torque.shape}; give one torque, or n = {self.arm.n} [N·m]")
        if not np.isfinite(torque).all():
            raise _Meaningless(f"d = {checks.brief(d)} N·m is not finite")
        return np.broadcast_to(torque, (self.arm.n,)).copy()

    def _reference(self, name: str, given: Any, shape: tuple[int, ...], unit: str) -> Array:
        """Return a preview (ahead + 1, *shape) of its own, from one or from a value that is held."""
        array, whole = checks.floats(name, given, unit), (self.ahead + 1, *shape)
        if array.shape not in (shape, whole):
            raise InvalidInput(f"{name} has the shape {array.shape}; give a value {shape} or a preview {whole}")
        if not np.isfinite(array).all():
            raise _Meaningless(f"{name} is not finite")
        return np.broadcast_to(array, whole).copy()

    def _warn(self, reason: Exception) -> None:
        if self.strict:
            raise InvalidInput(str(reason))
        if not self._warned:
            # which is who calls `step`, beyond np.errstate
            warnings.warn(f"{reason}; the pressures are held", BadNumbers, stacklevel=6)
            self._warned = True

    def _expect(self, x: Array) -> None:
        if np.isfinite(x).all():
            self._expected = x


class _Meaningless(Exception):
    """The numbers cannot be meant."""
