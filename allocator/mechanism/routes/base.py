"""Base class of all routes: the length of every muscle over the posture.

The posture q ∈ Rⁿ holds the joints' angles [rad] (or strokes [m]); muscle j has the length l_j(q), and

    arm   r_j = -∇l_j  ∈ Rⁿ      [m]     signed: positive where more force raises the joint's angle
    bend  H_j = ∇²l_j  ∈ Rⁿˣⁿ    [m]     symmetric; 0 on pulleys

Every route gives both in closed form or by algorithmic differentiation, never by differences.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import SX

_SHORTEST, LONGEST = 1e-3, 10.0  # [m] lengths of a muscle; others have a wrong unit
_NOTHING = 1e-9  # [m] a smaller arm counts as none


class RoutedLengths(NamedTuple):
    """Lengths of m muscles at postures (…, n), with their derivatives."""

    length: Array  # l (…, m) [m]
    arm: Array  # r (…, m, n) [m]
    bend: Array  # H (…, m, n, n) [m]


@dataclass(frozen=True)
class Routes(ABC):
    """Routes of m muscles over n joints; immutable."""

    rest_length: tuple[float, ...]  # L_j (m,) [m]

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of joints."""

    @property
    def m(self) -> int:
        """Number of muscles."""
        return len(self.rest_length)

    @abstractmethod
    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends of all muscles at the postures `q` (…, n)."""

    @property
    def reach(self) -> tuple[tuple[float, float], ...] | None:
        """Ranges of the n joints in which the lengths are known [rad]; None: everywhere."""
        return None

    def symbolic(self, q: "SX") -> Sequence["SX | float"]:
        """Return the lengths l (m) [m] as formulas of the CasADi column `q` (n, 1).

        Raises `InvalidInput` for routes without formulas, such as tables.
        """
        raise InvalidInput(f"{type(self).__name__}: an arm's model needs lengths that are formulas, not a table's")

    def contraction(self, length: Array) -> Array:
        """Return ε = (L - l)/L (…, m) of muscles with the lengths `length` (…, m) [m]."""
        L = np.array(self.rest_length)
        return np.asarray((L - length) / L)


def rest_lengths(kind: str, value: object, m: int) -> tuple[float, ...]:
    """Return m rest lengths [m] from one number or m of them. Raises `InvalidInput`."""
    lengths = per_muscle(f"{kind}: rest_length", value, m, "m")
    if not ((lengths >= _SHORTEST) & (lengths <= LONGEST)).all():
        wrong = (lengths < _SHORTEST) | (lengths > LONGEST)
        raise InvalidInput(f"{kind}: rest_length{checks.at(lengths, wrong)} has to be a muscle's length in metres")
    return tuple(lengths.tolist())


def per_muscle(name: str, value: object, m: int, unit: str) -> Array:
    """Return one number per muscle (m,) from one number or m of them. Raises `InvalidInput`."""
    array = checks.real(name, value, unit)
    if array.shape not in ((), (m,)):
        raise InvalidInput(
            f"{name} has the shape {array.shape}; one number or one for each of m = {m} muscles [{unit}]"
        )
    return np.broadcast_to(array, (m,)).astype(float)


def check_lengths(kind: str, lengths: Array) -> None:
    """Raise `InvalidInput` for `lengths` [m] that are no muscles'."""
    if (wrong := np.abs(lengths) > LONGEST).any():
        length = f"length{checks.at(lengths, wrong)} m, without cable,"
        raise InvalidInput(f"{kind}: {length} is no muscle's; if millimetres, divide by 1000")


class IdleMuscle(InvalidInput):
    """Muscle without an arm at any joint; `muscle` is its index."""

    def __init__(self, kind: str, muscle: int) -> None:
        super().__init__(f"{kind}: muscle {muscle + 1} has no arm at any joint; it moves nothing")
        self.muscle = muscle


def check_arms(kind: str, arms: Array) -> None:
    """Raise `IdleMuscle` unless every muscle has an arm at some joint; `arms` (m, n) [m] are the greatest."""
    idle = ~(np.abs(arms) > _NOTHING).any(axis=1)
    if idle.any():
        raise IdleMuscle(kind, int(np.argmax(idle)))
