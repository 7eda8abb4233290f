"""Muscle lengths as formulas of the posture, differentiated by CasADi."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import SX
from allocator.mechanism.routes.base import RoutedLengths, Routes, rest_lengths

if TYPE_CHECKING:
    import casadi as ca


@dataclass(frozen=True)
class SymbolicColumn:
    """Column of k CasADi expressions that `function` returns for a vector q (n,)."""

    name: str  # for messages
    joints: int  # n
    function: Callable[[Value], Value]

    @cached_property
    def expression(self) -> tuple[Value, Value]:
        """Symbol q and the column (k, 1). Raises `InvalidInput` unless it is a column."""
        import casadi as ca

        q = ca.SX.sym("q", self.joints)
        value = self.function(q)
        try:
            column = ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value)
        except (TypeError, NotImplementedError):
            raise InvalidInput(f"{self.name}: the function gives {checks.brief(value)}, no CasADi expression") from None
        if column.shape[1] != 1 or not column.shape[0]:
            raise InvalidInput(f"{self.name}: the function gives the shape {column.shape}; expected a column")
        return q, column

    @property
    def size(self) -> int:
        """k."""
        return int(self.expression[1].shape[0])

    @cached_property
    def _derivatives(self) -> "ca.Function":
        """CasADi function q ↦ (column (k, 1), first (k, n), second derivatives (k n, n))."""
        import casadi as ca

        q, column = self.expression
        slope = ca.jacobian(column, q)
        return ca.Function("column", [q], [column, slope, ca.jacobian(ca.vec(slope.T), q)])

    def at(self, q: Array) -> tuple[Array, Array, Array]:
        """Return the column (…, k) at the postures `q` (…, n), its derivatives (…, k, n) and (…, k, n, n).

        Raises `InvalidInput` if one is not finite.
        """
        flat, n, k = q.reshape(-1, self.joints), self.joints, self.size
        found = self._derivatives.map(len(flat))(flat.T)
        value, slope, curve = (np.asarray(x).reshape(x.shape[0], len(flat), -1).swapaxes(0, 1) for x in found)
        if not all(np.isfinite(x).all() for x in (value, slope, curve)):
            raise InvalidInput(f"{self.name}: a value, or a derivative of it, is not finite at one of the postures")
        shape = q.shape[:-1]
        return value.reshape(*shape, k), slope.reshape(*shape, k, n), curve.reshape(*shape, k, n, n)


@dataclass(frozen=True)
class FunctionRoutes(Routes):
    """Routes with lengths l(q) by a user's function of a CasADi vector q (n,)."""

    joints: int
    function: Callable[[Value], Value]

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.joints

    @cached_property
    def _column(self) -> SymbolicColumn:
        return SymbolicColumn("from_function", self.joints, self.function)

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n). Raises `InvalidInput` if one is not finite."""
        length, slope, curve = self._column.at(q)
        return RoutedLengths(length, -slope, curve)

    def symbolic(self, q: "SX") -> Sequence["SX | float"]:
        """Return the user's formulas of a CasADi column `q` (n, 1)."""
        import casadi as ca

        value = self.function(q)
        return list(value) if isinstance(value, list | tuple) else ca.vertsplit(ca.SX(value))


def from_function(rest_length: object, n: int, function: Callable[[Value], Value]) -> FunctionRoutes:
    """Return the routes with the muscle lengths `function(q)` (m,) [m], a CasADi expression of a vector q (n,) [rad].

    `rest_length` is a number or a row (m,) [m]. Raises `InvalidInput`.
    """
    import casadi as ca

    n = checks.count("from_function: n", n, 1)
    q, length = SymbolicColumn("from_function", n, function).expression
    dependent = np.array(ca.DM(ca.jacobian_sparsity(length, q), 1))
    if not dependent.any(axis=1).all():
        idle = int(np.argmin(dependent.any(axis=1)))
        raise InvalidInput(f"from_function: muscle {idle + 1} has no arm at any joint; it moves nothing")
    return FunctionRoutes(rest_lengths("from_function", rest_length, length.shape[0]), n, function)
