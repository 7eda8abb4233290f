"""Extended Kalman filter for ξ = (q, ω, P, d) from measured y = (q, P), of n joints and m muscles.

    ξ_{k+1} = (f_d(x_k, v_k, d_k - T_f), d_k) + w_k,    y_k = (q, P)_k + n_k,    w ~ (0, Q),  n ~ (0, R)

f_d is the plant over one sample, v the commands that act now (after their dead time, minus the dead band), d an
external torque at every joint and T_f the friction of the `Compensation`. d is a random walk, so that constant torques
and errors of the muscle models leave no steady-state error. For a joint (n = 1, m = 2), ξ = (θ, ω, P1, P2, d).
An angle that is older by r than its whole samples (`Compensation.older`) is read as q - r ω: C ξ = (q - r ω, P).

A regulator has its own sensor, so that the measured pressure settles at an offset o from the command. A sensor is
assumed to read P + o; the estimated pressures are then those of the commands. With d and o there are as many
integrators as outputs, and the angle has no steady-state error (Pannocchia and Rawlings, AIChE J. 49:426-437, 2003). o
follows the filter's innovations,

    o_{k+1} = o_k + dt/T_o (y_P - o - P̂_{k|k-1})_k within ± `Noise.offset`,      T_o = `OFFSET_TIME`

while the pressure is within `SETTLED` of its command, so that leaks and lags do not count as offsets. All angles have
to be believed, since the motion moves the gas. Within a known dead band P̂ is constant and the innovations cancel, so
that o does not wind up.

The plant is evaluated only within the joint range and the supply, for which its muscle models are valid. Outside, it is
extrapolated linearly: f_d(x) ≈ f_d(x̂) + A (x - x̂), x̂ being the nearest state inside.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask, Value
from allocator.units import BAR, DEG
from mpc.codegen.buffered import Buffered
from mpc.model.arm.differences import Differences
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Contacts, Loads
from mpc.model.machine import Machine
from mpc.observer.gating import Gate
from mpc.observer.pressure_diagnosis import DATA_SHEET

OFFSET_TIME = 0.5  # T_o [s]
SETTLED = 0.2 * BAR
_UNSURE = 4.0  # [-] variance over the stationary one, if little is known


@dataclass(frozen=True)
class Noise:
    """Standard deviations of the sensors per sample, and of the model's errors per root of a second.

    Raises `InvalidInput` unless those of the sensors are positive and the others are not negative.
    """

    theta: float = 0.01 * DEG  # [rad]
    pressure: float = 0.02 * BAR  # [Pa]
    omega_walk: float = 0.2  # [rad/s/√s]
    pressure_walk: float = 0.02 * BAR  # [Pa/√s]
    d_walk: float = 1.33  # [N·m/√s]
    offset: float = 0.15 * BAR  # bound of the estimated sensor offsets [Pa]; 0: none

    def __post_init__(self) -> None:
        """Check the values."""
        for name, unit in (("theta", "rad"), ("pressure", "Pa")):
            checks.positive(f"Noise: {name}", getattr(self, name), unit)
        walks = ("omega_walk", "rad/s/√s"), ("pressure_walk", "Pa/√s"), ("d_walk", "N·m/√s"), ("offset", "Pa")
        for name, unit in walks:
            checks.not_negative(f"Noise: {name}", getattr(self, name), unit)

    def Q(self, dt: float, n: int = 1, m: int = 2) -> Array:
        """Return the covariance (3n + m, 3n + m) of the model's errors over `dt` [s]."""
        return dt * np.diag([0.0] * n + [self.omega_walk] * n + [self.pressure_walk] * m + [self.d_walk] * n) ** 2

    def R(self, n: int = 1, m: int = 2) -> Array:
        """Return the covariance (n + m, n + m) of the sensors."""
        return np.diag([self.theta] * n + [self.pressure] * m) ** 2


