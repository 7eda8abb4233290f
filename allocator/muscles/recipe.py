"""Recipe by which the least squares fit a model."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from allocator.calculus import Array

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

    def free(self, parameters: Iterable[str], hold: Collection[str] = ()) -> tuple[str, ...]:
        """Return the parameters to be fitted: those that are neither held nor conventional."""
        return tuple(name for name in parameters if name not in hold and not among(name, self.conventional))

    def limits(self, names: Iterable[str]) -> tuple[Array, Array]:
        """Return the least and the greatest values (m,) of these parameters in the search."""
        bounds = [self.bounds.get(name, (-np.inf, np.inf)) for name in names]
        return np.array([low for low, _ in bounds]), np.array([high for _, high in bounds])


def among(name: str, group: Collection[str]) -> bool:
    """Return whether the group has this parameter, or the row that it belongs to."""
    return name in group or name.partition("[")[0] in group
