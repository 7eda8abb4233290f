"""Motion of an arm without formulas, sample by sample, and its derivatives by differences.

The bodies are integrated by the classical Runge–Kutta method, as in `Arm.discrete`, and linearised once per sample, in
the middle of it. With z' = F z + G (u, d) there,

    exp [F G; 0 0] dt = [A B; 0 1]

are the sample's derivatives up to an error of the third order in dt. Acceleration and gas are differentiated by central
differences over angles and velocities. Over pressures the slope M⁻¹ rᵀ F_P of the acceleration needs none.
"""

import numpy as np

from allocator.calculus import Array
from mpc.model.arm.model import Arm
from mpc.model.arm.mujoco_mechanics import MujocoBodies, MujocoTendons
from mpc.model.arm.pneumatics import Pneumatics
from mpc.model.experiment import integrated

_ANGLE, _SPEED = 1e-5, 1e-4  # [rad], [rad/s] of central differences
_COARSE = 1.0  # step of the integration times the fastest eigenvalue
_BEND = 1e-4  # [rad], of differences of differences
_SHARE = 1e-4  # of the supply range: differences over pressures


class Differences:
    """Differences in place of the formulas of `arm` over samples of `dt` [s].

    A step of the integration times the fastest eigenvalue is at most `resolution`, as in `Arm.discrete`.
    """

    def __init__(self, arm: Arm, dt: float, resolution: float = _COARSE) -> None:
        self.arm, self.dt = arm, dt
        mechanism = arm.mechanism
        self._muscles = Pneumatics(mechanism.muscles, mechanism.routes.rest_length, arm.lags, arm.gas)
        self._substeps = arm.substeps(dt, resolution)
        routes = mechanism.routes
        self._tendons = routes if isinstance(routes, MujocoTendons) else None

    def motion(self, x0: Array, u: Array, d: Array) -> tuple[Array, Array]:
        """Return the states (N+1, 2n + m) from `x0` under commands (N, m) and torques, and the outputs (svec K, F)."""
        x = self._states(x0, u, np.broadcast_to(d, (len(u), self.arm.n)))
        return x, np.hstack(self._outputs(x))

    def linearise(self, x0: Array, u: Array, d: Array) -> tuple[Array, ...]:
        """Return states and outputs of `motion`, A and B of every sample, and the slope of the outputs."""
        x, y = self.motion(x0, u, d)
        A, B, _ = self._slopes((x[:-1] + x[1:]) / 2, np.broadcast_to(d, (len(u), self.arm.n)))
        return x, y, A, B, np.concatenate(self._output_slopes(x), axis=1)

    def sample(self, x: Array, u: Array, d: Array) -> tuple[Array, Array]:
        """Return the next state (2n + m,) and its derivative (2n + m, 3n + m) by (x, d)."""
        later = self._later(x, u, d)
        A, _, D = self._slopes(((x + later) / 2)[None], d[None])
        return later, np.hstack([A[0], D[0]])

    # --- motion -----------------------------------------------------------------------------------------------------

    def _states(self, x0: Array, u: Array, d: Array) -> Array:
        x = [np.asarray(x0, float)]
        for command, torque in zip(u, d, strict=True):
            x.append(self._later(x[-1], command, torque))
        return np.array(x)

    def _later(self, x: Array, u: Array, d: Array) -> Array:
        n, lags = self.arm.n, self.arm.lags
        if self.arm.gas is not None:

            def whole(s: Array, t: float) -> Array:
                omega, P = s[n : 2 * n], s[2 * n :]
                acceleration, rise = self._driven(s[:n], omega, P, d)
                return np.concatenate([omega, acceleration, (u - P) / lags + rise])

            return np.asarray(integrated(whole, x, self.dt, self._substeps))
        gap = x[2 * n :] - u

        def bodies(s: Array, t: float) -> Array:
            return np.concatenate([s[n:], self._driven(s[:n], s[n:], u + np.exp(-t / lags) * gap, d)[0]])

        moved = integrated(bodies, x[: 2 * n], self.dt, self._substeps)
        return np.concatenate([moved, u + np.exp(-self.dt / lags) * gap])

    def _driven(self, q: Array, omega: Array, P: Array, d: Array) -> tuple[Array, Array]:
        """Return ω' (…, n), and P' (…, m) by the gas alone, of states and torques (…, …)."""
        tendons = self._tendons
        if q.ndim == 1 and tendons is not None and isinstance(self.arm.bodies, MujocoBodies):
            length, slope, M, bias = tendons.mechanics.moving(q, omega)  # all at once
            length, arms = length - tendons.cable, -slope
        else:
            length, arms = self._ways(q)
            M, bias = self.arm.bodies.mass_matrix(q), self.arm.bodies.bias(q, omega)
        torque = (self._muscles.laws(length, P)[..., None, :] @ arms)[..., 0, :]
        acceleration = np.linalg.solve(M, (torque - bias + d)[..., None])[..., 0]
        return np.asarray(acceleration), self._rise(P, length, arms, omega)

    def _rise(self, P: Array, length: Array, arms: Array, omega: Array) -> Array:
        """Return the rise of the pressures (…, m) [Pa/s] of the gas   (G3); 0 without gas."""
        if self.arm.gas is None:
            return np.zeros(P.shape)
        return self._muscles.squeezed(P, length, -(arms @ omega[..., None])[..., 0])

    def _ways(self, q: Array) -> tuple[Array, Array]:
        """Return the muscles' lengths (…, m) and arms (…, m, n) [m]."""
        routes = self.arm.mechanism.routes
        return routes.ways(q) if isinstance(routes, MujocoTendons) else routes.at(q)[:2]

    # --- derivatives ------------------------------------------------------------------------------------------------

    def _slopes(self, x: Array, d: Array) -> tuple[Array, Array, Array]:
        """Return ∂x⁺/∂x (N, s, s), ∂x⁺/∂u (N, s, m) and ∂x⁺/∂d (N, s, n) of samples about the states `x` (N, s)."""
        from scipy.linalg import expm

        n, m, size = self.arm.n, self.arm.m, self.arm.size
        q, omega, P = x[:, :n], x[:, n : 2 * n], x[:, 2 * n :]
        rates = np.zeros((len(x), size + m + n, size + m + n))
        rates[:, :n, n : 2 * n] = np.eye(n)
        for begin, step in ((0, _ANGLE), (n, _SPEED)):
            for i in range(n):
                away = np.zeros(2 * n)
                away[begin + i] = step
                ends = [self._driven(q + sign * away[:n], omega + sign * away[n:], P, d) for sign in (1.0, -1.0)]
                rates[:, n:size, begin + i] = (np.hstack(ends[0]) - np.hstack(ends[1])) / (2 * step)
        length, arms = self._ways(q)
        gains = self._muscles.force_slopes(length, P)  # (N, m)
        M = self.arm.bodies.mass_matrix(q)
        rates[:, n : 2 * n, 2 * n : size] = np.linalg.solve(M, (gains[..., None] * arms).swapaxes(-1, -2))
        rates[:, n : 2 * n, size + m :] = np.linalg.inv(M)
        step = _SHARE * self.arm.mechanism.pressure_span
        rises = [self._rise(P + sign * step, length, arms, omega) for sign in (1.0, -1.0)]  # each by its own pressure
        own = (rises[0] - rises[1]) / (2 * step) - 1 / self.arm.lags
        rates[:, 2 * n : size, 2 * n : size] = own[..., None] * np.eye(m)
        rates[:, 2 * n : size, size : size + m] = np.diag(1 / self.arm.lags)
        found = expm(rates * self.dt)[:, :size]
        return found[:, :, :size], found[:, :, size : size + m], found[:, :, size + m :]

    def _outputs(self, x: Array) -> tuple[Array, Array]:
        """Return svec K (N+1, …) and the forces (N+1, m)."""
        K, F = self.arm.along(x)
        return self.arm.svec(K), F

    def _output_slopes(self, x: Array) -> tuple[Array, Array]:
        """Return the derivatives (N+1, k, s) and (N+1, m, s) of the outputs by the states."""
        n, q, P = self.arm.n, x[:, : self.arm.n], x[:, 2 * self.arm.n :].T
        K, F = self._outputs(x)
        C, D = np.zeros((*K.shape, self.arm.size)), np.zeros((*F.shape, self.arm.size))
        for i in range(n):
            away = _BEND * np.eye(self.arm.size)[i]
            ahead, behind = self._outputs(x + away), self._outputs(x - away)
            for slope, one, other in zip((C, D), ahead, behind, strict=True):
                slope[..., i] = (one - other) / (2 * _BEND)
        muscles = self.arm.mechanism.at(q)
        joints = np.asarray(sum(muscle.stiffness(pressure) for muscle, pressure in zip(muscles, P, strict=True)))
        for j, (muscle, pressure) in enumerate(zip(muscles, P, strict=True)):
            D[:, j, 2 * n + j] = muscle.force_gain(pressure)
            step = _SHARE * self.arm.mechanism.pressure_span
            gain = muscle.stiffness_gain(pressure) * step
            ends = [self.arm.svec(self.arm.seen(q, joints + sign * gain)) for sign in (1.0, -1.0)]
            C[..., 2 * n + j] = (ends[0] - ends[1]) / (2 * step)
        return C, D
