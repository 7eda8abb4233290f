"""Closed-form feed-forward. It follows a preview exactly if the model is exact and no limit is active.

The motion needs the torque T = J θ'' + b θ' + m g l sin(θ - θ_h) - d of a joint, or M(q) q'' + C(q, q') + D q' + g(q)
- d of an arm, where d includes the friction of the intended motion (`mpc.tracking.preview`). One call of `allocate`
turns (θ, K, T) at all N+1 samples into pressures, moving infeasible targets to the nearest feasible ones. The lag over
one sample of constant command,

    P_{k+1} = α_i P_k + (1 - α_i) (u_k - τ_i q_k),    α_i = exp(-dt/τ_i)

is inverted for the commands. q is the fall of the pressures [Pa/s] as the muscles swell (`Plant.expansion`), averaged
over both ends of the sample. τ_i is the lag of a rising pressure if the regulator has to fill, P_{k+1} - P_k + dt q_k >
0, else that of a falling one.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from allocator.calculus import Array
from mpc.model.experiment import Held
from mpc.model.machine import Machine
from mpc.tracking.plan import Moved


@dataclass(frozen=True)
class FeedForward:
    """States, outputs and commands that follow a preview; time is the first axis.

    For n joints and m muscles, x is (N+1, 2n + m), y (N+1, n(n+1)/2 + m) with svec K* for K*, and u (N, m).
    """

    x: Array  # (N+1, 4) x* = (θ*, θ*', P1*, P2*): angle within the joint range, its derivative, pressures
    y: Array  # (N+1, 3) y* = (K*, 0, 0): the feasible stiffness nearest to the reference [N·m/rad], no force
    u: Array  # (N, 2) u*, commands [Pa], unlimited
    moved: Moved  # distance from the references


class FeedForwardOf(Protocol):
    """`InverseDynamics`, or the same in compiled code."""

    def __call__(self, theta: Array, K: Array, d: Array, /) -> FeedForward:
        """Return the feed-forward for references and torques (N+1,)."""


class InverseDynamics:
    """Feed-forward by inverse dynamics of `plant`, for previews of N+1 samples, `dt` [s] apart.

    Every muscle pulls at least `min_force` [N].
    """

    def __init__(self, plant: Machine, dt: float, N: int, min_force: float = 0.0) -> None:
        from scipy.interpolate import CubicSpline

        self.plant: Any = plant
        self.min_force = min_force
        # the derivatives of a spline are linear in its samples: matrices (N+1, N+1), made once
        spline = CubicSpline(dt * np.arange(N + 1), np.eye(N + 1))
        self.slopes = spline(spline.x, 1), spline(spline.x, 2)
        self.dt, self.lags = dt, np.array(plant.lags_each_way)  # (2, m) [s] of rising and falling pressures
        self.alpha = np.exp(-dt / self.lags)  # (2, m)

    def ready(self) -> Self:
        """Return the feed-forward, compiled now rather than in the first control step."""
        self.plant.warm_up(self.min_force)
        return self

    def __setstate__(self, state: dict[str, object]) -> None:
        """Compile again, because another process may not have compiled code."""
        self.__dict__.update(state)
        self.ready()

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Return the same object, because it does not change."""
        return self

    def __call__(self, theta: Array, K: Array, d: Array | float = 0.0) -> FeedForward:
        """Return the feed-forward for the previews `theta` [rad] and `K` [N·m/rad], and a torque `d` [N·m].

        For a joint they are (N+1,), for an arm (N+1, n), (N+1, k, k) and (N+1, n); `d` may be constant.
        """
        asked, plant = theta, self.plant
        theta = np.clip(asked, *plant.angle_limits)
        omega, alpha = (D @ theta for D in self.slopes)
        T = plant.torque_for(theta, omega, alpha, d)
        constant = all((a == a[:1]).all() for a in (theta, K, np.atleast_1d(d)))
        rows = slice(1 if constant else None)  # equal samples are allocated once
        held = plant.held(theta[rows], K[rows], T[rows], self.min_force)
        held = Held(*(np.broadcast_to(a, (len(theta), *a.shape[1:])) for a in held))
        x, y = np.column_stack([theta, omega, held.P]), np.hstack([held.K, 0 * held.P])
        q = np.stack(plant.expansion(x.T), axis=1)
        u = self._commands(held.P, (q[1:] + q[:-1]) / 2)
        moved = Moved(*(float(np.abs(gap).max()) for gap in (asked - theta, held.K_error, held.T_error)))
        return FeedForward(x, y, u, moved)

    def _commands(self, P: Array, q: Array) -> Array:
        """Return the commands (N, m) [Pa] for the pressures `P` (N+1, m) [Pa] that would fall by `q` (N, m) [Pa/s]."""
        rises = P[1:] - P[:-1] + self.dt * q > 0
        ways = [(P[1:] - a * P[:-1]) / (1 - a) + lag * q for a, lag in zip(self.alpha, self.lags, strict=True)]
        return np.asarray(np.where(rises, *ways))
