"""Affine muscles of one's own, made from two functions or from two tables."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Self

import numpy as np

from allocator.calculus import Array, Spline, Value
from allocator.errors import InvalidInput
from allocator.muscles.base import NOT_A_NUMBER, STRUCTURE, AffineMuscle
from allocator.muscles.measured import MeasuredRegion, TabledRegion
from allocator.muscles.recipe import Recipe


@dataclass(frozen=True)
class FunctionMuscle(AffineMuscle):
    """The force is F = P A(ε) + B(ε) with `area` for A [N/Pa] and `passive` for B [N].

    The functions may use `+ - * / **` and those of `allocator.calculus`, so that they serve arrays, complex numbers
    (derivatives) and CasADi symbols. Such a muscle has no parameters: it cannot be fitted or written to a file; sample
    its functions into a `TableMuscle` for that.
    """

    citation = "two functions of the user"

    area: Callable[[Value], Value] = field(metadata=NOT_A_NUMBER)  # A(ε) [N/Pa]
    passive: Callable[[Value], Value] | None = field(default=None, metadata=NOT_A_NUMBER)  # B(ε) [N]; None: none

    def A(self, eps: Value) -> Value:
        """Return A(ε) = area(ε)"""
        return self.area(eps)

    def B(self, eps: Value) -> Value:
        """Return B(ε) = passive(ε)"""
        return 0.0 * eps if self.passive is None else self.passive(eps)


@dataclass(frozen=True)
class TableMuscle(AffineMuscle):
    """The force is F = P A(ε) + B(ε) with cubic splines A, B through `area` [N/Pa] and `passive` [N] at the knots
    `contraction`.

    Not-a-knot splines (SciPy), continued by their end pieces. The parameters are area and passive; the knots are not
    fitted, five of them over the taut samples unless `start` says otherwise. It can follow any measured muscle that is
    affine in pressure, and its noise as well: look at the cross-validated error and at [M]. Domain: from the first knot
    to the last; answers beyond them are reported as extrapolated.
    """

    citation = "splines through a table of the user"
    strength: ClassVar[Mapping[str, float]] = {"area": 1.0, "passive": 1.0}

    contraction: tuple[float, ...] = field(metadata=STRUCTURE)  # knots ε_i, increasing, 3 or more [-]
    area: tuple[float, ...]  # A(ε_i) [N/Pa]
    passive: tuple[float, ...]  # B(ε_i) [N]

    def __post_init__(self) -> None:
        """Check the rows against each other."""
        super().__post_init__()
        if not len(self.contraction) == len(self.area) == len(self.passive):
            raise InvalidInput(
                "TableMuscle needs as many values in area and passive as in contraction; got "
                f"{len(self.area)}, {len(self.passive)} and {len(self.contraction)}"
            )
        _ = self._area_spline, self._passive_spline  # built now, so that a bad table is refused now

    @property
    def max_contraction(self) -> float:
        """Last knot [-]."""
        return self.contraction[-1]

    @property
    def min_contraction(self) -> float:
        """First knot [-]."""
        return self.contraction[0]

    @property
    def region(self) -> MeasuredRegion | TabledRegion:
        """Samples of its fit, or the contractions of the knots."""
        return self.measured or TabledRegion(self.min_contraction, self.max_contraction)

    @cached_property
    def _area_spline(self) -> Spline:
        return Spline(self.contraction, self.area, "TableMuscle area")

    @cached_property
    def _passive_spline(self) -> Spline:
        return Spline(self.contraction, self.passive, "TableMuscle passive")

    def A(self, eps: Value) -> Value:
        """Return the spline through `area`."""
        return self._area_spline(eps)

    def B(self, eps: Value) -> Value:
        """Return the spline through `passive`."""
        return self._passive_spline(eps)

    def A_integral(self, eps: Value) -> Value:
        """Return the integral of the spline."""
        return self._area_spline.integral(eps) - self._area_spline.integral(0.0)

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return a recipe of five knots over the taut data, denser at small contractions, where the force bends."""
        taut = contraction[force > 0]
        if not taut.size or not np.ptp(taut) > 0:
            return Recipe()
        least, most = float(taut.min()), float(taut.max())
        knots = least + (most - least) * np.linspace(0, 1, _KNOTS) ** 1.5
        start = cls(tuple(knots), (0.0,) * _KNOTS, (0.0,) * _KNOTS)
        return Recipe((start,), ("area", "passive"))


_KNOTS = 5
