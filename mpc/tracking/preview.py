"""The preview is what a controller sees of the future: references checked, the dead time gone through.

A command given now acts after the dead time. Until then the plant follows the commands under way; their motion gives
the state in which the new command begins to act.

Whatever numbers come, there is a task. What no plant can measure counts as not measured, and is what was predicted for
it; before the angles have ever been measured the plant is taken to be at its reference, and whoever takes it for that
is told that the angles are not known. References that cannot be meant are refused, with a warning once.
"""

import warnings
from abc import ABC, abstractmethod
from math import inf, isfinite
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.deferred import Deferred
from mpc.tracking.limits import Limits
from mpc.tracking.plan import PlanStatus


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
    expected: float  # the first angle as it was predicted for now [rad]; NaN at first
    now: float  # its reference now [rad]
    known: Any  # the torque from outside that is known to act [N·m], (n,) of arms

    def halted(self, patience: float) -> PlanStatus | None:
        """Return why the pressures have to be held, if they have to; the angle may be predicted for `patience` [s]."""
        if self.refused:
            return PlanStatus.BAD_INPUT
        return PlanStatus.BLIND if self.blind > patience * (1 + 1e-9) else None


class Preview(Deferred, ABC):
    """A preview of N samples knows the `delay` [samples] of the commands; joints and arms say what numbers may be."""

    def __init__(
        self, sizes: tuple[int, int], gate: tuple[Array, Array], under_way: Any, N: int, limits: Limits
    ) -> None:
        """`sizes` are n and m; `gate` the least and the greatest state (2n + m,) that can be measured; `under_way`
        predicts over the dead time.
        """
        (self.n, self.m), (self.lower, self.upper) = sizes, gate
        self.dt: float = under_way.dt
        self.delay: int = under_way.N
        self.limits, self._under_way = limits, under_way
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

    def task(self, x: object, theta_ref: object, K_ref: object, d: object, ringing: bool = False) -> Task:
        """Check what `step` of a controller was given and look ahead by the dead time.

        Of a joint that is `ringing` no correction of the angle is expected to meet friction.
        """
        expected = np.nan if self.expected is None else float(self.expected[0])
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
        """Return the commands (N, m) to send for `u` (N, m) to act in the states `x` (N+1, 2n + m).

        A `side` of ±1 says on which edge of the dead band the regulators are to hold `u`, whatever the pressures are.
        """
        self.waiting = [*self.waiting[1:], u[0]] if self.delay else []
        if not self.delay:
            self._expect(x[1])
        self.last_sent = u[0]
        return u

    # --- what joints and arms say ---------------------------------------------------------------------------------

    @abstractmethod
    def _angles(self, given: Any) -> Array:
        """Return the reference (ahead + 1, …) of the angles. Raises `Meaningless`, as the next two do."""

    @abstractmethod
    def _stiffness(self, given: Any) -> Array:
        """Return the reference (ahead + 1, …) of the stiffness."""

    @abstractmethod
    def _torque(self, d: Any) -> Any:
        """Return the torque from outside."""

    @abstractmethod
    def _substitutes(self, x: Array) -> tuple[Array, Array, Any]:
        """Return angles, stiffness and torque in the place of those that cannot be meant."""

    @abstractmethod
    def _torques(self, x: Array, theta: Array, torque: Any, ringing: bool) -> Array:
        """Return the torque (ahead + 1, …) from outside and of friction."""

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
            # which is who calls `step`, beyond np.errstate
            warnings.warn(f"{reason}; the pressures are held", BadNumbers, stacklevel=6)
            self._warned = True

    def _expect(self, x: Array) -> None:
        if all(map(isfinite, x.tolist())):
            self.expected = x