CALM_NOISE = Noise(theta=0.02 / 12**0.5 * DEG, d_walk=2.09, pressure_walk=0.00501 * BAR)
"""Noise of an arm with encoder steps of 0.02° and pressure noise of 0.02 bar.

The regulators' pressures are trusted almost fully, because otherwise most of the sensors' noise returns as commands.
"""


class Belief(NamedTuple):
    """Estimate of ξ and its covariance."""

    xi: Array  # (3n + m,)
    covariance: Array  # (3n + m, 3n + m)

    @classmethod
    def of(cls, other: Any) -> Self:
        """Return a copy of a record with the same fields."""
        return cls(other.xi.copy(), other.covariance.copy())

    @property
    def sound(self) -> bool:
        """Whether it is finite, and no variance negative."""
        return bool(np.isfinite(self.xi).all() and np.isfinite(self.covariance).all()) and bool(
            (np.diag(self.covariance) > 0).all()
        )


def settings(
    plant: Machine, dt: float, noise: Noise | None, compensation: Compensation | None, gate: Gate | None
) -> tuple[Noise, Compensation, Gate]:
    """Return the settings of an observer, by default usual ones. Raises `InvalidInput` for other types."""
    noise = Noise() if noise is None else noise
    checks.instance("noise", noise, Noise, "a Noise")
    compensation = Compensation() if compensation is None else compensation
    checks.instance("compensation", compensation, Compensation, "a Compensation")
    gate = Gate.of(plant, dt, (noise.theta, noise.pressure)) if gate is None else gate
    checks.instance("gate", gate, Gate, "a Gate")
    return noise, compensation, gate


