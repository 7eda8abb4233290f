"""From measurements to what a controller needs: the state and the disturbance torque.

`KalmanObserver` is an extended Kalman filter for ξ = (θ, ω, P1, P2, d) from measured y = (θ, P1, P2):

    ξ_{k+1} = (f_d(x_k, v_k, d_k - T_f), d_k) + w_k,    y_k = (θ, P1, P2)_k + n_k,    w ~ (0, Q),  n ~ (0, R)

f_d is the plant over one sample, v the commands that act now (past their dead time, less the dead band) and T_f the
friction that `Compensation` knows. d is a random walk, so that in steady state nothing of a constant torque is left.
The covariance begins at the stationary one (Riccati equation at rest in the middle of the range).

A sensor that repeats its reading exactly may be frozen, or at rest: an encoder's steps hide small motions. So from the
first repetition on a second belief is kept that does not use the readings of that sensor, nor of others that repeat. If
it expects another reading, with five standard deviations between, and this lasts, the sensor is frozen: the second
belief takes over, and the sensor counts as silent until it says something new.
"""

from collections import deque
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.buffered import Buffered
from mpc.compensation import Compensation, FrictionState
from mpc.friction import pull
from mpc.plant import NU, NX, Plant

_MEASURED = np.array([0, 2, 3])  # of ξ
_TURN, _SUPPLIES = 2 * np.pi, 10.0  # [rad], supply pressures: a reading beyond is no reading
DOUBT = 5.0  # standard deviations between reading and expectation at which a repeated reading is no longer believed
_SCALE = np.array([1, 1, BAR, BAR, 1])  # of ξ in the Riccati equation, for its conditioning


class Observer(Protocol):
    """Makes a state of what the sensors say, sample by sample."""

    def reset(self) -> None:
        """Forget the past."""

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """State (4,) and disturbance torque [N·m] from `y` (4,), NaN where unmeasured; `u` (2,) [Pa] was sent last."""


class Differentiator:
    """No observer at all: a velocity that is not measured is the difference of the last two angles."""

    def __init__(self, dt: float) -> None:
        self.dt = dt
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._theta: float | None = None

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """`y` (4,) with the velocity filled in, and no disturbance torque."""
        x = np.array(y)
        if np.isnan(x[1]):
            x[1] = 0.0 if self._theta is None else (x[0] - self._theta) / self.dt
        self._theta = float(x[0])
        return x, 0.0


@dataclass(frozen=True)
class Noise:
    """Standard deviations: of the sensors per sample, of the model's errors per root of a second."""

    theta: float = 0.01 * DEG  # [rad]
    pressure: float = 0.02 * BAR  # [Pa]
    omega_walk: float = 0.2  # [rad/s/√s]
    pressure_walk: float = 0.07 * BAR  # [Pa/√s]
    d_walk: float = 1.9  # [N·m/√s]

    def Q(self, dt: float) -> Array:
        """Covariance (5, 5) of the model's errors over `dt` [s]."""
        return dt * np.diag([0.0, self.omega_walk, self.pressure_walk, self.pressure_walk, self.d_walk]) ** 2

    @property
    def R(self) -> Array:
        """Covariance (3, 3) of the sensors."""
        return np.diag([self.theta, self.pressure, self.pressure]) ** 2


class Belief(NamedTuple):
    """What is thought of ξ."""

    xi: Array  # (5,)
    covariance: Array  # (5, 5)


