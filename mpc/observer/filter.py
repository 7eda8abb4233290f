"""An extended Kalman filter is written here for ξ = (θ, ω, P1, P2, d) from measured y = (θ, P1, P2).

    ξ_{k+1} = (f_d(x_k, v_k, d_k - T_f), d_k) + w_k,    y_k = (θ, P1, P2)_k + n_k,    w ~ (0, Q),  n ~ (0, R)

f_d is the plant over one sample, v the commands that act now (past their dead time, less the dead band) and T_f the
friction that `Compensation` knows. d is a random walk, so that in steady state nothing of a constant torque is left.

The plant is evaluated only within the joint range and the supply, for which its muscles' laws are made; beyond, its
slope there is continued: f_d(x) ≈ f_d(x̂) + A (x - x̂), x̂ being the nearest state within.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask, Value
from allocator.units import BAR, DEG
from mpc.model.buffered import Buffered
from mpc.model.compensation import Compensation
from mpc.model.contact import BufferedPressing, Contact
from mpc.model.plant import NU, NX, Plant
from mpc.observer.gating import Gate

MEASURED = np.array([0, 2, 3])  # of ξ
_SCALE = np.array([1, 1, BAR, BAR, 1])  # of ξ in the Riccati equation, for its conditioning
_UNSURE = 4.0  # times the stationary variance, where little is known


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the sensors per sample, and of the model's errors per root of a second.

    Raises `InvalidInput` unless those of the sensors are above zero and the others not below.
    """

    theta: float = 0.01 * DEG  # [rad]
    pressure: float = 0.02 * BAR  # [Pa]
    omega_walk: float = 0.2  # [rad/s/√s]
    pressure_walk: float = 0.07 * BAR  # [Pa/√s]
    d_walk: float = 1.9  # [N·m/√s]

    def __post_init__(self) -> None:
        """Check."""
        for name, unit in (("theta", "rad"), ("pressure", "Pa")):
            checks.positive(f"Noise: {name}", getattr(self, name), unit)
        for name, unit in (("omega_walk", "rad/s/√s"), ("pressure_walk", "Pa/√s"), ("d_walk", "N·m/√s")):
            checks.not_negative(f"Noise: {name}", getattr(self, name), unit)

    def Q(self, dt: float) -> Array:
        """Return the covariance (5, 5) of the model's errors over `dt` [s]."""
        return dt * np.diag([0.0, self.omega_walk, self.pressure_walk, self.pressure_walk, self.d_walk]) ** 2

    @property
    def R(self) -> Array:
        """Return the covariance (3, 3) of the sensors."""
        return np.diag([self.theta, self.pressure, self.pressure]) ** 2


class Belief(NamedTuple):
    """A belief is what is thought of ξ."""

    xi: Array  # (5,)
    covariance: Array  # (5, 5)

    @classmethod
    def of(cls, other: Any) -> Self:
        """Return a copy of what has the same names."""
        return cls(other.xi.copy(), other.covariance.copy())

    @property
    def sound(self) -> bool:
        """Return whether all of it is finite, and no variance negative."""
        return bool(np.isfinite(self.xi).all() and np.isfinite(self.covariance).all()) and bool(
            (np.diag(self.covariance) > 0).all()
        )


