"""Muscles round pulleys, with constant arms, and the two muscles of an `AntagonistJoint`'s geometry."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.geometry import Geometry, Pulley
from allocator.lazy import SX
from allocator.mechanism.routes.base import RoutedLengths, Routes, check_arms, per_muscle, rest_lengths

_LONGEST_ARM = 1.0  # [m]; more is in millimetres


@dataclass(frozen=True)
class Pulleys(Routes):
    """Routes round pulleys at the joints: l_j(q) = L_j (1 - ε0_j) - r_j·q, with bend 0."""

    arms: tuple[tuple[float, ...], ...]  # r (m, n) [m], signed
    initial_contraction: tuple[float, ...]  # ε0 (m,) [-], at q = 0

    def __init__(self, rest_length: object, arms: object, initial_contraction: object) -> None:
        """Check and keep `arms` (m, n) [m]; `rest_length` [m] and `initial_contraction` are numbers or rows (m,)."""
        r = checks.real("Pulleys: arms", arms, "m")
        if r.ndim != 2 or 0 in r.shape:
            raise InvalidInput(f"Pulleys: arms have the shape {r.shape}; expected (m, n), a row of n arms a muscle [m]")
        if (wrong := np.abs(r) > _LONGEST_ARM).any():
            raise InvalidInput(f"Pulleys: arms{checks.at(r, wrong)} m is no pulley; if millimetres, divide by 1000")
        check_arms("Pulleys", r)
        eps0 = per_muscle("Pulleys: initial_contraction", initial_contraction, len(r), "ratio")
        object.__setattr__(self, "rest_length", rest_lengths("Pulleys", rest_length, len(r)))
        object.__setattr__(self, "arms", tuple(map(tuple, r.tolist())))
        contraction = checks.contraction("Pulleys: initial_contraction", eps0)
        object.__setattr__(self, "initial_contraction", tuple(contraction.tolist()))

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.arms[0])

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, the constant arms and bends 0 at the postures `q` (…, n)."""
        r, L = np.array(self.arms), np.array(self.rest_length)
        length = L * (1 - np.array(self.initial_contraction)) - q @ r.T
        return RoutedLengths(
            length,
            np.broadcast_to(r, (*q.shape[:-1], self.m, self.n)),
            np.broadcast_to(0.0, (*q.shape[:-1], self.m, self.n, self.n)),
        )

    def symbolic(self, q: "SX") -> Sequence["SX | float"]:
        """Return L (1 - ε0) - r·q of a CasADi column `q` (n, 1)."""
        rows = zip(self.rest_length, self.initial_contraction, self.arms, strict=True)
        return [L * (1 - eps) - sum(r * q[i] for i, r in enumerate(arms) if r) for L, eps, arms in rows]


@dataclass(frozen=True)
class JointRoutes(Routes):
    """Routes of one joint's `Geometry`: n = 1, m = 2, r = (a1, -a2) and H = (-a1', a2')."""

    geometry: Geometry

    def __init__(self, geometry: Geometry) -> None:
        """Take the geometry of a joint."""
        object.__setattr__(self, "rest_length", (geometry.rest_length,) * 2)
        object.__setattr__(self, "geometry", geometry)

    @property
    def n(self) -> int:
        """1, the number of joints."""
        return 1

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends of agonist and antagonist at the angles `q` (…, 1)."""
        routed = self.geometry.agonist(q[..., 0]), self.geometry.antagonist(q[..., 0])
        eps, arm, slope = (
            np.stack([np.broadcast_to(one, q.shape[:-1]), np.broadcast_to(two, q.shape[:-1])], axis=-1)
            for one, two in zip(*routed, strict=True)
        )
        sign = np.array([1.0, -1.0])
        return RoutedLengths(
            self.geometry.rest_length * (1 - eps), (sign * arm)[..., None], (-sign * slope)[..., None, None]
        )

    def symbolic(self, q: "SX") -> Sequence["SX | float"]:
        """Return L (1 - ε(θ)) of both muscles of a CasADi column `q` (1, 1)."""
        contractions = self.geometry.agonist(q[0])[0], self.geometry.antagonist(q[0])[0]
        return [L * (1 - eps) for L, eps in zip(self.rest_length, contractions, strict=True)]


def routes_of(geometry: Geometry) -> Routes:
    """Return the routes of a joint's two muscles; a pulley becomes `Pulleys`, which MJCF can express."""
    if isinstance(geometry, Pulley):
        return Pulleys(geometry.rest_length, ((geometry.radius,), (-geometry.radius,)), geometry.initial_contraction)
    return JointRoutes(geometry)
