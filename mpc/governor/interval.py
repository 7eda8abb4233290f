"""Intervals of uncertain quantities: strengths, damping, masses, lags."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput

Posed: TypeAlias = Callable[[Value], Value]  # a function of the posture q, for numbers or CasADi symbols


@dataclass(frozen=True)
class Interval:
    """Least and greatest value of a constant, uncertain quantity.

    Both are numbers, rows of numbers or, for masses, matrices or functions, in the unit of the quantity.
    """

    low: Value | Posed
    high: Value | Posed

    @classmethod
    def about(cls, value: ArrayLike, share: float) -> Self:
        """Return `value` (…) ± a `share` of it: `Interval.about(0.25, 0.1)` is 0.225 … 0.275.

        Raises `InvalidInput`.
        """
        share = checks.number("Interval: share", share, "-")
        if not 0 <= share < 1:
            raise InvalidInput(f"Interval: share = {share:g} has to lie between 0 and 1, such as 0.1")
        row = np.asarray(checks.real("Interval: value", value, "SI"))
        off = share * np.abs(row)
        return cls((row - off).tolist(), (row + off).tolist())


@dataclass(frozen=True)
class Scaled:
    """Function times a number."""

    function: Posed
    factor: float

    def __call__(self, q: Value) -> Value:
        """Return the function of `q` times the factor."""
        return self.factor * self.function(q)


def ends(value: Value | Posed | Interval) -> tuple[Value, Value]:
    """Return the ends of an interval; for any other value, the value twice."""
    return (value.low, value.high) if isinstance(value, Interval) else (value, value)


def rows(
    name: str, value: ArrayLike | Interval, unit: str, size: int, letter: str, above: float | None = None
) -> Array:
    """Return the bounds (2, size) of one or `size` numbers, or of an interval of them.

    They are not negative, or greater than `above`. Raises `InvalidInput`.
    """
    found = []
    for end in ends(value):
        array = checks.real(name, end if np.size(end) else 0.0, unit)
        low_enough = array >= 0 if above is None else array > above
        if array.shape not in ((), (size,)) or not low_enough.all():
            sign = "not negative" if above is None else f"greater than {above:g}"
            raise InvalidInput(f"{name} has to be one number or {letter} = {size}, {sign} [{unit}]")
        found.append(np.broadcast_to(array, (size,)))
    bounds = np.array(found)
    if (bounds[0] > bounds[1]).any():
        raise InvalidInput(f"{name}: the interval has to begin with its least value, as Interval(low, high) [{unit}]")
    return bounds
