"""Baselines of present practice: controllers without optimisation in the loop.

    FeedForwardControl   T = T*                                           the analytic inverse alone
    PIControl            T = T* + k_p e + k_i ∫e,  e = θ* - θ           feed-forward with PI
    PIDControl           T = T* + k_p e + k_i ∫e + k_d e',  e = θ* - θ    feedback through the analytic inverse
    PredictivePIDControl the same, with e and e' predicted by the model for the end of the dead time
    LQRControl           u = u* - G (x - x*, e_last)                    state feedback about the feed-forward

T* is the torque of the intended motion. The closed-form allocation and the inverse of the lag turn (θ*, K*, T) into
commands (`mpc.tracking.feedforward`). All baselines have the same previews, `Compensation` and limits as the MPC. The
PID's integral replaces the observer's disturbance torque; the others use that torque.
"""

from dataclasses import dataclass, fields
from math import inf, isfinite, nan
from typing import ClassVar, NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import NU, Plant
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.cost import Weights, diagonal
from mpc.tracking.feedforward import FeedForward, FeedForwardOf, InverseDynamics
from mpc.tracking.plan import PlanStatus, Rung
from mpc.tracking.preview import Task
from mpc.tracking.terminal import middle, regulator, solve_riccati

_PREVIEW = 10  # samples, enough for the derivatives of the reference


class Baseline(BaseController):
    """Controller in closed form; subclasses define the commands that should act."""

    says_moved = False
    patience = 0.2  # time for which a missing angle is predicted; then the commands are held [s]

    def __init__(
        self, plant: Machine, dt: float = 0.01, compensation: Compensation | None = None, min_force: float = 0.0
    ) -> None:
        self.plant, self.dt = plant, dt
        self.compensation = Compensation() if compensation is None else compensation
        self._check_model()
        self._feed_forward: FeedForwardOf = InverseDynamics(plant, dt, _PREVIEW, min_force).ready()
        self._build(_PREVIEW, min_force)
        self.ladder.holding = inf  # pressures are never vented
        self.reset()

    def compile(self) -> Self:
        """Return the controller with its feed-forward in compiled code: the same results in a quarter of the time.

        That takes some seconds without cached code; nothing changes for a joint without a kernel.
        """
        from mpc.tracking.compiled.module import compiled_plant
        from mpc.tracking.compiled.qp_step import CompiledFeedForward

        readable = self._feed_forward
        if isinstance(readable, InverseDynamics) and (made := compiled_plant(self.plant, self.dt)).p.size:
            self._feed_forward = CompiledFeedForward(made, readable)
        return self

    def _optimise(self, situation: Situation) -> Optimised:
        """Return the wanted commands within the limits, and the last commands in place of those that are not finite."""
        task, u_last = situation.task, situation.previous.u
        wanted = self._wanted(task, situation.feed)
        wanted = np.where(np.isfinite(wanted), wanted, u_last)
        u = self.limits.limited(u_last, wanted)
        self._given(u[0], wanted[0])
        status = PlanStatus.CLOSED_FORM if task.measured else PlanStatus.NO_MEASUREMENT
        return Optimised(status, (Rung.ALLOCATION, u), self._predictor.motion(task.x, u, task.d[:-1]))

    def _wanted(self, task: Task, feed: FeedForward) -> Array:
        """Return the commands (N, 2) [Pa] that should act, unlimited."""
        return feed.u

    def _given(self, u: Array, wanted: Array) -> None:
        """Record, after every step, the first limited command for the `wanted` one (2,)."""
        return None

    @property
    def remembered(self) -> tuple[Value, ...]:
        """Memory of the feedback: see `mpc.tracking.compiled.sample.layout.Fed`."""
        return 0.0, 0.0, 0.0, 0.0, 0.0


class FeedForwardControl(Baseline):
    """Feed-forward alone, of a joint or an arm: the inverse dynamics, and the direction of the friction.

    Without feedback a machine is as stiff as its muscles: a contact with the hand meets the tracked stiffness.
    """

    machines = Plant, Arm


