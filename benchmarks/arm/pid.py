"""PID at every joint with the feed-forward of the MPC: torques, which the allocation converts to pressures.

The requested torque of each joint is the feed-forward's plus the PID's; the requested stiffness is that of the MPC. The
feed-forward looks ahead by the dead time, like the MPC. The derivative of the error has a first-order filter; the
integral stops if the allocation is short of torque.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from allocator import allocate
from allocator.calculus import Array
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.tracking.compiled.arm.inverse_dynamics import feed_forward_of
from mpc.tracking.compiled.arm.module import compiled_arm
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Preview

_FILTER = 0.02  # [s] of the derivative
_SHORT = 1e-6  # [N·m]


@dataclass(frozen=True)
class Gains:
    """Gains of each joint (n,): N·m/rad, N·m/rad/s, N·m·s/rad."""

    proportional: Array
    integral: Array
    derivative: Array


class ArmPID:
    """Controller with the interface of `TrackingMPC`."""

    def __init__(self, arm: Arm, dt: float, gains: Gains, dead_time: float = 0.0, N: int = 20) -> None:
        self.arm, self.dt, self.gains, self._delay = arm, dt, gains, round(dead_time / dt)
        self.ahead = N + self._delay
        readable = InverseDynamics(arm, dt, N)
        self._feed_forward = feed_forward_of(arm, compiled_arm(arm, dt), readable)
        self._limits = Limits.of(arm, dt)
        self._filter = np.exp(-dt / _FILTER)
        self.reset()

    def reset(self) -> None:
        """The integral is 0."""
        n = self.arm.n
        self._integral, self._slope = np.zeros(n), np.zeros(n)
        self._error: Array | None = None
        self._last: Array | None = None

    def step(self, x: Any, q_ref: Any, K_ref: Any, d: Any = 0.0) -> Plan:
        """Return the commands of this sample; `d` is ignored."""
        n, k, gains = self.arm.n, self._delay, self.gains
        feed = self._feed_forward(q_ref[k:].copy(), K_ref[k:].copy(), np.zeros((len(q_ref) - k, n)))
        error = q_ref[0] - x[:n]
        change = np.zeros(n) if self._error is None else (error - self._error) / self.dt
        self._error, self._slope = error, self._filter * self._slope + (1 - self._filter) * change
        asked = gains.proportional * error + self._integral + gains.derivative * self._slope
        planned = feed.x[0]
        torque = self.arm.mechanism.torque(planned[:n], planned[2 * n :])
        held = allocate(planned[:n], K_ref[k], torque + asked, joint=self.arm.mechanism)
        if np.abs(held.T_error).max() < _SHORT:
            self._integral = self._integral + gains.integral * error * self.dt
        wanted = feed.u[0] + held.P - planned[2 * n :]
        self._last = self._limits.limited(x[2 * n :] if self._last is None else self._last, wanted[None])[0]
        u = self._last[None].copy()
        states, K = np.stack([x, x]), np.tile(np.eye(n), (2, 1, 1))
        return Plan(u, states, K, PlanStatus.CLOSED_FORM, Rung.ALLOCATION, 0.0, Times(0.0, 0.0, 0.0, 0.0, 0.0))


class PredictivePID:
    """PIDs at n joints by the rule of `mpc.yardsticks.baselines.PredictivePIDControl`, with the MPC's feed-forward.

    Errors are predicted for the time at which the command acts; the integral is of the measured error. Dead time,
    friction and dead band are compensated as in the MPC, the disturbance torque is not.
    """

    def __init__(self, arm: Arm, dt: float, gains: Gains, compensation: Compensation, N: int = 20) -> None:
        self.arm, self.dt, self.gains, self._limits = arm, dt, gains, Limits.of(arm, dt)
        self._preview = Preview(arm, dt, N, compensation, self._limits)
        readable = InverseDynamics(arm, dt, N)
        self._feed_forward = feed_forward_of(arm, compiled_arm(arm, dt), readable)
        self.reset()

    @property
    def ahead(self) -> int:
        """Samples of preview after the present one."""
        return self._preview.ahead

    def reset(self) -> None:
        """The integral is 0."""
        self._preview.reset()
        self._integral, self._saturated = np.zeros(self.arm.n), False
        self._last: Array | None = None

    def step(self, x: Any, q_ref: Any, K_ref: Any, d: Any = 0.0) -> Plan:
        """Return the commands of this sample."""
        n, gains, task = self.arm.n, self.gains, self._preview.task(x, q_ref, K_ref, d)
        error = np.nan_to_num(q_ref[0] - x[:n])
        if not self._saturated:
            self._integral = self._integral + self.dt * error
        omega = np.gradient(task.theta[:3], self.dt, axis=0, edge_order=2)[0]
        T = gains.proportional * (task.theta[0] - task.x[:n]) + gains.integral * self._integral
        T = T + gains.derivative * (omega - task.x[n : 2 * n])
        wanted = self._feed_forward(task.theta, task.K, task.d - task.known - T).u[:1]
        u = self._limits.limited(task.x[2 * n :] if self._last is None else self._last, wanted)
        self._last, self._saturated = u[0], bool((u != wanted).any())
        states, K = np.stack([task.x, task.x]), np.tile(np.eye(n), (2, 1, 1))
        sent = self._preview.sent(u, states)
        return Plan(sent, states, K, PlanStatus.CLOSED_FORM, Rung.ALLOCATION, 0.0, Times(0.0, 0.0, 0.0, 0.0, 0.0))
