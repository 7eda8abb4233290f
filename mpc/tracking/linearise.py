"""Motion of the plant under a sequence of commands over a horizon, and its exact derivatives.

From the measured x_0 and commands ū_0 … ū_{N-1} (the previous plan), with f_d the plant over one sample,

x̄_0 = x_0, x̄_{k+1} = f_d(x̄_k, ū_k, d_k), A_k = ∂f_d/∂x, B_k = ∂f_d/∂u, c_k = x̄_{k+1} - A_k x̄_k - B_k ū_k K̄_k =
K(x̄_k), C_k = ∂K/∂x, F̄_k = F(x̄_k), D_k = ∂F/∂x

to first order x_{k+1} = A_k x_k + B_k u_k + c_k, K_k = K̄_k + C_k (x_k - x̄_k), and the forces of the muscles are
F_k = F̄_k + D_k (x_k - x̄_k). The linear model is exact on x̄, since x̄ is a motion of the plant. CasADi evaluates the
derivatives for all k in one call; those of an arm without formulas are differences (`mpc.model.arm.differences`).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array, Value
from mpc.codegen.buffered import Buffered
from mpc.model.arm.differences import Differences
from mpc.model.arm.model import Arm
from mpc.model.machine import Machine

if TYPE_CHECKING:
    from casadi import MX, Function


@dataclass(frozen=True)
class Motion:
    """Motion of the plant under given commands; time is the first axis."""

    u: Array  # (N, m) commanded pressures [Pa]
    x: Array  # (N+1, 2n + m) states
    K: Array  # (N+1,) stiffness [N·m/rad], (N+1, stiffnesses) svec K of an arm
    F: Array  # (N+1, m) muscle forces [N]

    @property
    def finite(self) -> bool:
        """Whether the prediction stayed within the range of numbers."""
        return all(isfinite(array.sum()) for array in (self.u, self.x, self.K, self.F))

    def stationary(self, u: Array) -> "Motion":
        """Return a standstill under the commands `u` (N, 2), in the state of the second sample of this motion."""
        return Motion(u, *(np.tile(a[1], (len(u) + 1,) + a[1].ndim * (1,)) for a in (self.x, self.K, self.F)))


@dataclass(frozen=True)
class Linearisation(Motion):
    """Motion and the linear time-varying model about it."""

    A: Array  # (N, 4, 4)
    B: Array  # (N, 4, 2), per Pa
    C: Array  # (N+1, 4), gradient of K
    D: Array  # (N+1, 2, 4), gradients of F

    @property
    def y(self) -> Array:
        """Outputs (K, F1, F2), (N+1, 3)."""
        return np.column_stack([self.K, self.F])

    @property
    def slope(self) -> Array:
        """Gradients of the outputs, (N+1, 3, 4)."""
        C = self.C if self.C.ndim == 3 else self.C[:, None]  # an arm's K has several entries
        return np.concatenate([C, self.D], axis=1)


class Predictor:
    """Motions and linearisations of `plant` over `N` samples of `dt` [s]."""

    def __init__(self, plant: Machine, dt: float, N: int) -> None:
        self.plant, self.dt, self.N = plant, dt, N
        self._K = 0 if plant.angle_shape == () else slice(plant.stiffnesses)  # of the outputs

    def motion(self, x0: Array, u: Array, d: Array | float = 0.0) -> Motion:
        """Return the motion from `x0` (2n + m,) under the commands `u` (N, m) and the torque `d` [N·m].

        The torque is (N, n), (N,) for a joint, or constant.
        """
        x, y = self._motion(x0, u, self._torques(d))
        return Motion(u, x, y[:, self._K], y[:, self.plant.stiffnesses :])

    def states(self, x0: Array, u: Array, d: Array) -> Array:
        """Return the states (N + 1, 2n + m) of `motion`, without its outputs."""
        return np.asarray(self._path(x0, u, self._torques(d))[0])

    def linearise(self, x0: Array, u: Array, d: Array | float = 0.0) -> Linearisation:
        """Return the motion that `motion` returns, with its derivatives."""
        x, y, A, B, slope = self._linearise(x0, u, self._torques(d))
        N, k, size = self.N, self.plant.stiffnesses, self.plant.size
        A, B, slope = A.reshape(N, size, size), B.reshape(N, size, self.plant.m), slope.reshape(N + 1, -1, size)
        return Linearisation(u, x, y[:, self._K], y[:, k:], A, B, slope[:, self._K], slope[:, k:])

    def stationary(self, x: Array, u: Array) -> Motion:
        """Return a standstill at `x` (2n + m,) under `u` (N, m), with zero outputs, if there is no finite motion."""
        rows = len(u) + 1
        y = np.zeros((rows, self.plant.stiffnesses + self.plant.m))
        return Motion(u, np.tile(x, (rows, 1)), y[:, self._K], y[:, self.plant.stiffnesses :])

    def _torques(self, d: Array | float) -> Array:
        return np.reshape(d, (-1, self.plant.n)) if np.ndim(d) else np.full((1, self.plant.n), d)

    @cached_property
    def _differences(self) -> Differences | None:
        """Differences for an arm without formulas."""
        return Differences(self.plant, self.dt) if isinstance(self.plant, Arm) and self.plant.unformulated else None

    @cached_property
    def _motion(self) -> Callable[[Array, Array, Array], Sequence[Array]]:
        import casadi as ca

        if self._differences is not None:
            return self._differences.motion
        given = self._symbols(self.N)
        x = self._states(*given)
        return Buffered(ca.Function("motion", given, [x, self._outputs(slopes=False).map(self.N + 1)(x)]))

    @cached_property
    def _path(self) -> Callable[[Array, Array, Array], Sequence[Array]]:
        import casadi as ca

        if self._differences is not None:
            return self._differences.motion
        given = self._symbols(self.N)
        return Buffered(ca.Function("states", given, [self._states(*given)]))

    @cached_property
    def _linearise(self) -> Callable[[Array, Array, Array], Sequence[Array]]:
        import casadi as ca

        if self._differences is not None:
            return self._differences.linearise
        stage, one = self.plant.discrete(self.dt), self._symbols(1)
        x_next = stage(*one)
        # transposed, because `Buffered` hands back transposes
        both = ca.densify(ca.jacobian(x_next, ca.vertcat(*one[:2])).T)  # at once, which shares more
        slopes = ca.vertsplit(both, [0, self.plant.size, both.shape[0]])
        stage_slopes = ca.Function("stage_slopes", one, slopes).map(self.N)
        x0, u, d = self._symbols(self.N)
        x = self._states(x0, u, d)
        y, slope = self._outputs(slopes=True).map(self.N + 1)(x)
        A, B = stage_slopes(x[:, : self.N], u, d)
        return Buffered(ca.Function("linearise", [x0, u, d], [x, y, A, B, slope]))

    def _symbols(self, samples: int) -> list[Value]:
        import casadi as ca

        plant = self.plant
        made = ("x0", plant.size, 1), ("u", plant.m, samples), ("d", plant.n, samples)
        return [(ca.SX if samples == 1 else ca.MX).sym(*each) for each in made]

    def _outputs(self, slopes: bool) -> "Function":
        """Return the function x ↦ y = (svec K, F), and with `slopes` also (∂y/∂x)ᵀ."""
        import casadi as ca

        x = ca.SX.sym("x", self.plant.size)
        y = ca.densify(self.plant.symbolic_outputs(x))
        return ca.Function("outputs", [x], [y, ca.densify(ca.jacobian(y, x).T)] if slopes else [y])

    def _states(self, x0: "MX", u: "MX", d: "MX") -> "MX":
        """Return the states (2n + m, N + 1)."""
        import casadi as ca

        return ca.horzcat(x0, self.plant.discrete(self.dt).mapaccum(self.N)(x0, u, d))
