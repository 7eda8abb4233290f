"""A machine of n joints and m muscles, as controllers and observers see it: `Plant` (n = 1, m = 2) and `Arm`.

The state is x = (q [rad], ω [rad/s], P [Pa]) ∈ R^(2n+m). Angles, torques and stiffness of a joint are numbers, those of
an arm rows (n,) and matrices (k, k); along a motion they have one row or matrix per sample.
"""

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from casadi import Function

_SYMMETRIC = 1e-9  # of the greatest entry


class Held(NamedTuple):
    """Pressures that hold postures, from `allocate`."""

    P: Array  # (M, m) [Pa]
    K: Array  # (M, stiffnesses) svec of the stiffness that they give
    K_error: Array  # from what was asked
    T_error: Array  # [N·m]


class Labels(NamedTuple):
    """Names of the columns of a table, without their units."""

    angles: tuple[str, ...]
    speeds: tuple[str, ...]
    stiffness: tuple[str, ...]  # one per entry of svec K
    pressures: tuple[str, ...]
    forces: tuple[str, ...]


class Machine(Protocol):
    """The interface of `Plant` and `Arm`."""

    @property
    def n(self) -> int:
        """The number of joints."""

    @property
    def m(self) -> int:
        """The number of muscles."""

    @property
    def size(self) -> int:
        """The number of states, 2n + m."""

    @property
    def stiffnesses(self) -> int:
        """The number of entries of svec K."""

    @property
    def angle_shape(self) -> tuple[int, ...]:
        """The shape of an angle reference: () or (n,)."""

    @property
    def stiffness_shape(self) -> tuple[int, ...]:
        """The shape of a stiffness reference: () or (k, k)."""

    @property
    def slew(self) -> float:
        """The greatest change of a command [Pa/s]."""

    @property
    def lags(self) -> Value:
        """The time constants of the pressures (m,) [s]."""

    @property
    def pressure_limits(self) -> tuple[float, float]:
        """The least and the greatest command [Pa]."""

    @property
    def angle_limits(self) -> tuple[Value, Value]:
        """The least and the greatest angle [rad]."""

    @property
    def has_stops(self) -> bool:
        """Whether the angles are limited by end stops."""

    @property
    def middle(self) -> Value:
        """A posture in the middle of the ranges [rad]."""

    @property
    def inertias(self) -> Array:
        """The moments of inertia (n,) [kg·m²] that accelerate each joint alone, in the middle."""

    @property
    def unformulated(self) -> str:
        """The parts without formulas, or ""."""

    @property
    def fastest_rate(self) -> float:
        """An upper estimate of the fastest eigenvalue [1/s]."""

    @property
    def summary(self) -> str:
        """The numbers in a line."""

    @property
    def labels(self) -> Labels:
        """The names of its columns in tables."""

    def substeps(self, dt: float, resolution: float) -> int:
        """Return how many steps of integration `dt` [s] takes. Raises `InvalidInput` for too many."""

    def discrete(self, dt: float, resolution: float = ...) -> "Function":
        """Return the CasADi function (x, u, d) ↦ x after `dt` [s] of constant `u` and `d`."""

    def symbolic_outputs(self, x: Value) -> Value:
        """Return the CasADi column (svec K, F) in the state `x`."""

    def angles(self, x: Array) -> Array:
        """Return the angles [rad] in the states `x` (…, 2n + m)."""

    def tracked_stiffness(self, x: Array) -> Value:
        """Return the stiffness that is tracked in the states `x` (…, 2n + m)."""

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the tracked stiffness and the muscle forces (M, m) [N] in the states `x` (M, 2n + m)."""

    def assumed(self, x: Array) -> str:
        """Return a sentence listing the assumptions behind the forces in the states `x` (M, 2n + m), or ""."""

    def reachable(self, theta: Array, K: Array, T: Array) -> Array:
        """Return where (M,) some pressures give these stiffnesses and torques."""

    @property
    def stiffness_text(self) -> str:
        """The kind of stiffness that is tracked, in words."""

    @property
    def stiffness_unit(self) -> str:
        """Its unit."""

    def matrix(self, svec: Array) -> Array:
        """Return the stiffness (M, …) of rows svec K (M,) or (M, stiffnesses)."""

    def torque_for(self, theta: Value, omega: Value, alpha: Value, d: Value = 0.0) -> Value:
        """Return the muscle torque [N·m] of a motion under the torque `d` from outside."""

    def torque_reach(self) -> tuple[Array, Array]:
        """Return the greatest |T| (n,) [N·m] of the muscles in the middle of the ranges, and anywhere."""

    def balance(self, x: Array) -> Value:
        """Return the torque from outside [N·m] under which the machine is linearised about `x`."""

    def held(self, theta: Array, K: Array, T: Array, min_force: float) -> Held:
        """Return the pressures that give these angles, stiffnesses and torques along a motion, or the nearest."""

    def expansion(self, x: Value) -> Value:
        """Return how fast the pressures fall in the states `x` [2n + m, …] as the muscles swell [Pa/s]."""

    def check_feed_forward(self) -> None:
        """Raise `InvalidInput` for muscles whose inverse dynamics a control step has no time for."""

    def warm_up(self, min_force: float) -> None:
        """Compile what `held` needs."""

    def check_angles(self, name: str, theta: Array) -> None:
        """Raise `InvalidInput` for a reference that cannot be meant."""

    def check_stiffness(self, name: str, K: Array) -> None:
        """Raise `InvalidInput` for a reference that cannot be meant."""


def check_stiffness(name: str, K: Array, unit: str) -> None:
    """Raise `InvalidInput` for stiffness matrices (M, k, k) that cannot be meant."""
    if not np.isfinite(K).all():
        raise InvalidInput(f"{name} is not finite [{unit}]")
    if np.abs(K - K.swapaxes(-1, -2)).max() > _SYMMETRIC * np.abs(K).max():
        raise InvalidInput(f"{name} is not symmetric: a stiffness is, K_ij = K_ji")
    try:
        np.linalg.cholesky(K)
    except np.linalg.LinAlgError:
        raise InvalidInput(f"{name} is not positive definite: such a posture does not hold itself") from None
