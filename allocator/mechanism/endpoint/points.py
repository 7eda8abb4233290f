"""Position of a hand over the posture: a point on a linkage in closed form, or a CasADi function."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple, Protocol, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.mechanism.routes.functions import SymbolicColumn
from allocator.mechanism.routes.linkage import Linkage, Site

_AXES = "xyz"


class Place(NamedTuple):
    """Position of an endpoint at postures (…), with its derivatives; dim coordinates, n joints."""

    position: Array  # x (…, dim) [m]
    jacobian: Array  # J = ∂x/∂q (…, dim, n) [m/rad]
    hessian: Array  # ∂²x/∂q² (…, dim, n, n) [m/rad²]


class Kinematics(Protocol):
    """Interface of an `Endpoint`'s kinematics: x(q) and its derivatives."""

    @property
    def n(self) -> int:
        """Number of joints."""
        ...

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        ...

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n)."""
        ...


@dataclass(frozen=True)
class LinkagePoint:
    """Point on one of the links, with the coordinates `axes`."""

    linkage: Linkage
    site: Site
    axes: str  # of the ground's frame, such as "xy"

    def __post_init__(self) -> None:
        """Check the axes. Raises `InvalidInput`."""
        axes = self.axes
        if not isinstance(axes, str) or not axes or len(set(axes)) != len(axes) or set(axes) - set(_AXES):
            raise InvalidInput(f"Endpoint: axes = {axes!r} have to be different letters of {_AXES!r}, such as 'xy'")

    @classmethod
    def on(cls, linkage: Linkage, link: int, position: object, axes: str) -> Self:
        """Return the point at `position` [m] on a link. Raises `InvalidInput`."""
        return cls(linkage, linkage.site("Endpoint: the point is on", link, position), axes)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.linkage.n

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return len(self.axes)

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n)."""
        moved, axes = self.linkage.point(self.site, self.linkage.frames(q)), [_AXES.index(axis) for axis in self.axes]
        return Place(
            moved.position[..., axes],
            moved.slope[..., axes].swapaxes(-1, -2),
            np.moveaxis(moved.curve[..., axes], -1, -3),
        )


@dataclass(frozen=True)
class FunctionPoint:
    """Coordinates x(q) by a user's function of a CasADi vector q (n,)."""

    joints: int
    function: Callable[[Value], Value]

    def __post_init__(self) -> None:
        """Raise `InvalidInput` unless the function returns an expression."""
        object.__setattr__(self, "joints", checks.count("Endpoint.from_function: n", self.joints, 1))
        _ = self._column.expression

    @cached_property
    def _column(self) -> SymbolicColumn:
        return SymbolicColumn("Endpoint.from_function", self.joints, self.function)

    def column(self, q: Value) -> Value:
        """Return x (dim, 1) as a formula of the CasADi column `q` (n, 1)."""
        import casadi as ca

        symbol, value = self._column.expression
        return ca.substitute(value, symbol, q)

    @property
    def n(self) -> int:
        """Number of joints."""
        return self.joints

    @property
    def dim(self) -> int:
        """Number of coordinates."""
        return self._column.size

    def at(self, q: Array) -> Place:
        """Return the place at the postures `q` (…, n). Raises `InvalidInput` if a derivative is not finite."""
        return Place(*self._column.at(q))