class Filter:
    """The filter holds the equations; it remembers nothing."""

    def __init__(self, plant: Plant, dt: float, noise: Noise, compensation: Compensation, gate: Gate) -> None:
        self.plant, self.dt, self.noise, self.compensation, self.gate = plant, dt, noise, compensation, gate
        self.Q, self.R = noise.Q(dt), noise.R
        self.Q_rest = replace(noise, d_walk=0.0).Q(dt)  # a load that came would have moved a sensor that repeats
        (left, right), (low, high) = plant.joint.angle_range, plant.joint.pressure_limits
        self.inner = np.array([left, -gate.max_speed, low, low]), np.array([right, gate.max_speed, high, high])
        self.outer = (
            np.array([gate.lower[0], -gate.max_speed, *gate.lower[1:], -gate.max_torque]),
            np.array([gate.upper[0], gate.max_speed, *gate.upper[1:], gate.max_torque]),
        )
        self._model = Buffered(self._discrete(dt))
        self._pressing = BufferedPressing(plant)
        self.stationary = self._stationary()  # covariance (5, 5) before a measurement once it has run for long
        self.unsure = np.diag(_UNSURE * np.diag(self.stationary))  # where nothing but the readings is known
        self.unsure[1, 1], self.unsure[NX, NX] = (gate.max_speed / 3) ** 2, (gate.max_torque / 9) ** 2

    def contact(self, belief: Belief) -> Contact:
        """Return what presses on that which rubs, in the nearest state for which the muscles' laws are made."""
        x = self.within(belief.xi)[:NX]
        return Contact(self._pressing, np.minimum(np.maximum(x, self.inner[0]), self.inner[1]))

    def predicted(self, belief: Belief, v: Array, memory: Value, Q: Array) -> Belief:
        """Predict one sample on, the commands `v` (2,) [Pa] acting and what friction remembers being `memory`."""
        xi = self.within(belief.xi)
        x, d = xi[:NX], float(xi[NX])
        near = np.minimum(np.maximum(x, self.inner[0]), self.inner[1])
        T_f = self.compensation.friction.torque(memory, Contact(self._pressing, near))
        x_next, A = self._model(near, self.compensation.after_dead_band(v, x[2:]), d - T_f)
        A = _with_walk(A)
        later = np.append(x_next[0], d)
        later[:NX] += A[:NX, :NX] @ (x - near)
        return Belief(later, A @ belief.covariance @ A.T + Q)

    def corrected(self, belief: Belief, read: Array, there: Mask, variances: Array) -> Belief:
        """Correct by the readings `there` (3,) of `read` (3,), which have the `variances` (3,)."""
        C, R = np.eye(NX + 1)[MEASURED[there]], np.diag(variances[there])
        S = C @ belief.covariance @ C.T + R
        gain = np.linalg.solve(S, C @ belief.covariance).T
        left = np.eye(NX + 1) - gain @ C
        covariance = left @ belief.covariance @ left.T + gain @ R @ gain.T  # Joseph's form: stays symmetric
        return Belief(belief.xi + gain @ (read[there] - C @ belief.xi), covariance)

    def unsure_at(self, belief: Belief, read: Array, there: Mask) -> Belief:
        """Believe the readings `there` (3,) of `read` (3,) and else `belief`, with little certainty."""
        xi = belief.xi.copy()
        xi[MEASURED[there]] = read[there]
        return Belief(xi, self.unsure)

    def can_be_sent(self, u: Array) -> Mask:
        """Return whether commands `u` (2,) [Pa] are numbers that a regulator was given."""
        return np.asarray((self.outer[0][2:NX] <= u) & (u <= self.outer[1][2:NX]))

    def within(self, xi: Array) -> Array:
        """Return the nearest ξ (5,) that the gate calls possible."""
        return np.asarray(np.minimum(np.maximum(xi, self.outer[0]), self.outer[1]))

    # --- what does not change ---------------------------------------------------------------------------------------

    def _stationary(self) -> Array:
        from scipy.linalg import solve_discrete_are

        P = np.full(NU, np.mean(self.plant.joint.pressure_limits))
        _, A = self._model(np.array([np.mean(self.plant.joint.angle_range), 0.0, *P]), P, 0.0)
        scale = np.outer(_SCALE, _SCALE)
        C, c_scale = np.eye(NX + 1)[MEASURED], _SCALE[MEASURED]
        A = _with_walk(A) / _SCALE[:, None] * _SCALE
        return np.asarray(scale * solve_discrete_are(A.T, C.T, self.Q / scale, self.R / np.outer(c_scale, c_scale)))

    def _discrete(self, dt: float) -> Any:
        """Return (x, v, d) ↦ x and its derivative by (x, d), transposed because `Buffered` hands back transposes."""
        import casadi as ca

        x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NU), ca.SX.sym("d")
        x_next = self.plant.discrete(dt)(x, v, d)
        slope = ca.densify(ca.jacobian(x_next, ca.vertcat(x, d)).T)
        return ca.Function("observed", [x, v, d], [x_next, slope])


def _with_walk(A: Array) -> Array:
    """Return (5, 5) from the plant's derivative (4, 5): d stays."""
    return np.vstack([A, np.eye(NX + 1)[-1:]])
