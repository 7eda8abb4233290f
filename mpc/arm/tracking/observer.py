"""The observer of an arm is an extended Kalman filter for ξ = (q, ω, P, d) from what encoders and pressure sensors say.

    ξ_{k+1} = (f_d(x_k, v_k, d_k), d_k) + w_k,    y_k = (q, P)_k + n_k,    w ~ (0, Q),  n ~ (0, R)

as `mpc.observer.filter` has it for a joint, with a torque d from outside at every joint: a random walk, so that in
steady state nothing of constant torques is left, nor of muscles that pull otherwise than their laws say. v are the
commands that act now, past their dead time. A reading that is NaN, or beyond what the arm can do, does not count.
"""

from collections import deque
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.model.arm.differences import DifferencePredictor
from mpc.model.arm.model import Arm
from mpc.model.buffered import Buffered
from mpc.observer.filter import Noise

_MOST_TORQUE = 100.0  # [N·m] that may be thought of
_FASTEST = 60.0  # [rad/s]
_BEYOND = 10 * DEG  # an angle may be read beyond its range
_AROUND = 0.5 * BAR  # a pressure may be read beyond the supply


class ArmObserver:
    """An observer of `arm` makes state and torques from outside of the readings, sample by sample.

    `noise` gives standard deviations as for a joint, `dead_time` [s] is that of the commands.
    """

    def __init__(self, arm: Arm, dt: float, noise: Noise | None = None, dead_time: float = 0.0) -> None:
        self.arm, self.dt = arm, dt
        self.noise = Noise() if noise is None else noise
        self._delay = round(dead_time / dt)
        n, m, size = arm.n, arm.m, arm.size
        one, noise = np.ones(max(n, m)), self.noise
        walks = [0.0 * one[:n], noise.omega_walk * one[:n], noise.pressure_walk * one[:m], noise.d_walk * one[:n]]
        self._Q = dt * np.diag(np.concatenate(walks) ** 2)
        self._R = np.concatenate([noise.theta**2 * one[:n], noise.pressure**2 * one[:m]])
        self._measured = np.concatenate([np.arange(n), np.arange(2 * n, size)])  # of ξ
        (left, right), (low, high) = arm.angle_limits, arm.mechanism.pressure_limits
        self._read_low = np.concatenate([left - _BEYOND, np.full(m, low - _AROUND)])
        self._read_high = np.concatenate([right + _BEYOND, np.full(m, high + _AROUND)])
        fast, much = np.full(n, _FASTEST), np.full(n, _MOST_TORQUE)
        self._low = np.concatenate([self._read_low[:n], -fast, np.full(m, low), -much])
        self._high = np.concatenate([self._read_high[:n], fast, np.full(m, high), much])
        self._model = self._discrete()
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next readings are the state, and no torque disturbs."""
        self._xi: Array | None = None  # (3n + m,)
        self._covariance = np.zeros_like(self._Q)
        self._commands: deque[Array] = deque(maxlen=self._delay + 1)

    def estimate(self, q: Any, P: Any, u: Any) -> tuple[Array, Array]:
        """Return the state (2n + m,) and torques (n,) [N·m] from readings `q` (n,) [rad] and `P` (m,) [Pa], and the
        commands `u` (m,) [Pa] that were sent last; NaN is what was not read.

        Before the first complete readings all that is not read is answered as NaN. Raises `InvalidInput` for shapes.
        """
        read = np.concatenate([self._row("q", q, self.arm.n), self._row("P", P, self.arm.m)])
        u = self._row("u", u, self.arm.m)
        there = (self._read_low <= read) & (read <= self._read_high)  # NaN is not
        if self._xi is None:
            if not there.all():
                return self._unknown(np.where(there, read, np.nan))
            self._begin(read)
            self._commands.append(u)
        else:
            self._commands.append(np.where(np.isfinite(u), u, self._commands[-1]))
            self._predict()
            self._correct(read, there)
        assert self._xi is not None
        return self._xi[: self.arm.size].copy(), self._xi[self.arm.size :].copy()

    # --- the pieces -------------------------------------------------------------------------------------------------

    def _row(self, name: str, value: Any, size: int) -> Array:
        array = np.asarray(value, float)
        if array.shape != (size,):
            raise InvalidInput(f"{name} has the shape {array.shape}, not ({size},)")
        return array

    def _unknown(self, read: Array) -> tuple[Array, Array]:
        n = self.arm.n
        return np.concatenate([read[:n], np.full(n, np.nan), read[n:]]), np.zeros(n)

    def _begin(self, read: Array) -> None:
        n = self.arm.n
        self._xi = np.concatenate([read[:n], np.zeros(n), read[n:], np.zeros(n)])
        variances = np.ones(self._xi.size)  # of velocities [rad/s]² and torques [N·m]², about which nothing is known
        variances[self._measured] = self._R
        self._covariance = np.diag(variances)

    def _predict(self) -> None:
        assert self._xi is not None
        size, xi = self.arm.size, np.clip(self._xi, self._low, self._high)
        x, slope = self._model(xi[:size], self._commands[0], xi[size:])
        A = np.vstack([slope, np.eye(xi.size)[size:]])
        later = np.append(x, xi[size:])
        if np.isfinite(later).all() and np.isfinite(A).all():
            self._xi, self._covariance = later, A @ self._covariance @ A.T + self._Q

    def _correct(self, read: Array, there: Any) -> None:
        assert self._xi is not None
        if not there.any():
            return
        C, R = np.eye(self._xi.size)[self._measured[there]], np.diag(self._R[there])
        S = C @ self._covariance @ C.T + R
        gain = np.linalg.solve(S, C @ self._covariance).T
        left = np.eye(self._xi.size) - gain @ C
        self._xi = self._xi + gain @ (read[there] - C @ self._xi)
        self._covariance = left @ self._covariance @ left.T + gain @ R @ gain.T  # Joseph's form: stays symmetric

    def _discrete(self) -> Callable[[Array, Array, Array], Sequence[Array]]:
        """Return (x, v, d) ↦ x and its derivative (2n + m, 3n + m) by (x, d)."""
        if not self.arm.has_formulas:
            return DifferencePredictor(self.arm, self.dt, 1).sample
        import casadi as ca

        x, v, d = (ca.MX.sym(name, size) for name, size in (("x", self.arm.size), ("v", self.arm.m), ("d", self.arm.n)))
        x_next = self.arm.discrete(self.dt)(x, v, d)
        # transposed because `Buffered` hands back transposes
        slope = ca.densify(ca.horzcat(ca.jacobian(x_next, x), ca.jacobian(x_next, d)).T)
        return Buffered(ca.Function("observed", [x, v, d], [x_next, slope]))
