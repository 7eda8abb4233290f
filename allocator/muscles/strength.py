"""Scaling of a muscle's force by the parameters that its class names in `strength`.

A law scales by s, F → s F, when each of these parameters x becomes x s^n, n the number beside its name. A joint without
a force sensor needs this: its data say nothing about s, and two muscles of one kind differ by it.
"""

from typing import TypeVar

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.muscles.base import Muscle

M = TypeVar("M", bound=Muscle)


def strength_powers(muscle: Muscle) -> Array:
    """Return the power n of every parameter (m,), in the order of `Muscle.parameters`.

    It is 0 for those that do not scale.
    """
    powers = muscle.strength
    if not powers:
        raise InvalidInput(
            f"how the force of a {type(muscle).__name__} scales is not known: its `strength` says nothing"
        )
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
