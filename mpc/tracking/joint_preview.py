"""The preview of a joint knows a `Compensation`: dead time, friction, dead band.

The torque on the way and beyond contains the friction of the intended motion. What is sent is the inverse of the dead
band at what should act, within the limits of commands.
"""

from collections.abc import Callable
from math import inf, isfinite, pi
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.compensation import Compensation, FrictionState
from mpc.model.contact import Contact
from mpc.model.plant import NU, Plant
from mpc.observer.gating import Gate
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.preview import Meaningless, Preview

_TURN, _LEAST = 2 * pi, 1e-300  # [rad], [N·m/rad] what `checks` lets pass
CORRECTED = 0.1  # [-] of an error of the angle counts as motion that friction opposes


class JointPreview(Preview):
    """A preview of N samples knows dead time, friction and dead band of `compensation` for a controller of `plant`."""

    _put_off = "waiting", "last_sent", "expected", "_blind", "friction"

    def __init__(self, plant: Plant, dt: float, N: int, compensation: Compensation, limits: Limits) -> None:
        self.plant, self.compensation = plant, compensation
        self.frictionless = compensation.friction.absent
        gate = Gate.of(plant, dt)
        lower = np.array([gate.lower[0], -gate.max_speed, *gate.lower[1:]])
        upper = np.array([gate.upper[0], gate.max_speed, *gate.upper[1:]])
        super().__init__((1, NU), (lower, upper), Predictor(plant, dt, compensation.delay(dt)), N, limits)

    def reset(self) -> None:
        """Forget the past."""
        super().reset()
        self.friction = FrictionState(self.compensation.friction)

    def sent(self, u: Array, x: Array, side: float = 0.0) -> Array:
        """Return the commands (N, 2) to send for `u` (N, 2) to act in the states `x` (N+1, 4), as the limits allow."""
        before = self.last_sent
        u = super().sent(u, x, side)
        if self.compensation.dead_band:
            assert before is not None  # `task` comes first
            edge = u + side * self.compensation.dead_band / 2
            u = self.limits.limited(before, edge if side else self.compensation.inverse_dead_band(u, x[:-1, 2:]))
            self.last_sent = u[0]
        return u

    def go_on(self, sent: Array, expected: Array, waiting: list[Array], friction: FrictionState) -> None:
        """Take note of an ordinary sample: what was `sent` (2,), the state `expected` (4,) next, what is `waiting`, and
        the `friction` followed.
        """
        self.last_sent, self.expected, self.waiting, self.friction = sent, expected, waiting, friction
        self._blind = 0

    def _angles(self, given: Any) -> Array:
        return self._reference("theta_ref", given, checks.angle, (-_TURN, _TURN))

    def _stiffness(self, given: Any) -> Array:
        return self._reference("K_ref", given, checks.stiffness, (_LEAST, inf))

    def _substitutes(self, x: Array) -> tuple[Array, Array, float]:
        return np.full(self.ahead + 1, x[0]), np.ones(self.ahead + 1), 0.0

    def _torques(self, x: Array, theta: Array, torque: float, ringing: bool) -> Array:
        return torque - self._friction_ahead(x, theta, 0.0 if ringing else CORRECTED)

    def _torque(self, d: object) -> float:
        """Return the torque from outside."""
        if type(d) is float and isfinite(d):
            return d
        torque = checks.floats("d", d, "N·m")
        if torque.shape != ():
            raise InvalidInput(f"d has the shape {torque.shape}; give one torque [N·m]")
        if not np.isfinite(torque):
            raise Meaningless(f"d = {float(torque)} N·m is not finite")
        return float(torque)

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
            raise Meaningless(str(wrong)) from None
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
