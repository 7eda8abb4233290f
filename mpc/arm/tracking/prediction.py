"""Along a horizon an arm has a motion under a sequence of commands, and that motion has exact derivatives.

As `mpc.tracking.linearise` has it, whose values these are, with the state (q, ω, P) ∈ R^(2n+m), svec K for K and m
forces. CasADi differentiates the formulas of `mpc.arm.model`.
"""

from functools import cached_property
from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.arm.model import Arm
from mpc.arm.tracking.differences import DifferencePredictor
from mpc.model.buffered import Buffered
from mpc.tracking.linearise import Linearisation, Motion


class ArmPredictor:
    """A predictor makes motions and linearisations of `arm` over `N` samples of `dt` [s]."""

    def __init__(self, arm: Arm, dt: float, N: int) -> None:
        self.arm, self.dt, self.N = arm, dt, N

    def motion(self, x0: Array, u: Array, d: Array) -> Motion:
        """Return the motion from `x0` (2n + m,) under the commands `u` (N, m) and the torques `d` (N, n) [N·m]."""
        x, y = self._motion(x0, u, d)
        K, F = self._outputs(y)
        return Motion(u, x, K, F)

    def linearise(self, x0: Array, u: Array, d: Array) -> Linearisation:
        """Return the motion of `motion` with its derivatives."""
        size, m, N = self.arm.size, self.arm.m, self.N
        x, y, A, B, slope = self._linearise(x0, u, d)
        slope = slope.reshape(N + 1, -1, size)
        outputs, gradients = self._outputs(y), (slope[:, :-m], slope[:, -m:])
        return Linearisation(u, x, *outputs, A.reshape(N, size, size), B.reshape(N, size, m), *gradients)

    def stationary(self, x: Array, u: Array) -> Motion:
        """Return no motion at all from `x` (2n + m,) under the commands `u` (N, m), where the model has none."""
        rows, arm = len(u) + 1, self.arm
        return Motion(u, np.tile(x, (rows, 1)), np.zeros((rows, arm.stiffnesses)), np.zeros((rows, arm.m)))

    def _outputs(self, y: Array) -> tuple[Array, Array]:
        return y[:, : -self.arm.m], y[:, -self.arm.m :]

    @cached_property
    def _motion(self) -> Buffered:
        import casadi as ca

        x0, u, d = self._symbols()
        x = self._states(x0, u, d)
        y = self._along(self.arm.outputs)(*self._posture(x))
        return Buffered(ca.Function("motion", [x0, u, d], [x, y]))

    @cached_property
    def _linearise(self) -> Buffered:
        import casadi as ca

        arm, s = self.arm, self.arm.statics
        stage = arm.discrete(self.dt)
        given = [ca.MX.sym("x", arm.size), ca.MX.sym("u", arm.m), ca.MX.sym("d", arm.n)]
        # transposed, because `Buffered` hands back transposes
        slopes = [ca.densify(ca.jacobian(stage(*given), v).T) for v in given[:2]]
        stage_slopes = ca.Function("stage_slopes", given, slopes).map(self.N)
        zero = ca.SX.zeros(arm.outputs.shape[0], arm.n)  # nothing depends on velocities
        y_slope = ca.horzcat(ca.jacobian(arm.outputs, s.q), zero, ca.jacobian(arm.outputs, s.P))
        x0, u, d = self._symbols()
        x = self._states(x0, u, d)
        y, slope = (self._along(value)(*self._posture(x)) for value in (arm.outputs, y_slope.T))
        return Buffered(ca.Function("linearise", [x0, u, d], [x, y, *stage_slopes(x[:, : self.N], u, d), slope]))

    def _symbols(self) -> tuple[Any, Any, Any]:
        import casadi as ca

        return ca.MX.sym("x0", self.arm.size), ca.MX.sym("u", self.arm.m, self.N), ca.MX.sym("d", self.arm.n, self.N)

    def _states(self, x0: Any, u: Any, d: Any) -> Any:
        """Return the states (2n + m, N + 1)."""
        import casadi as ca

        return ca.horzcat(x0, self.arm.discrete(self.dt).mapaccum(self.N)(x0, u, d))

    def _posture(self, x: Any) -> tuple[Any, Any]:
        return x[: self.arm.n, :], x[2 * self.arm.n :, :]

    def _along(self, value: Any) -> Any:
        """Return the function of q (n, N + 1) and P (m, N + 1) that a formula of one posture is."""
        import casadi as ca

        s = self.arm.statics
        return ca.Function("along", [s.q, s.P], [ca.densify(value)]).map(self.N + 1)


def predictor_of(arm: Arm, dt: float, N: int) -> "ArmPredictor | DifferencePredictor":
    """Return a predictor of `arm`: by its formulas, or by differences where it has none."""
    return ArmPredictor(arm, dt, N) if arm.has_formulas else DifferencePredictor(arm, dt, N)
