"""Which parameters scale the force of each law, and with which power, is listed here: a muscle, stronger or weaker.

A law scales by s, F → s F, when each of these parameters x becomes x s^n, n the number beside its name. A joint without
a force sensor needs this: its data say nothing about s, and two muscles of one kind differ by it.
"""

from collections.abc import Mapping
from typing import TypeVar

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle

M = TypeVar("M", bound=Muscle)

_BRAID = {"r0": 0.5}  # S = π r0² stands before everything

_POWERS: Mapping[str, Mapping[str, float]] = {
    "Hogan1984": {"F_max": 1.0},
    "TonduLopez1995": _BRAID,
    "ChouHannaford1996": {"n": -0.5, "t": 0.5},  # D0 = b/(nπ) and t are the lengths across
    "TonduLopez2000": _BRAID,
    "Hildebrandt2005": dict.fromkeys(("c0", "c1", "c2", "d0", "d1", "d2", "d3", "d4"), 1.0),
    "Wickramatunge2010": dict.fromkeys(("c0", "c1", "c2", "c3_low", "c3_high"), 1.0),
    "Sarosi2012": dict.fromkeys(("c1", "c2", "c3", "c4", "c5"), 1.0),
    "Andrikopoulos2016": _BRAID,
    "MartensBoblan2017": dict.fromkeys(("D0", "c0", "c1", "c2", "c3"), 0.5),  # A goes with D0², B with D0 E
    "PolynomialMcKibben": _BRAID,
    "Tondu2021": _BRAID,
    "KazemipourKatzschmann2025": dict.fromkeys(("c0", "c1", "c2"), 1.0),
    "AffinePolynomial": {"area": 1.0, "passive": 1.0},
    "TableMuscle": {"area": 1.0, "passive": 1.0},
}


def strength_powers(muscle: Muscle) -> Array:
    """Return the power n of every parameter (m,), in the order of `Muscle.parameters`.

    It is 0 for those that do not scale.
    """
    name = type(muscle).__name__
    if name not in _POWERS:
        raise InvalidInput(f"how the force of a {name} scales is not known; models that can: {', '.join(_POWERS)}")
    powers = _POWERS[name]
    return np.array([powers.get(p.partition("[")[0], 0.0) for p in muscle.parameters])


def scaled(muscle: M, factor: float) -> M:
    """Return the muscle that pulls `factor` times as hard everywhere, without covariance."""
    if factor == 1.0:
        return muscle
    if not factor > 0:
        raise InvalidInput(f"factor = {factor!r}: a muscle can only be scaled by a positive number")
    powers = strength_powers(muscle)
    values = {
        name: value * float(factor**power)
        for (name, value), power in zip(muscle.parameters.items(), powers, strict=True)
    }
    return muscle.with_parameters(values)


__all__ = ["scaled", "strength_powers"]
