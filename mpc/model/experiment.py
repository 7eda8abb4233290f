"""Experiments for closed loops, and other parts common to all machines.

An experiment is a plant with its state, its sensors and the time.

Classical Runge–Kutta method for formulas of numbers or CasADi symbols; compiled code uses its tableau.

`variational` has the equations of a motion's derivatives, S' = ∂f/∂x S + (0, ∂f/∂v), from
S = ∂x/∂(x(0), v) = (1, 0).
"""

from collections.abc import Callable, Sequence
from math import ceil
from typing import NamedTuple, Protocol

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import SX, Function
from mpc.codegen.buffered import Buffered

FINE = 0.02  # resolution of simulations, see `Plant.discrete`
RESOLUTION = 0.5  # of a controller's model
SYMMETRIC = 1e-9  # [-] of the greatest entry of a stiffness
_DOMINANT = 2 - 1e-9  # [-] sum of a row by its diagonal, less a margin for rounding


def substeps(machine: str, dt: float, fastest: float, resolution: float, most: int, check: str) -> int:
    """Return the number of equal steps h over `dt` [s] with h · `fastest` [1/s] ≤ `resolution`.

    Raises `InvalidInput` for a `machine` that needs more than `most`, with the parameters to `check`.
    """
    steps = dt * fastest / resolution
    if not steps <= most:
        raise InvalidInput(
            f"{machine} moves within {1 / fastest:.3g} s, so that dt = {dt:g} s would take {steps:.3g} steps of "
            f"integration{check}"
        )
    return ceil(steps)


class Experiment(Protocol):
    """Plant in operation."""

    @property
    def x(self) -> Array:
        """True state (2n + m,): angles [rad], velocities [rad/s], pressures [Pa]."""

    def measure(self) -> Array:
        """Return the readings of the sensors (2n + m,); NaN for unmeasured entries. Call it once per sample."""

    def advance(self, u: Array, d: Value = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] and the torque `d` [N·m], (n,) for an arm, added to the
        plant's own external torque.
        """


class ExactExperiment:
    """Experiment on a plant that equals its model, (x, u, d) ↦ x, with a fully measured state."""

    def __init__(self, discrete: "Function", x0: Array) -> None:
        self._integrate = Buffered(discrete)
        self.x = x0

    def measure(self) -> Array:
        """Return the true state (2n + m,)."""
        return self.x.copy()

    def advance(self, u: Array, d: Value = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] and the external torque `d` [N·m]."""
        self.x = self._integrate(self.x, u, d)[0][0]


class Held(NamedTuple):
    """Pressures that hold postures, from `allocate`."""

    P: Array  # (M, m) [Pa]
    K: Array  # (M, stiffnesses) svec of their stiffness
    K_error: Array  # from the target
    T_error: Array  # [N·m]


class Labels(NamedTuple):
    """Names of the columns of a table, without their units."""

    angles: tuple[str, ...]
    speeds: tuple[str, ...]
    stiffness: tuple[str, ...]  # one per entry of svec K
    pressures: tuple[str, ...]
    forces: tuple[str, ...]


def _dominant(K: Array) -> bool:
    """Return whether `K` (M, k, k) is symmetric and its diagonal dominates, which suffices for a positive definite one.

    A diagonal dominates if it is more than half of each row's sum of |entries|. It takes a tenth of the time of a
    factorisation.
    """
    diagonal = K.diagonal(axis1=-2, axis2=-1)
    return bool((np.abs(K).sum(axis=-1) < _DOMINANT * diagonal).all() and (K == K.swapaxes(-1, -2)).all())


def check_stiffness(name: str, K: Array, unit: str) -> None:
    """Raise `InvalidInput` for implausible stiffness matrices (M, k, k)."""
    if _dominant(K):
        return
    if not np.isfinite(K).all():
        raise InvalidInput(f"{name} is not finite [{unit}]")
    if np.abs(K - K.swapaxes(-1, -2)).max() > SYMMETRIC * np.abs(K).max():
        raise InvalidInput(f"{name} is not symmetric: a stiffness is, K_ij = K_ji")
    try:
        np.linalg.cholesky(K)
    except np.linalg.LinAlgError:
        raise InvalidInput(f"{name} is not positive definite: such a posture does not hold itself") from None


NODES, SHARES = (0.0, 1 / 2, 1 / 2, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)


def integrated(rate: Callable[[Value, Value], Value], x: Value, duration: Value, substeps: int) -> Value:
    """Return the state after `duration` [s] of x' = rate(x, t) from `x` at t = 0, in `substeps` equal steps."""
    h = duration / substeps
    for step in range(substeps):
        begin, middle, end = step * h, (step + 1 / 2) * h, (step + 1) * h
        k1 = rate(x, begin)
        k2 = rate(x + h / 2 * k1, middle)
        k3 = rate(x + h / 2 * k2, middle)
        k4 = rate(x + h * k3, end)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def variational(x: "SX", given: Sequence["SX"], v: "SX", rate: "SX") -> "Function":
    """Return the CasADi function (x, S, *given) ↦ (x', S') of x' = `rate`, an expression of `x` and `given`.

    `v` (k, 1) are the inputs by which S (n, n + k) differentiates. S has constant zeros; the S of the function, and S',
    have only the other entries, at the same places and in columns.
    """
    import casadi as ca

    n, k = x.numel(), v.numel()
    jacobian, source = ca.jacobian(rate, x), ca.horzcat(ca.SX(n, n), ca.jacobian(rate, v))
    pattern, grown = None, ca.horzcat(ca.DM.eye(n), ca.DM(n, k)).sparsity()
    while pattern is None or grown != pattern:
        pattern, S = grown, ca.SX.sym("S", grown)
        slope = jacobian @ S + source
        grown = pattern.unite(slope.sparsity())
    return ca.Function("variational", [x, S, *given], ca.cse([rate, ca.project(slope, pattern)]))
