"""Geometry of a joint: contraction, moment arm and its derivative of two muscles, over the joint angle.

A geometry is described per muscle by its contraction ε(θ). The moment arm follows from it, since a muscle of rest
length l0 that shortens by l0 dε does the work F l0 dε = F a dθ:

    a1 = l0 dε1/dθ,    a2 = -l0 dε2/dθ        (both positive)

The error of a table is estimated from the same table with every second sample left out. Halving the samples of a smooth
function raises the error of its cubic spline by 2⁴ (length), 2³ (arm) and 2² (bend), so the difference between both
splines bounds the error of the full one. The even and the odd samples are left out in turn, since one of the two may
miss a kink. If the bend jumps because a cable lifts off or hits a stop, both splines ring and the difference does not
shrink with more samples: the torque's stiffness F H would be wrong by the force times that difference. Such tables are
refused.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import STEP, Array, Spline, Value, cos, derivative, increasing_root, sin, sqrt
from allocator.errors import InvalidInput
from allocator.units import DEG

_SHORTEST = 1e-6  # [m]
_CHECKED = 33  # angles between the ends of the joint
_QUOTIENT = np.array([1.0, -8.0, 0.0, 8.0, -1.0]) / 12  # as `five_point`
_UNLIKE = 1e-3  # of the greatest arm: a greater difference is no error of a difference quotient
_LONGEST = 10.0  # [m] of a joint's dimensions; more is in millimetres


class Routing(NamedTuple):
    """Contraction and moment arm of one muscle at a joint angle."""

    contraction: Value  # ε [-]
    arm: Value  # a [m], positive
    arm_slope: Value  # da/dθ [m/rad]


@dataclass(frozen=True)
class Geometry(ABC):
    """Mechanism between two muscles of the same rest length and one joint. Immutable.

    A joint refuses one with arms that contradict its contraction, or are not positive within the joint range.
    """

    rest_length: float  # l0 [m], of both muscles

    def __post_init__(self) -> None:
        """Check the rest length."""
        positive(self, "rest_length")

    @abstractmethod
    def agonist(self, theta: Value) -> Routing:
        """Route muscle 1, which shortens as θ grows."""

    def antagonist(self, theta: Value) -> Routing:
        """Route muscle 2, which lengthens as θ grows: as the mirror image of muscle 1 unless overridden."""
        eps, arm, arm_slope = self.agonist(-theta)
        return Routing(eps, arm, -arm_slope)

    @property
    def reach(self) -> tuple[float, float]:
        """Angles [rad] between which the mechanism's formulas hold."""
        return (-2 * np.pi, 2 * np.pi)

    def angles_at(self, contraction: float) -> tuple[float, float]:
        """Return the angles of this contraction of agonist (left) and antagonist (right) [rad]; infinite for none."""
        ends = np.asarray(self.reach)
        left = increasing_root(lambda x: self.agonist(x).contraction - contraction, *ends)
        right = increasing_root(lambda x: contraction - self.antagonist(x).contraction, *ends)
        return float(left), float(right)


@dataclass(frozen=True)
class Pulley(Geometry):
    """Round pulley with two cables, as in the report: ε1 = ε0 + Rθ/l0, ε2 = ε0 - Rθ/l0   (3)"""

    radius: float  # R [m]
    initial_contraction: float  # ε0 [-], of both muscles at θ = 0

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        positive(self, "radius")
        fraction(self, "initial_contraction")

    def agonist(self, theta: Value) -> Routing:
        """Route muscle 1 round the pulley: ε = ε0 + Rθ/l0, a = R   (3)"""
        return Routing(
            self.initial_contraction + self.radius * theta / self.rest_length,
            self.radius + 0.0 * theta,
            0.0 * theta,
        )

    def angles_at(self, contraction: float) -> tuple[float, float]:
        """Return the angles θ = ∓(ε0 - ε) l0/R   (25)"""
        right = (self.initial_contraction - contraction) * self.rest_length / self.radius
        return -right, right


@dataclass(frozen=True)
class Lever(Geometry):
    """Lever of length r whose muscles end at anchors at the distance R from the axis.

    Muscle length √(R² + r² - 2 R r sin θ) + offset (agonist; -θ for the antagonist), arm R r cos θ/√(…).
    """

    anchor: float  # R, from the axis to the muscle's fixed end [m]
    lever: float  # r, from the axis to the muscle's moving end [m]
    offset: float = 0.0  # of the muscle beyond that distance; negative if cables or fittings take part of it [m]

    def __post_init__(self) -> None:
        """Check the numbers."""
        super().__post_init__()
        positive(self, "anchor", "lever")
        object.__setattr__(self, "offset", checks.number("Lever: offset", self.offset, "m"))
        if self.anchor <= self.lever:
            raise InvalidInput(f"Lever: the anchor distance {self.anchor:g} m has to exceed the lever {self.lever:g} m")

    def agonist(self, theta: Value) -> Routing:
        """Route muscle 1 to the lever: ε = 1 - l(θ)/l0 and its arm."""
        eps = 1 - (self._distance(theta) + self.offset) / self.rest_length
        return Routing(eps, self._arm(theta), derivative(self._arm, theta))

    def _distance(self, theta: Value) -> Value:
        R, r = self.anchor, self.lever
        return sqrt(R**2 + r**2 - 2 * R * r * sin(theta))

    def _arm(self, theta: Value) -> Value:
        return self.anchor * self.lever * cos(theta) / self._distance(theta)

    @property
    def reach(self) -> tuple[float, float]:
        """±89°, short of the dead points at ±90°, where the arms vanish."""
        return (-89 * DEG, 89 * DEG)


