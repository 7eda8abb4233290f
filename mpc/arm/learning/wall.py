"""Wall that a hand touches: a spring and a damper behind a plane, which push and never pull.

With the penetration e = ν·x - e0 of the hand at x, the force of the hand on the wall is

    N = max(k e + c e', 0)  if e > 0,  else 0

along the normal ν, without friction: the law of Kelvin and Voigt, cut off where it would pull. With c > 0 the force
begins with a step.
"""

from dataclasses import dataclass

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput

_UNIT = 1e-9  # greatest error of the square of a unit vector


@dataclass(frozen=True)
class Wall:
    """Half space behind a plane, without friction; immutable. SI units."""

    normal: tuple[float, ...] = (1.0, 0.0)  # ν, a unit vector into the wall, of the hand's coordinates
    offset: float = 0.59  # e0 = ν·x of the surface [m]
    stiffness: float = 3000.0  # k [N/m]
    damping: float = 30.0  # c [N·s/m]

    def __post_init__(self) -> None:
        """Check the fields and convert them to floats. Raises `InvalidInput`."""
        normal = checks.real("Wall: normal", self.normal, "-")
        if normal.ndim != 1 or abs(float(normal @ normal) - 1) > _UNIT:
            raise InvalidInput(
                f"Wall: normal = {checks.brief(self.normal)} has to be a unit vector, such as (1.0, 0.0)"
            )
        object.__setattr__(self, "normal", tuple(normal.tolist()))
        object.__setattr__(self, "offset", checks.number("Wall: offset", self.offset, "m"))
        object.__setattr__(self, "stiffness", checks.positive("Wall: stiffness", self.stiffness, "N/m"))
        object.__setattr__(self, "damping", checks.not_negative("Wall: damping", self.damping, "N·s/m"))

    @property
    def numbers(self) -> Array:
        """Row (3,) of offset [m], stiffness [N/m] and damping [N·s/m], which vary between arms."""
        return np.array([self.offset, self.stiffness, self.damping])


def pushed_back(depth: Value, speed: Value, stiffness: Value, damping: Value) -> Value:
    """Return the force of a spring and a damper that only push, at the `depth` beyond their end and its rate `speed`.

    Units are those of a translation or a rotation; numbers, arrays or CasADi symbols.
    """
    force = stiffness * depth + damping * speed
    return force * (force > 0) * (depth > 0)
