"""Muscle lengths as functions of the posture: formulas, differentiated by CasADi, or tables over a grid of postures.

A table estimates its own `error` and is refused if that is too great, see `allocator.joint.geometry`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.geometry import TableError, check_table, greatest_differences, halves
from allocator.lazy import SX
from allocator.mechanism.routes.base import RoutedLengths, Routes, check_arms, check_lengths, rest_lengths

if TYPE_CHECKING:
    import casadi as ca
    from scipy.interpolate import NdBSpline


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


_FEWEST = 4  # samples of a joint: least number for a cubic
_PARTS = (8, 4, 2)  # of the distance between two samples, of tables over one, two and more joints
_MOST_POINTS = 20_001  # for the comparison of a table with its half


@dataclass(frozen=True)
class Tables(Routes):
    """Lengths over a grid of joint angles, interpolated by tensor products of cubic splines."""

    grid: tuple[tuple[float, ...], ...]  # n rows of angles [rad], increasing
    lengths: tuple[Any, ...] = field(repr=False)  # nested: (n1, …, nn, m) [m]

    def __init__(self, rest_length: ArrayLike, grid: Sequence[ArrayLike], lengths: ArrayLike) -> None:
        """Check and keep `grid`, n rows of angles [rad], and `lengths` (n1, …, nn, m) [m]. Raises `InvalidInput`."""
        rows = [checks.angle(f"Tables: grid[{i}]", row) for i, row in enumerate(grid)]
        l_ = checks.real("Tables: lengths", lengths, "m")
        for i, row in enumerate(rows):
            if row.ndim != 1 or row.size < _FEWEST or not (np.diff(row) > 0).all():
                raise InvalidInput(f"Tables: grid[{i}] has to be a row of {_FEWEST} or more increasing angles [rad]")
        shape = tuple(row.size for row in rows)
        if not rows or l_.ndim != len(rows) + 1 or l_.shape[:-1] != shape or not l_.shape[-1]:
            raise InvalidInput(
                f"Tables: lengths have the shape {l_.shape}; the grid of n = {len(rows)} joints and m "
                f"muscles expects ({', '.join(map(str, shape))}, m)"
            )
        check_lengths("Tables", l_)
        object.__setattr__(self, "grid", tuple(tuple(row.tolist()) for row in rows))
        object.__setattr__(self, "lengths", _nested(l_.tolist()))
        object.__setattr__(self, "rest_length", rest_lengths("Tables", rest_length, l_.shape[-1]))
        spread = [np.ptp(l_, axis=i).max(axis=tuple(range(len(rows) - 1))) for i in range(len(rows))]
        check_arms("Tables", np.stack(spread, axis=-1))
        arms = np.abs(self.at(self._grid_points).arm).max(axis=(0, 2))
        check_table("Tables", self.error, arms, min(shape))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.grid)

    @property
    def reach(self) -> tuple[tuple[float, float], ...]:
        """First and last angle of each joint in the grid [rad]."""
        return tuple((row[0], row[-1]) for row in self.grid)

    @cached_property
    def _spline(self) -> "NdBSpline":
        return _spline_through(self.grid, np.array(self.lengths))

    @property
    def _grid_points(self) -> Array:
        """Postures (p, n) at the samples and between them [rad], evenly thinned if there are many."""
        part = 1 / _PARTS[min(self.n, 3) - 1]
        rows = [np.interp(np.arange(0, len(row) - 1 + part / 2, part), np.arange(len(row)), row) for row in self.grid]
        sizes = [row.size for row in rows]
        total = int(np.prod(sizes))
        stride = max(1, -(-total // _MOST_POINTS)) | 1  # odd: takes samples and intermediate points alike
        places = np.unravel_index(np.arange(0, total, stride), sizes)
        return np.stack([row[i] for row, i in zip(rows, places, strict=True)], axis=-1)

    @cached_property
    def error(self) -> TableError:
        """Differences of every muscle to the splines through every second sample of all joints."""
        q = self._grid_points
        mine = self.at(q)
        found = []
        for kept in zip(*(halves(len(row)) for row in self.grid), strict=True):
            grid = [[row[i] for i in places] for row, places in zip(self.grid, kept, strict=True)]
            other = _evaluated(_spline_through(grid, np.array(self.lengths)[np.ix_(*kept)]), q, self.m)
            arm = np.linalg.norm(mine.arm - other.arm, axis=-1)
            bend = np.abs(mine.bend - other.bend).max(axis=(-1, -2))
            found.append([mine.length - other.length, arm, bend])
        return greatest_differences(np.array(found).swapaxes(0, 1), q)

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n); the end pieces extend beyond the grid."""
        return _evaluated(self._spline, q, self.m)


def _spline_through(grid: Sequence[Sequence[float]], lengths: Array) -> "NdBSpline":
    """Return the tensor product of splines through lengths (n1, …, nn, m): cubic, or lower with few samples."""
    from scipy.interpolate import NdBSpline, make_interp_spline

    knots, degrees = [], []
    for i, row in enumerate(grid):
        degrees.append(min(3, len(row) - 1))
        spline = make_interp_spline(row, lengths, k=degrees[-1], axis=i)
        lengths = np.moveaxis(spline.c, 0, i)
        knots.append(spline.t)
    return NdBSpline(tuple(knots), lengths, tuple(degrees), extrapolate=True)


def _evaluated(spline: "NdBSpline", q: Array, m: int) -> RoutedLengths:
    """Return lengths, arms and bends of m muscles at the postures (…, n)."""
    n = q.shape[-1]
    unit = np.eye(n, dtype=int)
    arm, bend = np.empty((*q.shape[:-1], m, n)), np.empty((*q.shape[:-1], m, n, n))
    for a in range(n):
        arm[..., a] = -spline(q, nu=unit[a])
        for b in range(a, n):
            bend[..., a, b] = bend[..., b, a] = spline(q, nu=unit[a] + unit[b])
    return RoutedLengths(spline(q), arm, bend)


def _nested(value: object) -> Any:
    return tuple(map(_nested, value)) if isinstance(value, list) else value
