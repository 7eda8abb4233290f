"""Along a horizon the plant has a motion under a sequence of commands, and that motion has exact derivatives.

From the measured x_0 and commands ū_0 … ū_{N-1} (the previous plan), with f_d the plant over one sample,

    x̄_0 = x_0,   x̄_{k+1} = f_d(x̄_k, ū_k, d_k),   A_k = ∂f_d/∂x,   B_k = ∂f_d/∂u,   c_k = x̄_{k+1} - A_k x̄_k - B_k ū_k
    K̄_k = K(x̄_k),   C_k = ∂K/∂x,   F̄_k = F(x̄_k),   D_k = ∂F/∂x

so that x_{k+1} = A_k x_k + B_k u_k + c_k, K_k = K̄_k + C_k (x_k - x̄_k) and the muscle forces F_k = F̄_k + D_k (x_k - x̄_k)
to first order. Since x̄ is a motion of the plant the linear model is exact on it. Derivatives are CasADi's, evaluated
for all k in one call.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.model.buffered import Buffered
from mpc.model.plant import NU, NX, Plant


@dataclass(frozen=True)
class Motion:
    """A motion is what the plant does under given commands; time runs along the first axis."""

    u: Array  # (N, 2) commanded pressures [Pa]
    x: Array  # (N+1, 4) states
    K: Array  # (N+1,) stiffness [N·m/rad]
    F: Array  # (N+1, 2) muscle forces [N]

    @property
    def finite(self) -> bool:
        """The motion is finite if the prediction stayed within the range of numbers."""
        return all(bool(np.isfinite(array).all()) for array in (self.u, self.x, self.K, self.F))

    def stationary(self, u: Array) -> "Motion":
        """Return no motion at all under the commands `u` (N, 2): all is as at the second sample of this one."""
        return Motion(u, *(np.tile(a[1], (len(u) + 1,) + a[1].ndim * (1,)) for a in (self.x, self.K, self.F)))


@dataclass(frozen=True)
class Linearisation(Motion):
    """A linearisation is a motion and the linear time-varying model about it."""

    A: Array  # (N, 4, 4)
    B: Array  # (N, 4, 2), per Pa
    C: Array  # (N+1, 4), gradient of K
    D: Array  # (N+1, 2, 4), gradients of F

    @property
    def y(self) -> Array:
        """The outputs are (K, F1, F2), (N+1, 3)."""
        return np.column_stack([self.K, self.F])

    @property
    def slope(self) -> Array:
        """The slope is the gradients of the outputs, (N+1, 3, 4)."""
        C = self.C if self.C.ndim == 3 else self.C[:, None]  # an arm's K has several entries
        return np.concatenate([C, self.D], axis=1)

    @property
    def c(self) -> Array:
        """The constants are c_k = x̄_{k+1} - A_k x̄_k - B_k ū_k, (N, 4)."""
        return np.asarray(
            self.x[1:] - np.einsum("kij,kj->ki", self.A, self.x[:-1]) - np.einsum("kij,kj->ki", self.B, self.u)
        )


class Predictor:
    """A predictor makes motions and linearisations of `plant` over `N` samples of `dt` [s]."""

    def __init__(self, plant: Plant, dt: float, N: int) -> None:
        self.plant, self.dt, self.N = plant, dt, N

    def motion(self, x0: Array, u: Array, d: Array | float = 0.0) -> Motion:
        """Return the motion from `x0` (4,) under the commands `u` (N, 2) and the torque `d` [N·m], (N,) or constant."""
        x, K, F = self._motion(x0, u, np.reshape(d, (-1, 1)))
        return Motion(u, x, K[:, 0], F)

    def linearise(self, x0: Array, u: Array, d: Array | float = 0.0) -> Linearisation:
        """Return the motion of `motion` with its derivatives."""
        x, K, F, A, B, C, D = self._linearise(x0, u, np.reshape(d, (-1, 1)))
        A, B, D = A.reshape(self.N, NX, NX), B.reshape(self.N, NX, NU), D.reshape(self.N + 1, NU, NX)
        return Linearisation(u, x, K[:, 0], F, A, B, C, D)

    def stationary(self, x: Array, u: Array) -> Motion:
        """Return no motion at all from `x` (4,) under the commands `u` (N, 2), where the model has none."""
        n = len(u) + 1
        return Motion(u, np.tile(x, (n, 1)), np.zeros(n), np.zeros((n, u.shape[1])))

    @cached_property
    def _motion(self) -> Buffered:
        import casadi as ca

        x0, u, d = self._symbols()
        x, (K, F, *_) = self._symbolic_motion(x0, u, d)
        return Buffered(ca.Function("motion", [x0, u, d], [x, K, F]))

    @cached_property
    def _linearise(self) -> Buffered:
        import casadi as ca

        stage = self.plant.discrete(self.dt)
        x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
        x_next = stage(x, u, d)
        # transposed, because `Buffered` hands back transposes
        slopes = [ca.densify(ca.jacobian(x_next, v).T) for v in (x, u)]
        stage_slopes = ca.Function("stage_slopes", [x, u, d], slopes).map(self.N)
        x0, u, d = self._symbols()
        x, (K, F, C, D) = self._symbolic_motion(x0, u, d)
        A, B = stage_slopes(x[:, : self.N], u, d)
        return Buffered(ca.Function("linearise", [x0, u, d], [x, K, F, A, B, C, D]))

    def _symbols(self) -> tuple[Any, Any, Any]:
        import casadi as ca

        return ca.MX.sym("x0", NX), ca.MX.sym("u", NU, self.N), ca.MX.sym("d", 1, self.N)

    def _symbolic_motion(self, x0: Any, u: Any, d: Any) -> tuple[Any, list[Any]]:
        """Return states (4, N+1); stiffness (1, N+1), forces (2, N+1) and both gradients (4, N+1), (4, 2 (N+1))."""
        import casadi as ca

        later = self.plant.discrete(self.dt).mapaccum(self.N)(x0, u, d)
        x = ca.horzcat(x0, later)
        s = ca.SX.sym("x", NX)
        K, F = ca.SX(self.plant.stiffness(s)), ca.vertcat(*self.plant.forces(s))
        outputs: list[Any] = [K, F, ca.densify(ca.gradient(K, s)), ca.densify(ca.jacobian(F, s).T)]
        return x, list(ca.Function("outputs", [s], outputs).map(self.N + 1)(x))