class KalmanObserver:
    """Extended Kalman filter; `plant` is the model. A sensor may be silent or frozen for `tolerance` seconds.

    Silent is one that says NaN or what no sensor could say. After that what it should measure is answered as NaN until
    it speaks again: a controller then knows that it is blind, and `TrackingMPC` says so in the status of its plans.
    """

    def __init__(
        self,
        plant: Plant,
        dt: float,
        noise: Noise | None = None,
        compensation: Compensation | None = None,
        tolerance: float = 0.1,
    ) -> None:
        self.plant, self.dt, self.tolerance = plant, dt, tolerance
        self.noise = Noise() if noise is None else noise
        self.compensation = Compensation() if compensation is None else compensation
        self.Q, self.R = self.noise.Q(dt), self.noise.R
        self.Q_rest = replace(self.noise, d_walk=0.0).Q(dt)  # a load that came would have moved a sensor that repeats
        self.most = np.array([_TURN, *NU * [_SUPPLIES * plant.joint.pressure_limits[1]]])
        self._model = Buffered(self._discrete())
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next measurement is the state, and no torque disturbs."""
        self.xi: Array | None = None  # (5,)
        self.covariance = self.stationary  # (5, 5)
        self._read = np.full(_MEASURED.size, np.nan)  # what the sensors said a sample ago
        self._silent = np.zeros(_MEASURED.size)  # for how long [s]
        self._repeating = np.zeros(_MEASURED.size)  # for how long [s]
        self._frozen = np.zeros(_MEASURED.size, bool)
        self._without: dict[int, Belief] = {}  # by sensor that repeats: what is thought without it
        self._friction = FrictionState(self.compensation.friction)
        self._commands: deque[Array] = deque(maxlen=self.compensation.delay(self.dt) + 1)

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """State (4,) and disturbance torque [N·m] from `y` (4,), NaN where unmeasured; `u` (2,) [Pa] was sent last."""
        read, u = np.asarray(y, float)[_MEASURED], np.asarray(u, float)
        read = np.where(np.abs(read) <= self.most, read, np.nan)
        if self.xi is None:
            belief = Belief(self._first(read), self.covariance)
            self._commands.extend([u] * self.compensation.delay(self.dt))
        else:
            self._commands.append(u)
            belief = self._expect(Belief(self.xi, self.covariance), read)
        there = np.isfinite(read) & ~self._frozen
        self.xi, self.covariance = self._corrected(belief, read, there)
        self._silent = np.where(there, 0.0, np.maximum(self._silent, self._frozen * self._repeating) + self.dt)
        self._read = read
        x = self.xi[:NX].copy()
        x[_MEASURED[self._silent > self.tolerance * (1 + 1e-9)]] = np.nan
        return x, float(self.xi[NX])

    # --- the filter -------------------------------------------------------------------------------------------------

    def _first(self, read: Array) -> Array:
        if not np.isfinite(read).all():
            raise InvalidInput(
                f"the first measurement (theta [rad], P1, P2 [Pa]) = {read} has to be finite and in range"
            )
        return np.array([read[0], 0.0, read[1], read[2], 0.0])

    def _expect(self, belief: Belief, read: Array) -> Belief:
        """What is thought of this sample before `read` (3,) is used; notes which sensors are frozen."""
        repeated = read == self._read
        self._repeating = np.where(repeated, self._repeating + self.dt, 0.0)
        self._frozen &= repeated
        z = self._friction.follow(float(belief.xi[0]))
        expected = self._predicted(belief, z, self.Q)
        others = np.isfinite(read) & ~repeated
        begun = {i: self._without.get(i, belief) for i in np.flatnonzero(repeated).tolist()}
        self._without = {}
        for i, without in begun.items():
            foreseen = self._predicted(without, z, self.Q_rest)
            if not self._frozen[i] and self._repeating[i] > self.tolerance and self._doubtful(i, read[i], foreseen):
                self._frozen[i] = True
                expected = foreseen
            self._without[i] = self._corrected(foreseen, read, others)
        return expected

    def _doubtful(self, sensor: int, read: float, foreseen: Belief) -> bool:
        i = _MEASURED[sensor]
        variance = foreseen.covariance[i, i] + self.R[sensor, sensor]
        return bool((read - foreseen.xi[i]) ** 2 > DOUBT**2 * variance)

    def _predicted(self, belief: Belief, z: float, Q: Array) -> Belief:
        """One sample on, the friction's state being `z`."""
        x, d = belief.xi[:NX], belief.xi[NX]
        T_f = self.compensation.friction.limit(pull(self.plant, x)) * z
        x_next, A = self._model(x, self.compensation.heard(self._commands[0], x[2:]), d - T_f)
        A = _with_walk(A)
        return Belief(np.append(x_next[0], d), A @ belief.covariance @ A.T + Q)

    def _corrected(self, belief: Belief, read: Array, there: Mask) -> Belief:
        """After the readings `there` (3,) of `read` (3,)."""
        C, R = np.eye(NX + 1)[_MEASURED[there]], self.R[np.ix_(there, there)]
        S = C @ belief.covariance @ C.T + R
        gain = np.linalg.solve(S, C @ belief.covariance).T
        left = np.eye(NX + 1) - gain @ C
        covariance = left @ belief.covariance @ left.T + gain @ R @ gain.T  # Joseph's form: stays symmetric
        return Belief(belief.xi + gain @ (read[there] - C @ belief.xi), covariance)

    @property
    def stationary(self) -> Array:
        """Covariance (5, 5) before a measurement, once the filter has run for long."""
        from scipy.linalg import solve_discrete_are

        P = np.full(NU, np.mean(self.plant.joint.pressure_limits))
        _, A = self._model(np.array([np.mean(self.plant.joint.angle_range), 0.0, *P]), P, 0.0)
        scale = np.outer(_SCALE, _SCALE)
        C, c_scale = np.eye(NX + 1)[_MEASURED], _SCALE[_MEASURED]
        A = _with_walk(A) / _SCALE[:, None] * _SCALE
        return np.asarray(scale * solve_discrete_are(A.T, C.T, self.Q / scale, self.R / np.outer(c_scale, c_scale)))

    def _discrete(self) -> Any:
        """(x, v, d) ↦ x and its derivative by (x, d), transposed because `Buffered` hands back transposes."""
        import casadi as ca

        x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NU), ca.SX.sym("d")
        x_next = self.plant.discrete(self.dt)(x, v, d)
        slope = ca.densify(ca.jacobian(x_next, ca.vertcat(x, d)).T)
        return ca.Function("observed", [x, v, d], [x_next, slope])


def _with_walk(A: Array) -> Array:
    """(5, 5) from the plant's derivative (4, 5): d stays."""
    return np.vstack([A, np.eye(NX + 1)[-1:]])


__all__ = ["DOUBT", "Belief", "Differentiator", "KalmanObserver", "Noise", "Observer"]
