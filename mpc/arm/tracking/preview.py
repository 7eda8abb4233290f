"""The preview of an arm checks what an arm is asked for; it has neither friction nor a dead band."""

from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.arm.model import Arm
from mpc.arm.tracking.prediction import predictor_of
from mpc.tracking.limits import Limits
from mpc.tracking.preview import Meaningless, Preview

_BEYOND = 10 * DEG  # an angle may be read beyond its range
_FASTEST = 60.0  # [rad/s] of a joint
_BELOW, _ABOVE = 0.3 * BAR, 0.5 * BAR  # a pressure may be read beyond the supply
_TURN = 2 * np.pi
_SYMMETRIC = 1e-9  # of the greatest entry


class ArmPreview(Preview):
    """A preview of N samples knows the `delay` [samples] of the commands of a controller of `arm`."""

    def __init__(self, arm: Arm, dt: float, N: int, delay: int, limits: Limits) -> None:
        self.arm = arm
        (low, high), (left, right) = limits.pressure, limits.theta
        fast, of_muscles = np.full(arm.n, _FASTEST), np.ones(arm.m)
        lower = np.concatenate([left - _BEYOND, -fast, (low - _BELOW) * of_muscles])
        upper = np.concatenate([right + _BEYOND, fast, (high + _ABOVE) * of_muscles])
        super().__init__((arm.n, arm.m), (lower, upper), predictor_of(arm, dt, delay), N, limits)

    def _angles(self, given: Any) -> Array:
        """Return the reference (ahead + 1, n) of the angles."""
        array = self._reference("q_ref", given, (self.arm.n,), "rad")
        if np.abs(array).max() > _TURN:
            raise Meaningless(f"q_ref = {np.abs(array).max():g} rad is more than a turn; if degrees, divide by 57.3")
        if (endpoint := self.arm.endpoint) is not None:
            try:
                endpoint.check_rank(endpoint.at(np.clip(array, *self.limits.theta)))
            except InvalidInput as singular:
                raise Meaningless(f"q_ref: {singular}") from None
        return array

    def _stiffness(self, given: Any) -> Array:
        """Return the reference (ahead + 1, n, n) of the stiffness."""
        K = self._reference("K_ref", given, (self.arm.tracked, self.arm.tracked), self.arm.stiffness_unit)
        if np.abs(K - K.swapaxes(-1, -2)).max() > _SYMMETRIC * np.abs(K).max():
            raise Meaningless("K_ref is not symmetric: a stiffness is, K_ij = K_ji")
        try:
            np.linalg.cholesky(K)
        except np.linalg.LinAlgError:
            raise Meaningless("K_ref is not positive definite: such a posture does not hold itself") from None
        return K

    def _torque(self, d: Any) -> Array:
        """Return the torques from outside (n,)."""
        torque = checks.floats("d", d, "N·m")
        if torque.shape not in ((), (self.arm.n,)):
            raise InvalidInput(f"d has the shape {torque.shape}; give one torque, or n = {self.arm.n} [N·m]")
        if not np.isfinite(torque).all():
            raise Meaningless(f"d = {checks.brief(d)} N·m is not finite")
        return np.broadcast_to(torque, (self.arm.n,)).copy()

    def _reference(self, name: str, given: Any, shape: tuple[int, ...], unit: str) -> Array:
        """Return a preview (ahead + 1, *shape) of its own, from one or from a value that is held."""
        array, whole = checks.floats(name, given, unit), (self.ahead + 1, *shape)
        if array.shape not in (shape, whole):
            raise InvalidInput(f"{name} has the shape {array.shape}; give a value {shape} or a preview {whole}")
        if not np.isfinite(array).all():
            raise Meaningless(f"{name} is not finite")
        return np.broadcast_to(array, whole).copy()

    def _substitutes(self, x: Array) -> tuple[Array, Array, Array]:
        rows = self.ahead + 1
        K = np.tile(np.eye(self.arm.tracked), (rows, 1, 1))
        return np.tile(x[: self.n], (rows, 1)), K, np.zeros(self.n)

    def _torques(self, x: Array, theta: Array, torque: Array, ringing: bool) -> Array:
        return np.tile(torque, (self.ahead + 1, 1))