@dataclass(frozen=True)
class Table(Geometry):
    """Sampled mechanism: contraction of both muscles at n angles, interpolated by cubic splines.

    Its `error` estimates its accuracy. Raises InvalidInput if the samples are too inconsistent.
    """

    theta: Array = field(repr=False)  # [rad], increasing, (n,)
    contraction1: Array = field(repr=False)  # ε1 [-], (n,)
    contraction2: Array = field(repr=False)  # ε2 [-], (n,)
    _splines: tuple[Spline, Spline] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Fit the splines, and check that muscle 1 shortens and muscle 2 lengthens between all samples."""
        super().__post_init__()
        for name in ("theta", "contraction1", "contraction2"):
            check = checks.angle if name == "theta" else checks.contraction
            samples = np.array(check(f"Table: {name}", getattr(self, name)))
            samples.setflags(write=False)
            object.__setattr__(self, name, samples)
        splines = (
            Spline(self.theta, self.contraction1, "Table of contraction1"),
            Spline(self.theta, self.contraction2, "Table of contraction2"),
        )
        object.__setattr__(self, "_splines", splines)
        fine = np.linspace(self.theta[0], self.theta[-1], 20 * self.theta.size)
        for number, routing in enumerate((self.agonist(fine), self.antagonist(fine)), 1):
            if not (routing.arm > 0).all():
                raise InvalidInput(
                    f"Table: contraction{number} has the wrong slope at {fine[np.argmin(routing.arm)]:.3g} rad; "
                    "contraction1 has to rise and contraction2 to fall with theta"
                )
        arms = [routing.arm.max() for routing in (self.agonist(fine), self.antagonist(fine))]
        check_table("Table", self.error, np.array(arms), self.theta.size)

    @cached_property
    def error(self) -> "TableError":
        """Differences of agonist and antagonist to the splines through every second sample."""
        fine = np.linspace(self.theta[0], self.theta[-1], 8 * self.theta.size)
        found = np.zeros((3, 2, fine.size, 2))
        for i, kept in enumerate(halves(self.theta.size)):
            for j, samples in enumerate((self.contraction1, self.contraction2)):
                fewer = Spline(self.theta[kept], samples[kept]) if len(kept) > 2 else None
                for order in range(3):
                    other = fewer(fine, order) if fewer else 0.0
                    found[order, i, :, j] = self.rest_length * (self._splines[j](fine, order) - other)
        return greatest_differences(found, fine[:, None])

    def __eq__(self, other: object) -> bool:
        """Compare the samples."""
        if not isinstance(other, Table):
            return NotImplemented
        return self.rest_length == other.rest_length and all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("theta", "contraction1", "contraction2")
        )

    def __hash__(self) -> int:
        """Hash the samples."""
        return hash((self.rest_length, self.theta.tobytes(), self.contraction1.tobytes(), self.contraction2.tobytes()))

    def agonist(self, theta: Value) -> Routing:
        """Route muscle 1 by its spline."""
        return self._routing(theta, self._splines[0], +1)

    def antagonist(self, theta: Value) -> Routing:
        """Route muscle 2 by its spline."""
        return self._routing(theta, self._splines[1], -1)

    def _routing(self, theta: Value, spline: Spline, sign: int) -> Routing:
        scale = sign * self.rest_length
        return Routing(spline(theta), spline(theta, 1) * scale, spline(theta, 2) * scale)

    @property
    def reach(self) -> tuple[float, float]:
        """Sampled angles."""
        return (float(self.theta[0]), float(self.theta[-1]))


def check_routes(geometry: Geometry, left: float, right: float) -> None:
    """Check arms and slopes of a geometry between two angles [rad]: positive arms, and derivatives of the contraction.

    Raises `InvalidInput`. Derivatives are compared at most of the angles, since they may jump at a few.
    """
    h = STEP * (right - left)
    theta = np.linspace(left, right, _CHECKED + 2)[1:-1] + h * np.arange(-2, 3)[:, None]
    for name, route, sign in (("agonist", geometry.agonist, 1), ("antagonist", geometry.antagonist, -1)):
        what = f"{type(geometry).__name__}: the {name}"
        length, arm, slope = (np.broadcast_to(value, theta.shape) for value in route(theta))
        if not (arm > 0).all():
            wrong = tuple(np.argwhere(~(arm > 0))[0])
            raise InvalidInput(
                f"{what} has the moment arm {arm[wrong]:.3g} m at {theta[wrong]:.3g} rad, which has to be positive: "
                "keep off the dead point by angle_limits or reach, or turn the sign of theta"
            )
        derivatives = (_QUOTIENT @ length * sign * geometry.rest_length / h, _QUOTIENT @ arm / h)
        for kind, told, true in zip(("arm", "arm_slope"), (arm[2], slope[2]), derivatives, strict=True):
            if 2 * np.count_nonzero(np.abs(told - true) > _UNLIKE * arm.max()) > _CHECKED:
                raise InvalidInput(
                    f"{what} has {kind} = {told[0]:.4g} at {theta[2, 0]:.3g} rad, where {true[0]:.4g} is right: "
                    "arm is rest_length |d contraction/d theta| [m], arm_slope its derivative d arm/d theta [m/rad]"
                )


def positive(geometry: Geometry, *names: str) -> None:
    """Convert the named fields to floats. Raises InvalidInput unless they are positive and finite."""
    for name in names:
        number = checks.number(f"{type(geometry).__name__}: {name}", getattr(geometry, name), "m")
        if not number > 0:
            raise InvalidInput(f"{type(geometry).__name__}: {name} = {number:g} has to be a positive length in metres")
        if number < _SHORTEST:
            raise InvalidInput(f"{type(geometry).__name__}: {name} = {number:g} m is shorter than any part of a joint")
        if number > _LONGEST:
            what = f"{name} = {number:g} m is longer than any joint"
            raise InvalidInput(f"{type(geometry).__name__}: {what}; if millimetres were meant, pass {number / 1e3:g}")
        object.__setattr__(geometry, name, number)


def fraction(geometry: Geometry, *names: str) -> None:
    """Convert the named fields to floats. Raises InvalidInput unless they are contraction ratios."""
    for name in names:
        number = checks.number(f"{type(geometry).__name__}: {name}", getattr(geometry, name), "ratio")
        if not -1 < number < 1:
            raise InvalidInput(
                f"{type(geometry).__name__}: {name} = {number:g} has to be a contraction ratio, e.g. 0.15; percent?"
            )
        object.__setattr__(geometry, name, number)


_MOST_ARM = 0.1  # of the greatest arm: a table with a greater error is refused
_MOST_BEND = 0.2  # of the greatest arm, per radian
FEWEST = 9  # samples of a joint, for which half of them suffice


class TableError(NamedTuple):
    """Greatest differences (m,) of m muscles to a table of every second sample."""

    length: Array  # [m]
    arm: Array  # [m]
    bend: Array  # [m/rad]
    posture: Array  # (m, n) of the greatest difference of bends [rad]

    def __str__(self) -> str:
        """Return the three errors, for a sentence."""
        return (
            f"length {1e3 * self.length.max():.2g} mm, arm {1e3 * self.arm.max():.2g} mm, "
            f"bend {1e3 * self.bend.max():.2g} mm/rad, against every second sample"
        )


def halves(n: int) -> tuple[list[int], list[int]]:
    """Return every second index of n samples, the even and the odd ones, each with both ends."""
    return sorted({*range(0, n, 2), n - 1}), sorted({0, *range(1, n, 2), n - 1})


def greatest_differences(differences: Array, postures: Array) -> TableError:
    """Return the greatest of the differences (3, halves, points, m) of length, arm and bend at postures (points, n)."""
    length, arm, bend = np.abs(differences).max(axis=1)  # each (points, m)
    return TableError(length.max(axis=0), arm.max(axis=0), bend.max(axis=0), postures[bend.argmax(axis=0)])


def check_table(kind: str, error: TableError, arms: Array, samples: int) -> None:
    """Refuse a table with too great an error for its greatest `arms` (m,) [m]; `samples` is the least of any joint.

    Raises `InvalidInput`. A table of fewer than nine samples has too small halves, and passes.
    """
    wrong = (error.arm > _MOST_ARM * arms) | (error.bend > _MOST_BEND * arms)
    if samples < FEWEST or not wrong.any():
        return
    j = int(np.argmax(np.where(wrong, error.bend / arms, -np.inf)))
    where = ", ".join(f"{angle:.3g}" for angle in error.posture[j])
    raise InvalidInput(
        f"{kind}: muscle {j + 1} has arms of up to {1e3 * arms[j]:.3g} mm, but every second sample gives another arm "
        f"by {1e3 * error.arm[j]:.2g} mm and another bend by {1e3 * error.bend[j]:.2g} mm/rad near {where} rad, so the "
        "stiffness is uncertain: the cable lifts off there or the samples are noisy or too few; smooth or split the "
        "table, sample it more finely, or describe the route by a formula"
    )
