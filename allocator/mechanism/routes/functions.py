"""Muscles whose lengths are a formula of the posture, which CasADi differentiates."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.routes.base import RoutedLengths, Routes, rest_lengths


@dataclass(frozen=True)
class FunctionRoutes(Routes):
    """`FunctionRoutes` have the lengths l(q) that a function of yours gives for a CasADi vector q (n,)."""

    joints: int
    function: Callable[[Any], Any]

    @property
    def n(self) -> int:
        """Return the number of joints."""
        return self.joints

    @cached_property
    def _derivatives(self) -> Any:
        """Return the CasADi function q ↦ (l (m, 1), ∇l (m, n), ∇²l (m n, n))."""
        q, length = _expression(self.function, self.joints)
        import casadi as ca

        slope = ca.jacobian(length, q)
        return ca.Function("lengths", [q], [length, slope, ca.jacobian(ca.vec(slope.T), q)])

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n). Raises `InvalidInput` where one is not finite."""
        flat, n, m = q.reshape(-1, self.n), self.n, self.m
        found = self._derivatives.map(len(flat))(flat.T)
        length, slope, curve = (np.asarray(x).reshape(x.shape[0], len(flat), -1).swapaxes(0, 1) for x in found)
        if not (np.isfinite(length).all() and np.isfinite(slope).all() and np.isfinite(curve).all()):
            raise InvalidInput("from_function: a length, or a derivative of it, is not finite at one of the postures")
        shape = q.shape[:-1]
        return RoutedLengths(length.reshape(*shape, m), -slope.reshape(*shape, m, n), curve.reshape(*shape, m, n, n))


def from_function(rest_length: Any, n: int, function: Callable[[Any], Any]) -> FunctionRoutes:
    """Return the routes with the muscle lengths `function(q)` (m,) [m], a CasADi expression of a vector q (n,) [rad].

    `rest_length` is a number or a row (m,) [m]. Raises `InvalidInput`.
    """
    import casadi as ca

    n = checks.count("from_function: n", n, 1)
    q, length = _expression(function, n)
    dependent = np.array(ca.DM(ca.jacobian_sparsity(length, q), 1)) if length.shape[0] else np.zeros((0, n))
    if not dependent.any(axis=1).all():
        idle = int(np.argmin(dependent.any(axis=1)))
        raise InvalidInput(f"from_function: muscle {idle + 1} has no arm at any joint; it moves nothing")
    return FunctionRoutes(rest_lengths("from_function", rest_length, length.shape[0]), n, function)


def _expression(function: Callable[[Any], Any], n: int) -> tuple[Any, Any]:
    """Return the symbol q and l(q) as a column. Raises `InvalidInput` for what is none."""
    import casadi as ca

    q = ca.SX.sym("q", n)
    value = function(q)
    try:
        length = ca.vertcat(*value) if isinstance(value, list | tuple) else ca.SX(value)
    except (TypeError, NotImplementedError):
        raise InvalidInput(f"from_function: the function gives {checks.brief(value)}, no CasADi expression") from None
    if length.shape[1] != 1 or not length.shape[0]:
        raise InvalidInput(
            f"from_function: the function gives the shape {length.shape}; expected a column of m lengths"
        )
    return q, length


__all__ = ["FunctionRoutes", "from_function"]
