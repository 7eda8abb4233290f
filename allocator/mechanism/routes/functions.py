"""Muscles whose lengths are a formula of the posture, which CasADi differentiates."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.mechanism.routes.base import RoutedLengths, Routes, rest_lengths
from allocator.mechanism.routes.symbolic import SymbolicColumn


@dataclass(frozen=True)
class FunctionRoutes(Routes):
    """`FunctionRoutes` have the lengths l(q) that a function of yours gives for a CasADi vector q (n,)."""

    joints: int
    function: Callable[[Value], Value]

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return self.joints

    @cached_property
    def _column(self) -> SymbolicColumn:
        return SymbolicColumn("from_function", self.joints, self.function)

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n). Raises `InvalidInput` where one is not finite."""
        length, slope, curve = self._column.at(q)
        return RoutedLengths(length, -slope, curve)


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
