"""A picture's axes are named here: "T1" is a torque, "K12" an entry of the stiffness, "Kx12" of the endpoint's."""

import re
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.endpoint.endpoint import Endpoint, inverses, load_of
from allocator.mechanism.endpoint.points import Place

_NAME = re.compile(r"(Kx|K|T)(\d+)(?:,(\d+))?")
_UNITS = {"T": "N·m", "K": "N·m/rad", "Kx": "N/m"}
_KINDS = {"K": "stiffness", "Kx": "endpoint stiffness"}


class Coordinate(NamedTuple):
    """A `Coordinate` is an affine function d·y + c of torques and stiffness, y in the order of a `TargetsMap`."""

    kind: str  # "torque", "stiffness", "endpoint stiffness"
    name: str  # "T1", "K12", "Kx11", "0.5 Kx11 - 0.5 Kx22"
    unit: str
    direction: Array  # d (n + n(n+1)/2,)
    constant: float  # c

    @property
    def label(self) -> str:
        """Return what stands on an axis."""
        return f"{self.kind} {self.name} [{self.unit}]"


class Hand(NamedTuple):
    """A `Hand` is an endpoint at a posture, under its force."""

    endpoint: Endpoint
    place: Place  # of one posture
    force: Array  # (dim,) [N]


def coordinate(wanted: object, n: int, hand: Hand | None) -> Coordinate:
    """Return the coordinate of this name, or of a mapping of names to weights. Raises `InvalidInput`."""
    if not isinstance(wanted, Mapping):
        return _named(wanted, n, hand)
    if not wanted:
        raise InvalidInput("a target is a name, such as 'K11', or a mapping of names to weights")
    parts = [(_named(name, n, hand), float(weight)) for name, weight in wanted.items()]
    if len({part.unit for part, _ in parts}) > 1:
        raise InvalidInput(f"{', '.join(wanted)} have different units; a sum of them means nothing")
    name = " ".join(f"{'-' if weight < 0 else '+'} {abs(weight):.3g} {part.name}" for part, weight in parts)
    return Coordinate(
        parts[0][0].kind,
        name.removeprefix("+ "),
        parts[0][0].unit,
        np.sum([weight * part.direction for part, weight in parts], axis=0),
        sum(weight * part.constant for part, weight in parts),
    )


def _named(name: Any, n: int, hand: Hand | None) -> Coordinate:
    match = _NAME.fullmatch(name) if isinstance(name, str) else None
    if match is None:
        raise _unknown(name, n, hand)
    kind, first, second = match.groups()
    size = n if kind != "Kx" else (hand.endpoint.dim if hand else 0)
    places = [int(i) - 1 for i in ((first, second) if second else first)]
    if len(places) != (1 if kind == "T" else 2) or not all(0 <= i < size for i in places):
        raise _unknown(name, n, hand)
    entry = np.zeros((size, size))
    if kind == "T":
        return Coordinate("torque", name, _UNITS[kind], np.eye(n + n * (n + 1) // 2)[places[0]], 0.0)
    entry[places[0], places[1]] += 0.5
    entry[places[1], places[0]] += 0.5
    constant = 0.0
    if kind == "Kx" and hand is not None:
        plus, _ = inverses(hand.place)
        entry = plus @ entry @ plus.T
        constant = float(np.sum(entry * load_of(hand.place, hand.force)))
    triangle = (entry * (2 - np.eye(n)))[np.triu_indices(n)]
    return Coordinate(_KINDS[kind], name, _UNITS[kind], np.concatenate([np.zeros(n), triangle]), constant)


def _unknown(name: object, n: int, hand: Hand | None) -> InvalidInput:
    known = f"T1 … T{n}, K11 … K{n}{n}"
    known += "" if hand is None else f", Kx11 … Kx{hand.endpoint.dim}{hand.endpoint.dim}"
    hint = " (Kx needs an endpoint)" if hand is None else ""
    return InvalidInput(f"there is no target {name!r}; a mechanism with n = {n} joints has {known}{hint}")
