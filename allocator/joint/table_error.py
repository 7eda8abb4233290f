"""Error of tabulated geometry, estimated from the same table with every second sample left out.

Halving the samples of a smooth function raises the error of its cubic spline by 2⁴ (length), 2³ (arm) and 2² (bend), so
the difference between both splines bounds the error of the full one. The even and the odd samples are left out in turn,
since one of the two may miss a kink. Where the bend jumps, since a cable lifts off or
hits a stop, both splines ring and the difference does not shrink however many samples there are: the torque's stiffness
F H would be wrong by the force times that difference. Such tables are refused.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput

_MOST_ARM = 0.1  # of the greatest arm: a table that is further off is refused
_MOST_BEND = 0.2  # of the greatest arm, per radian
_FEWEST = 9  # samples of a joint from which half of them tell enough


class TableError(NamedTuple):
    """Greatest differences (m,) of m muscles to a table of every second sample."""

    length: Array  # [m]
    arm: Array  # [m]
    bend: Array  # [m/rad]
    posture: Array  # (m, n) where the difference of the bends is greatest [rad]

    def __str__(self) -> str:
        """Return the three errors, for a sentence."""
        return (
            f"length {1e3 * self.length.max():.2g} mm, arm {1e3 * self.arm.max():.2g} mm, "
            f"bend {1e3 * self.bend.max():.2g} mm/rad, against every second sample"
        )


def halves(n: int) -> tuple[list[int], list[int]]:
    """Return every second index of n samples, the even and the odd ones, each with both ends."""
    return sorted({*range(0, n, 2), n - 1}), sorted({0, *range(1, n, 2), n - 1})


def greatest(differences: Array, postures: Array) -> TableError:
    """Return the greatest of the differences (3, halves, points, m) of length, arm and bend at postures (points, n)."""
    length, arm, bend = np.abs(differences).max(axis=1)  # each (points, m)
    return TableError(length.max(axis=0), arm.max(axis=0), bend.max(axis=0), postures[bend.argmax(axis=0)])


def check(kind: str, error: TableError, arms: Array, samples: int) -> None:
    """Refuse a table whose greatest `arms` (m,) [m] make its error too great; `samples` is the least of any joint.

    Raises `InvalidInput`. A table of fewer than nine samples has no half that tells, and passes.
    """
    wrong = (error.arm > _MOST_ARM * arms) | (error.bend > _MOST_BEND * arms)
    if samples < _FEWEST or not wrong.any():
        return
    j = int(np.argmax(np.where(wrong, error.bend / arms, -np.inf)))
    where = ", ".join(f"{angle:.3g}" for angle in error.posture[j])
    raise InvalidInput(
        f"{kind}: muscle {j + 1} has arms of up to {1e3 * arms[j]:.3g} mm, but every second sample gives another arm "
        f"by {1e3 * error.arm[j]:.2g} mm and another bend by {1e3 * error.bend[j]:.2g} mm/rad near {where} rad, so the "
        "stiffness cannot be told: the cable lifts off there or the samples are noisy or too few; smooth or split the "
        "table, sample it more finely, or describe the route by a formula"
    )
