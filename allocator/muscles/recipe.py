"""A recipe is what a model tells the least squares about itself."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

M_co = TypeVar("M_co", covariant=True)


@dataclass(frozen=True)
class Recipe(Generic[M_co]):
    """A recipe says how a model is fitted. A parameter that is a row may be meant as a whole by its bare name."""

    starts: tuple[M_co, ...] = ()
    """Muscles to start from; the values of `linear` parameters do not matter."""

    linear: tuple[str, ...] = ()
    """Parameters in which the force is linear when the others are fixed: solved for, not searched."""

    conventional: tuple[str, ...] = ()
    """Parameters that only set a scale (P_max in u = P/P_max): held, since no measurement tells them."""

    bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Limits of the search, beyond which the law makes no sense."""
