"""An action says pressures, or a posture and a stiffness, from which the allocation makes pressures.

Actions are numbers between -1 and 1, as learners like them. Whatever pressures they mean go through a governor before
they are commanded.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from allocator.allocation import allocate, warm_up
from allocator.calculus import Array
from allocator.joint.limits import Limits
from mpc.governor import PressureGovernor
from mpc.model.arm.model import Arm


def within(values: Array, low: Array | float, high: Array | float) -> Array:
    """Return `values`, and the nearest limit of those beyond; in a third of the time of `np.clip` on few numbers."""
    return np.asarray(np.minimum(np.maximum(values, low), high))


class Governor(Protocol):
    """A governor returns the pressures nearest to a command that are safe; `mpc.governor.PressureGovernor` is one."""

    def __call__(self, q: Array, omega: Array, P: Array, command: Array, previous: Array) -> Array:
        """Return safe commands (N, m) [Pa] for arms at `q` [rad], `omega` [rad/s] (N, n) with the pressures `P` [Pa].

        `command` and `previous` (N, m) [Pa] are what is asked for now, and what was let through last.
        """


class BoxAndSlew:
    """`BoxAndSlew` is a governor that keeps commands within the supply and changes them no faster than the slew."""

    def __init__(self, arm: Arm, dt: float) -> None:
        self._limits, self._reach = arm.mechanism.pressure_limits, arm.slew * dt

    def __call__(self, q: Array, omega: Array, P: Array, command: Array, previous: Array) -> Array:
        """Return the commands (N, m) [Pa] within the limits."""
        return within(within(command, *self._limits), previous - self._reach, previous + self._reach)


_GOVERNED = 3  # joints: rollouts of three take 25 s to compile and 50 µs a command


def governor_of(arm: Arm, dt: float, delay: int) -> Governor:
    """Return the governor of an arm whose valves get commands `delay` samples of `dt` [s] late, compiled.

    It takes dead time for more lag. Muscles that are not affine in the pressure and arms of more than three joints have
    `BoxAndSlew` only.
    """
    if not arm.mechanism.affine or arm.n > _GOVERNED:
        return BoxAndSlew(arm, dt)
    governor = PressureGovernor.of_arm(arm, dt, lag=tuple(arm.lags + delay * dt))
    governor.warm_up()
    return governor


class Action(Protocol):
    """A meaning of `size` numbers between -1 and 1 per arm."""

    size: int

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] that the actions (N, size) mean."""


class Pressures:
    """`Pressures` are actions (N, m): -1 is the supply's lower limit and 1 its upper one."""

    def __init__(self, arm: Arm) -> None:
        self.size, (self._low, high) = arm.m, arm.mechanism.pressure_limits
        self._half = (high - self._low) / 2

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] that are meant."""
        return self._low + (action + 1) * self._half


class PostureAndStiffness:
    """`PostureAndStiffness` are actions (N, 2n): angles over their ranges, and the stiffnesses of the joints.

    The pressures that hold the posture with these stiffnesses K11, K22, … come from `allocate`; torques come
    first, the other entries of K are free. Stiffness goes in equal ratios from the least to the greatest that the arm
    has in the middle of its range.
    """

    def __init__(self, arm: Arm) -> None:
        warm_up(joint=arm.mechanism)
        self.size, self.arm = 2 * arm.n, arm
        low, high = arm.angle_limits
        self._middle, self._half = (low + high) / 2, (high - low) / 2
        least, greatest = arm.mechanism.pressure_box(self._middle, Limits(min_force=0.0))
        ends = [np.diag(arm.mechanism.stiffness(self._middle, P)) for P in (least, greatest)]
        self._stiffness = np.log(np.maximum(ends[0], 1e-2 * ends[1])), np.log(ends[1])

    def targets(self, action: Array) -> tuple[Array, Array]:
        """Return postures (N, n) [rad] and the diagonals of stiffnesses (N, n) [N·m/rad] that are meant."""
        n, (least, greatest) = self.arm.n, self._stiffness
        share = (action[:, n:] + 1) / 2
        return self._middle + self._half * action[:, :n], np.exp(least + share * (greatest - least))

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] that are meant, or the nearest that there are."""
        q, K = self.targets(action)
        held = self.arm.bodies.gravity_torque(q)
        one = (slice(None), None)  # an axis besides, since (2, 2) would be a matrix K
        return allocate(q[one], K[one], held[one], joint=self.arm.mechanism).P[:, 0]


KINDS: Mapping[str, Callable[[Arm], Action]] = {"pressures": Pressures, "posture-stiffness": PostureAndStiffness}
"""Every meaning of actions, by its name."""