class Filter:
    """Equations of the filter, without a memory."""

    def __init__(self, plant: Machine, dt: float, noise: Noise, compensation: Compensation, gate: Gate) -> None:
        self.plant: Any = plant
        self.dt, self.noise, self.compensation, self.gate = dt, noise, compensation, gate
        n, m, size = plant.n, plant.m, plant.size
        self.measured = np.array([*range(n), *range(2 * n, size)])  # of ξ
        self.Q, self.R = noise.Q(dt, n, m), noise.R(n, m)
        rates, spread = dt / np.asarray(plant.lags), 1.0 if compensation.measured_lags else DATA_SHEET
        self.share, self.shares = 1 - np.exp(-rates), 1 - np.exp(-np.outer([spread, 1 / spread], rates))
        self.Q_rest = np.tile(replace(noise, d_walk=0.0).Q(dt, n, m), (n + m, 1, 1))  # by repeating sensor
        for i in range(n):  # a new load would have moved a repeating angle, but other joints may have one
            others = [size + j for j in range(n) if j != i]
            self.Q_rest[i, others, others] = self.Q[others, others]
        angles: tuple[Value, Value] = plant.angle_limits
        fast, much = np.full(n, gate.max_speed), np.full(n, gate.max_torque)
        self.inner, self.outer = (
            tuple(np.concatenate([q * np.ones(n), sign * fast, P * np.ones(m)]) for sign, q, P in ends)
            for ends in (
                zip((-1, 1), angles, plant.pressure_limits, strict=True),
                ((-1, gate.lower[:n], gate.lower[n:]), (1, gate.upper[:n], gate.upper[n:])),
            )
        )
        self.outer = np.append(self.outer[0], -much), np.append(self.outer[1], much)
        fastest = compensation.flow * dt / (1 - np.exp(-dt / np.array(plant.lags_each_way)))
        self.reach = np.minimum(fastest, np.ptp((gate.lower[n:], gate.upper[n:]), axis=0))  # (2, m), see `acting` [Pa]
        self.older = compensation.older(dt)  # readings of angles beyond whole samples [s]
        self.C = np.eye(size + n)[self.measured]  # readings by ξ
        self.C[range(n), range(n, 2 * n)] = -self.older
        self._model = self._discrete(dt)
        self.frictions, self._contacts = compensation.of_joints(n), Contacts(plant)
        self.stationary = self._stationary()  # steady-state covariance before a measurement
        self.unsure = np.diag(_UNSURE * np.diag(self.stationary))  # if only the readings are known
        for places, most in ((slice(n, 2 * n), gate.max_speed / 3), (slice(size, None), gate.max_torque / 9)):
            self.unsure[places, places] = most**2 * np.eye(n)

    def contacts(self, belief: Belief) -> tuple[Loads, ...]:
        """Return the contact loads at each joint, in the nearest state for which the muscle models are valid."""
        x = self.within(belief.xi)[: self.plant.size]
        return self._contacts(np.minimum(np.maximum(x, self.inner[0]), self.inner[1]))

    def predicted(self, belief: Belief, v: Array, memories: Sequence[Value], Q: Array) -> Belief:
        """Predict the next sample under the commands `v` (m,) [Pa], with the friction `memories` of the joints."""
        size, xi = self.plant.size, self.within(belief.xi)
        x, d = xi[:size], xi[size:]
        near = np.minimum(np.maximum(x, self.inner[0]), self.inner[1])
        v, T = self.acting(v, x[2 * self.plant.n :]), d
        if not self.compensation.frictionless:
            known = zip(self.frictions, memories, self._contacts(near), strict=True)
            T = d - np.array([friction.torque(memory, loads) for friction, memory, loads in known])
        x_next, A = self._model(near, v, T)
        A = self._with_walk(A)
        later = np.append(x_next, d)
        later[:size] += A[:size, :size] @ (x - near)
        return Belief(later, A @ belief.covariance @ A.T + Q)

    def acting(self, v: Array, P: Array) -> Array:
        """Return the commands (m,) [Pa] that move the model's regulators at `P` (m,) [Pa] as `v` (m,) [Pa] moves these.

        They have a dead band, and their pressures do not change faster than their flow, which those of the model do
        beyond the `reach` of rising and of falling ones.
        """
        rising, falling = self.reach
        e = self.compensation.after_dead_band(v, P) - P
        return np.asarray(P + np.minimum(np.maximum(e, -falling), rising))

    def ahead(self, belief: Belief, commands: Sequence[Array], memories: Sequence[Value]) -> Belief:
        """Predict one sample for each of the `commands` (m,) [Pa], with the friction torques of these memories."""
        for v in commands:
            belief = self.predicted(belief, v, memories, self.Q)
        return belief

    def corrected(self, belief: Belief, read: Array, there: Mask, variances: Array) -> Belief:
        """Correct by the readings `there` (n + m,) of `read`, which have the `variances` (n + m,)."""
        one = np.eye(belief.xi.size)
        C, R = self.C[there], np.diag(variances[there])
        S = C @ belief.covariance @ C.T + R
        gain = np.linalg.solve(S, C @ belief.covariance).T
        left = one - gain @ C
        covariance = left @ belief.covariance @ left.T + gain @ R @ gain.T  # Joseph's form: stays symmetric
        return Belief(belief.xi + gain @ (read[there] - C @ belief.xi), covariance)

    def foreseen(self, belief: Belief) -> Array:
        """Return the expected readings (n + m,)."""
        return np.asarray(self.C @ belief.xi)

    def variances(self, belief: Belief) -> Array:
        """Return the variances (n + m,) of the expected readings."""
        return np.asarray(np.sum(self.C @ belief.covariance * self.C, axis=1))

    def unsure_at(self, belief: Belief, read: Array, there: Mask) -> Belief:
        """Return the readings `there` (n + m,) of `read`, and `belief` elsewhere, with a large covariance."""
        xi = belief.xi.copy()
        xi[self.measured[there]] = read[there]
        xi[: self.plant.n] += self.older * xi[self.plant.n : 2 * self.plant.n] * there[: self.plant.n]
        return Belief(xi, self.unsure)

    def learned(self, offset: Array, read: Array, expected: Belief, there: Mask, v: Array) -> Array:
        """Return the offsets (m,) [Pa] updated by the innovations of the readings `there` (n + m,) of `read`.

        `v` (m,) [Pa] are the commands that act.
        """
        n, most, P = self.plant.n, self.noise.offset, expected.xi[self.measured[self.plant.n :]]
        error = np.where(there[:n].all() & there[n:] & (np.abs(v - P) <= SETTLED), read[n:] - P, 0.0)
        moved = offset + self.dt / OFFSET_TIME * error
        return np.asarray(np.minimum(np.maximum(moved, -most), most))

    def apart(self, apart: Array, belief: Belief, v: Array) -> Array:
        """Return by how much pressures of quick and of slow regulators (2, m) [Pa] exceed those of the model, a sample
        after `belief` and `apart`, while the commands `v` (m,) [Pa] act.
        """
        P = self.within(belief.xi)[2 * self.plant.n : self.plant.size]
        e = self.acting(v, P) - P
        return np.asarray(apart + self.shares * (e - apart) - self.share * e)

    def bounds(self, expected: Belief, apart: Array) -> tuple[Array, Array]:
        """Return the least and the greatest readings (n + m,) of sound sensors and regulators."""
        read, angles = self.foreseen(expected), np.zeros(self.plant.n)
        least, most = np.minimum(apart, 0.0).min(axis=0), np.maximum(apart, 0.0).max(axis=0)
        return read + np.append(angles, least), read + np.append(angles, most)

    def can_be_sent(self, u: Array) -> Mask:
        """Return whether `u` (m,) [Pa] are valid commands."""
        P = slice(2 * self.plant.n, self.plant.size)
        return np.asarray((self.outer[0][P] <= u) & (u <= self.outer[1][P]))

    def within(self, xi: Array) -> Array:
        """Return the nearest ξ that is possible for the gate."""
        return np.asarray(np.minimum(np.maximum(xi, self.outer[0]), self.outer[1]))

    # --- what does not change ---------------------------------------------------------------------------------------

    def _stationary(self) -> Array:
        from scipy.linalg import solve_discrete_are

        plant = self.plant
        P = np.full(plant.m, np.mean(plant.pressure_limits))
        x = np.concatenate([np.atleast_1d(plant.middle), np.zeros(plant.n), P])
        _, A = self._model(x, P, plant.balance(x))
        units = np.ones(plant.size + plant.n)  # of ξ, for the conditioning of the equation
        units[2 * plant.n : plant.size] = BAR
        scale, measured = np.outer(units, units), units[self.measured]
        C = self.C * units / measured[:, None]
        A = self._with_walk(A) / units[:, None] * units
        R = self.R / np.outer(measured, measured)
        return np.asarray(scale * solve_discrete_are(A.T, C.T, self.Q / scale, R))

    def _discrete(self, dt: float) -> Callable[[Array, Array, Value], Sequence[Array]]:
        """Return (x, v, d) ↦ x and its derivative (2n + m, 3n + m) by (x, d)."""
        import casadi as ca

        plant = self.plant
        if isinstance(plant, Arm) and plant.unformulated:
            return Differences(plant, dt).sample
        x, v, d = (ca.SX.sym(name, rows) for name, rows in (("x", plant.size), ("v", plant.m), ("d", plant.n)))
        x_next = plant.discrete(dt)(x, v, d)
        slope = ca.jacobian(x_next, ca.vertcat(x, d))  # transposed because `Buffered` hands back transposes
        return Buffered(ca.Function("observed", [x, v, d], [x_next, ca.densify(slope.T)]))

    def _with_walk(self, A: Array) -> Array:
        """Return the derivative of ξ from the plant's (2n + m, 3n + m): d stays."""
        return np.vstack([A, np.eye(self.plant.size + self.plant.n)[self.plant.size :]])
