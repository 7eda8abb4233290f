"""The feed-forward would follow a preview exactly, if the model were right and nothing limited: closed form.

The motion needs the torque T = J θ'' + b θ' + m g l sin θ - d of a joint, or M(q) q'' + C(q, q') + D q' + g(q) - d of
an arm, where d holds the friction of the intended motion too (`mpc.tracking.preview`); `allocate` turns (θ, K, T) at
all N+1 samples into pressures in one call, bringing what cannot be reached to the nearest that can; and the lag over
one sample of constant command,

    P_{k+1} = α_i P_k + (1 - α_i) (u_k - τ_i q_k),    α_i = exp(-dt/τ_i)

is inverted for the commands. q is what the swelling muscles take (`Plant.expansion`), the mean of both ends.
"""

from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from allocator.calculus import Array
from mpc.model.machine import Machine
from mpc.tracking.plan import Moved


@dataclass(frozen=True)
class FeedForward:
    """A feed-forward is a preview and what it asks of state, outputs and commands; time runs along the first axis.

    Of n joints and m muscles x is (N+1, 2n + m), y (N+1, n(n+1)/2 + m) with svec K* for K*, and u (N, m).
    """

    x: Array  # (N+1, 4) x* = (θ*, θ*', P1*, P2*): angle within the joint range, its derivative, pressures
    y: Array  # (N+1, 3) y* = (K*, 0, 0): the reachable stiffness nearest to the asked one [N·m/rad], no force
    u: Array  # (N, 2) u*, commands [Pa], unlimited
    moved: Moved  # from what was asked

    @property
    def theta(self) -> Array:
        """The angle of a joint is θ* (N+1,) [rad]; the next three are of a joint, too."""
        return self.x[:, 0]

    @property
    def omega(self) -> Array:
        """The velocity is θ*' (N+1,) [rad/s]."""
        return self.x[:, 1]

    @property
    def P(self) -> Array:
        """The pressures are P* (N+1, 2) [Pa]."""
        return self.x[:, 2:]

    @property
    def K(self) -> Array:
        """The stiffness is K* (N+1,) [N·m/rad]."""
        return self.y[:, 0]


class FeedForwardOf(Protocol):
    """`InverseDynamics`, or the same in compiled code."""

    def __call__(self, theta: Array, K: Array, d: Array, /) -> FeedForward:
        """Return the feed-forward for references and torques (N+1,)."""


class InverseDynamics:
    """The inverse dynamics of `plant` are its feed-forward, for previews of N+1 samples, `dt` [s] apart.

    Its muscles pull `min_force` [N] at least.
    """

    def __init__(self, plant: Machine, dt: float, N: int, min_force: float = 0.0) -> None:
        from scipy.interpolate import CubicSpline

        self.plant: Any = plant
        self.min_force = min_force
        # the derivatives of a spline are linear in its samples: matrices (N+1, N+1), made once
        spline = CubicSpline(dt * np.arange(N + 1), np.eye(N + 1))
        self.slopes = spline(spline.x, 1), spline(spline.x, 2)
        self.lags = np.array(plant.lags)  # (m,) [s]
        self.alpha = np.exp(-dt / self.lags)  # (m,)

    def ready(self) -> Self:
        """Return itself, with everything compiled that else would be in the first control step."""
        self.plant.warm_up(self.min_force)
        return self

    def __setstate__(self, state: dict[str, object]) -> None:
        """Compile again: in another process nothing may be compiled yet."""
        self.__dict__.update(state)
        self.ready()

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Return itself: nothing in it changes."""
        return self

    def __call__(self, theta: Array, K: Array, d: Array | float = 0.0) -> FeedForward:
        """Return the feed-forward for the previews `theta` [rad] and `K` [N·m/rad], and a torque `d` [N·m].

        Of a joint they are (N+1,), of an arm (N+1, n), (N+1, k, k) and (N+1, n); `d` may be constant.
        """
        asked, plant = theta, self.plant
        theta = np.clip(asked, *plant.angle_limits)
        omega, alpha = (D @ theta for D in self.slopes)
        held = plant.held(theta, K, plant.torque_for(theta, omega, alpha, d), self.min_force)
        x, y = np.column_stack([theta, omega, held.P]), np.hstack([held.K, 0 * held.P])
        q = np.stack(plant.expansion(x.T), axis=1)
        u = (held.P[1:] - self.alpha * held.P[:-1]) / (1 - self.alpha) + self.lags / 2 * (q[1:] + q[:-1])
        moved = Moved(*(float(np.abs(gap).max()) for gap in (asked - theta, held.K_error, held.T_error)))
        return FeedForward(x, y, u, moved)