@dataclass(frozen=True)
class PIDGains:
    """Gains, found by `benchmarks/closed_loop/tuning.py` and compared on two more seeds."""

    proportional: float = 2.26  # k_p [N·m/rad]
    integral: float = 37.4  # k_i [N·m/rad/s]
    derivative: float = 0.603  # k_d [N·m·s/rad]
    filter_time: float = 0.0058  # of the derivative [s]

    def __post_init__(self) -> None:
        """Check the gains."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not (isfinite(value) and value >= 0):
                raise InvalidInput(f"PIDGains: {entry.name} = {value!r} has to be 0 or more, and finite")


class Errors(NamedTuple):
    """Errors for a PID's feedback."""

    error: float  # e = θ* - θ [rad]
    slope: float  # e' [rad/s]


class PIDControl(Baseline):
    """PID feedback of the encoder's angle, and feed-forward. The integral is frozen while a limit is active."""

    GAINS: ClassVar[PIDGains] = PIDGains()

    def __init__(
        self,
        plant: Plant,
        dt: float = 0.01,
        compensation: Compensation | None = None,
        gains: PIDGains | None = None,
    ) -> None:
        self.gains = self.GAINS if gains is None else gains
        super().__init__(plant, dt, compensation)

    def _forget(self) -> None:
        self._integral = 0.0  # [rad·s]
        self._slope = 0.0  # [rad/s] filtered derivative of the error
        self._error: float | None = None  # [rad] of the previous sample
        self._saturated = False

    def _torques(self, task: Task) -> Array:
        """Return the torques of the intended motion and of the feedback, without the known external torque."""
        error = task.now - float(task.seen[0]) if isfinite(task.seen[0]) else self._error or 0.0
        if not self._saturated:
            self._integral += self.dt * error
        fed_back = self._errors(task, error)
        self._error = error
        k = self.gains
        T = k.proportional * fed_back.error + k.integral * self._integral + k.derivative * fed_back.slope
        return np.asarray(task.d - task.known - T)

    def _errors(self, task: Task, error: float) -> Errors:
        """Return the errors for the proportional and the derivative part, from the `error` [rad] of this sample."""
        previous = error if self._error is None else self._error
        share = self.dt / (self.dt + self.gains.filter_time)
        self._slope += share * ((error - previous) / self.dt - self._slope)
        return Errors(error, self._slope)

    def _given(self, u: Array, wanted: Array) -> None:
        self._saturated = bool((u != wanted).any())

    @property
    def remembered(self) -> tuple[Value, ...]:
        """Memory of the feedback."""
        return self._integral, self._slope, nan if self._error is None else self._error, self._saturated, 0.0


class PIControl(PIDControl):
    """PI feedback of the encoder's angle, and feed-forward. Without a derivative its gains are low."""

    GAINS = PIDGains(0.2, 10.0, 0.0, 0.0)


class PredictivePIDControl(PIDControl):
    """PID on angle and velocity predicted for the time at which its command acts, with an observer.

    The integral is that of the measured error. The gains can be higher because the prediction removes the dead time.
    """

    GAINS = PIDGains(9.0, 45.0, 1.2, 0.0)

    def _errors(self, task: Task, error: float) -> Errors:
        omega = np.gradient(task.theta[:3], self.dt, edge_order=2)[0]
        return Errors(float(task.theta[0] - task.x[0]), float(omega - task.x[1]))


class LQRControl(Baseline):
    """State feedback of the linear-quadratic regulator for the MPC's cost, about the middle of the joint's range."""

    def __init__(
        self,
        plant: Plant,
        dt: float = 0.01,
        compensation: Compensation | None = None,
        weights: Weights | None = None,
    ) -> None:
        weights = Weights() if weights is None else weights
        model = middle(plant, dt)
        A, B, _, R, N = problem = regulator(model, dt, diagonal(weights), weights.rate)
        S = solve_riccati(*problem)
        gain = np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A + N.T)
        self.gain = gain * BAR / model.units  # G (2, 6) in SI units
        super().__init__(plant, dt, compensation)

    def _forget(self) -> None:
        self._e = np.zeros(NU)  # the last command minus its feed-forward, both as they should act [Pa]

    def _wanted(self, task: Task, feed: FeedForward) -> Array:
        e = -self.gain @ np.concatenate([task.x - feed.x[0], self._e])
        self._star = feed.u[0]
        return np.asarray(feed.u + e)

    def _given(self, u: Array, wanted: Array) -> None:
        self._e = u - self._star

    @property
    def remembered(self) -> tuple[Value, ...]:
        """Memory of the feedback."""
        return 0.0, 0.0, 0.0, 0.0, self._e
