"""Actions: pressures, or a posture and a stiffness that the allocation turns into pressures.

Actions are numbers between -1 and 1, as usual for learners. A governor checks all pressures before they are commanded.
"""

from collections.abc import Callable, Mapping
from typing import Protocol

import numpy as np

from allocator.allocation import allocate, warm_up
from allocator.allocation.box import ready
from allocator.calculus import Array
from allocator.joint.limits import Limits
from mpc.governor import PressureGovernor
from mpc.model.arm.model import Arm


def within(values: Array, low: Array | float, high: Array | float) -> Array:
    """Return `values` moved to within the limits, in a third of the time of `np.clip` on few numbers."""
    return np.asarray(np.minimum(np.maximum(values, low), high))


class Governor(Protocol):
    """Function that returns the safe pressures nearest to a command, such as `mpc.governor.PressureGovernor`."""

    def __call__(self, q: Array, omega: Array, P: Array, command: Array, previous: Array) -> Array:
        """Return safe commands (N, m) [Pa] for arms at `q` [rad], `omega` [rad/s] (N, n) with the pressures `P` [Pa].

        `command` and `previous` (N, m) [Pa] are the present request and the last safe commands.
        """


class BoxAndSlew:
    """Governor that limits commands to the supply and their changes to the slew."""

    def __init__(self, arm: Arm, dt: float) -> None:
        self._limits, self._reach = arm.mechanism.pressure_limits, arm.slew * dt

    def __call__(self, q: Array, omega: Array, P: Array, command: Array, previous: Array) -> Array:
        """Return the commands (N, m) [Pa] within the limits."""
        return within(within(command, *self._limits), previous - self._reach, previous + self._reach)


_GOVERNED = 3  # joints: rollouts of three take 16 s to compile and 50 µs per command


def governor_of(arm: Arm, dt: float, delay: int) -> Governor:
    """Return the compiled governor of an arm with valves that get commands `delay` samples of `dt` [s] late.

    It treats dead time as additional lag. Muscles that are not affine in the pressure and arms of more than three
    joints have only `BoxAndSlew`.
    """
    if not arm.mechanism.affine or arm.n > _GOVERNED:
        return BoxAndSlew(arm, dt)
    governor = PressureGovernor.of_arm(arm, dt, lag=tuple(arm.lags + delay * dt))
    governor.warm_up()
    return governor


class Action(Protocol):
    """Mapping from `size` numbers between -1 and 1 per arm to pressures."""

    size: int

    def warm_up(self) -> None:
        """Compile now, so that no later call does."""

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] of the actions (N, size)."""


class Pressures:
    """Pressures as actions (N, m): -1 is the supply's lower limit and 1 its upper one."""

    def __init__(self, arm: Arm) -> None:
        self.size, (self._low, high) = arm.m, arm.mechanism.pressure_limits
        self._half = (high - self._low) / 2

    def warm_up(self) -> None:
        """Do nothing."""

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] of the actions."""
        return self._low + (action + 1) * self._half


class PostureAndStiffness:
    """Postures and stiffnesses as actions (N, 2n): angles over their ranges, and the stiffnesses of the joints.

    `allocate` finds the pressures that hold the posture with these stiffnesses K11, K22, …; torques have priority, the
    other entries of K are free. Stiffness varies in equal ratios from the least to the greatest one of the arm in the
    middle of its range.
    """

    def __init__(self, arm: Arm) -> None:
        ready.begin_warm_up(arm.mechanism)
        self.size, self.arm = 2 * arm.n, arm
        low, high = arm.angle_limits
        middle = (low + high) / 2
        ends = [np.diag(arm.mechanism.stiffness(middle, P)) for P in arm.mechanism.pressure_box(middle, Limits())]
        softest, stiffest = np.log(np.maximum(ends[0], 1e-2 * ends[1])), np.log(ends[1])
        self._middle = np.concatenate([middle, (softest + stiffest) / 2])  # (2n,) of angles and ln K
        self._half = np.concatenate([(high - low) / 2, (stiffest - softest) / 2])

    def warm_up(self) -> None:
        """Compile the allocation, unless another process does so since this object was made; then wait for it."""
        if not ready.warm_up(self.arm.mechanism):
            warm_up(joint=self.arm.mechanism)

    def targets(self, action: Array) -> tuple[Array, Array]:
        """Return postures (N, n) [rad] and diagonals of stiffnesses (N, n) [N·m/rad] of the actions."""
        meant = self._middle + self._half * action
        return meant[:, : self.arm.n], np.exp(meant[:, self.arm.n :])

    def pressures(self, action: Array) -> Array:
        """Return the pressures (N, m) [Pa] of the actions, or the nearest feasible ones."""
        q, K = self.targets(action)
        held = self.arm.bodies.gravity_torque(q)
        P, most = np.empty((len(q), self.arm.m)), ready.MOST
        for part in (slice(i, i + most) for i in range(0, len(q), most)):
            one = (part, None)  # another axis, since (2, 2) would be a matrix K
            P[part] = allocate(q[one], K[one], held[one], joint=self.arm.mechanism).P[:, 0]
        return P


KINDS: Mapping[str, Callable[[Arm], Action]] = {"pressures": Pressures, "posture-stiffness": PostureAndStiffness}
"""Mappings of actions by name."""
