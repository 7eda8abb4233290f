"""Base classes of muscle models.

A muscle is a static force law F(P, ε): contraction force [N] from gauge pressure P [Pa] and contraction ratio
ε = (l0 - l)/l0 [-]. It pulls only: where F < 0 the cable is slack and the law does not hold, so the taut region F ≥ 0
is its domain. A model worth using satisfies on it

    ∂F/∂P > 0  and  ∂²F/∂P∂ε < 0        (more pressure pulls more, and stiffens)        [M]

from which the uniqueness of the inverse follows (see `allocator.closed_form`).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cache, cached_property
from os import PathLike
from typing import ClassVar, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask, Value, derivative, increasing_root
from allocator.errors import InvalidInput
from allocator.muscles import volume
from allocator.muscles.basis import Basis
from allocator.muscles.measured import Edges, MeasuredRegion, TabledRegion, continued, continued_integral, held
from allocator.muscles.recipe import Recipe

Covariance: TypeAlias = tuple[tuple[float, ...], ...]
"""Rows of a symmetric matrix, in the order of `Muscle.parameters` [product of the parameters' units]."""

STRUCTURE = {"role": "structure"}
"""Metadata of dataclass fields that are numbers of the law, but no parameters: saved, never varied."""

NOT_A_NUMBER = {"role": "other"}
"""Metadata of dataclass fields that are no numbers of the law: neither checked nor saved with it."""


@dataclass(frozen=True)
class Muscle(ABC):
    """Static force law F(P, ε) of a muscle. Immutable; the fields are the model's parameters in SI units.

    A parameter is a number, or a row of numbers where the model leaves their count open; a field may be marked as
    `STRUCTURE` (the knots of a table) and is then no parameter. Every method takes floats,
    arrays (broadcast) or CasADi symbols, except `pressure`, which is numeric.
    """

    citation: ClassVar[str]
    """Where the formula was published."""

    strength: ClassVar[Mapping[str, float]] = {}
    """The powers of s by which parameters grow for a muscle that pulls s times as hard; empty where not known."""

    assumed_contraction: ClassVar[float] = 0.35
    """Greatest contraction [-] of a muscle of this model that was not measured."""

    covariance: Covariance | None = field(default=None, kw_only=True, repr=False, metadata=NOT_A_NUMBER)
    """Covariance of the parameters of a fitted muscle; None: no uncertainty is known."""

    has_threshold: ClassVar[bool] = False
    """Whether the law has a threshold pressure, below which the bladder does not press on the braid."""

    measured: MeasuredRegion | None = field(default=None, kw_only=True, repr=False, metadata=NOT_A_NUMBER)
    """Where the samples of its fit lie; None: not known. Beyond its contractions the law goes on linearly   (R1)"""

    inner_radius: float | None = field(default=None, kw_only=True, repr=False, metadata=NOT_A_NUMBER)
    """Radius of the tube at rest [m], for laws that have none of their own; see `volume`."""

    rest_volume: float | None = field(default=None, kw_only=True, repr=False, metadata=NOT_A_NUMBER)
    """Volume of the gas at ε = 0 [m³]; None: that of a cylinder of the muscle's radius and rest length."""

    tube_volume: float = field(default=0.0, kw_only=True, repr=False, metadata=NOT_A_NUMBER)
    """Volume of the gas between muscle and valve [m³]."""

    def __post_init__(self) -> None:
        """Turn every number into a plain float (NumPy scalars upset CasADi). Refuse values that are not finite."""
        for name, is_row in self.number_fields().items():
            value = getattr(self, name)
            try:
                numbers = tuple(checks.number(name, v, "SI unit") for v in (value if is_row else (value,)))
            except (TypeError, InvalidInput):
                expected = "a row of finite numbers" if is_row else "a finite number"
                raise InvalidInput(f"{type(self).__name__}: {name} = {checks.brief(value)} is not {expected}") from None
            object.__setattr__(self, name, numbers if is_row else numbers[0])
        if not isinstance(self.measured, MeasuredRegion | None):
            raise InvalidInput(f"measured = {checks.brief(self.measured)} has to be a MeasuredRegion, or None")
        self._check_covariance()
        self._check_volumes()

    def _check_volumes(self) -> None:
        kind = type(self).__name__
        if self.inner_radius is not None:
            radius = volume.checked_radius(f"{kind}: inner_radius", self.inner_radius)
            object.__setattr__(self, "inner_radius", radius)
        if self.rest_volume is not None:
            object.__setattr__(self, "rest_volume", volume.checked(f"{kind}: rest_volume", self.rest_volume))
        tube = volume.checked(f"{kind}: tube_volume", self.tube_volume, tube=True)
        object.__setattr__(self, "tube_volume", tube)

    def _check_covariance(self) -> None:
        if self.covariance is None:
            return
        name, n = f"{type(self).__name__}: covariance", len(self.parameters)
        object.__setattr__(self, "covariance", checks.covariance(name, self.covariance, n))

    # --- the law ----------------------------------------------------------------------------------------------------

    @property
    def max_pressure(self) -> float:
        """Gauge pressure [Pa] up to which the law satisfies [M] on its taut region."""
        return np.inf

    @property
    def min_contraction(self) -> float:
        """Contraction ratio [-] from which on the law can be evaluated; negative is stretched."""
        return -np.inf

    @property
    def max_contraction(self) -> float:
        """Greatest contraction ratio [-] of the samples, or `assumed_contraction` of a muscle without any."""
        return self.assumed_contraction if self.measured is None else self.measured.contractions[1]

    @property
    def region(self) -> MeasuredRegion | TabledRegion | None:
        """Contractions and pressures beyond which answers are reported as extrapolated; None: not known."""
        return self.measured

    def covers(self, P: Array, eps: Array) -> Mask:
        """Return whether the law is meant for these contractions (at these pressures, if that matters) while F ≥ 0."""
        return np.asarray((eps >= self.min_contraction) & (eps <= self.max_contraction))

    @cached_property
    def edges(self) -> Edges | None:
        """Contractions [-] beyond which the law goes on linearly; None if it is the formula everywhere   (R1)"""
        if self.measured is None:
            return None
        least, most = self.measured.contractions
        return (least if least > self.min_contraction else -np.inf), most

    @property
    def basis(self) -> Basis:
        """Functions of the pressure that F is a combination of at a fixed contraction, and the kinks between
        them.

        By default F is taken to be smooth in P on the whole range of pressures; a law with kinks has to declare them.
        """
        return Basis("smooth")

    @property
    def limitation(self) -> str:
        """Where the law breaks [M] by its form, in a sentence; empty if it need not."""
        return ""

    def force(self, P: ArrayLike, eps: ArrayLike) -> Value:
        """Return the contraction force F(P, ε) [N]; negative where the cable would be slack.

        `P` is the gauge pressure [Pa], `eps` the contraction ratio [-]; they broadcast. Raises InvalidInput for numbers
        that cannot be these: swapped, bar, percent, not finite. CasADi symbols and complex numbers pass unchecked.
        """
        return self.law(*checks.pressure_and_contraction(P, eps))

    @abstractmethod
    def law(self, P: Value, eps: Value) -> Value:
        """Return F(P, ε) [N] by the formula, of unchecked arguments: models define it, and loops call it.

        It has to give a number at all contractions that a joint reaches, and to rise with the pressure up to
        `max_pressure` where the muscle is taut.
        """

    @abstractmethod
    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P [N/Pa], at constant contraction."""

    def slope(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂ε [N], at constant pressure."""
        return derivative(lambda e: self.law(P, e), eps)

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂²F/∂P∂ε [N/Pa]."""
        return derivative(lambda e: self.gain(P, e), eps)

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return the pressure [Pa] that gives the force `F` at `eps`.

        It is ∓inf where F is below or above all that the law can give.
        """
        ceiling = min(self.max_pressure, SEARCH_CEILING)
        F, eps = np.asarray(F, float), np.asarray(eps, float)
        return increasing_root(lambda P, F, e: self.law(P, e) - F, np.zeros(()), np.asarray(ceiling), F, eps)

    # --- its gas ----------------------------------------------------------------------------------------------------

    @property
    def own_radius(self) -> Value | None:
        """Radius at rest [m] that the law's parameters tell; None where they tell none."""
        return None

    @property
    def volume_known(self) -> bool:
        """Whether the volume of the gas is known: at rest, or by a radius."""
        return not (self.rest_volume is None and self.inner_radius is None and self.own_radius is None)

    def volume_at_rest(self, rest_length: Value) -> Value:
        """Return V_0 [m³], the volume at ε = 0 of a muscle of this length [m], with its tubing.

        It is `rest_volume`, or that of a cylinder π r² L. Raises InvalidInput where no radius is known either.
        """
        if self.rest_volume is not None:
            return self.rest_volume + self.tube_volume
        radius = self.own_radius if self.inner_radius is None else self.inner_radius
        if radius is None:
            tube = np.pi * 1e-4 * float(np.max(rest_length))  # m³
            raise InvalidInput(
                f"how much gas this {type(self).__name__} holds is not known, since its law has no radius: say "
                f"inner_radius [m], or rest_volume [m³] (a tube of 1 cm radius: {tube:.3g}; --rest-volume of the "
                f"commands is in cm³: {1e6 * tube:.3g})"
            )
        return np.pi * radius**2 * rest_length + self.tube_volume

    def volume(self, P: Value, eps: Value, rest_length: Value) -> Value:
        """Return the volume of the gas, tubing included, V(P, ε) = V_0 + L ∫_0^ε F_P dε' [m³]   (G1)

        `P` [Pa] and `eps` [-] are floats, arrays or CasADi symbols and pass unchecked, `rest_length` is L [m]. Where
        F_P jumps with the pressure (at the kinks of `basis`) the volume does. Raises InvalidInput as `volume_at_rest`.
        """
        return self.volume_at_rest(rest_length) + rest_length * self.gain_integral(P, eps)

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε F_P(P, ε') dε' [N/Pa]; by quadrature unless a law has a formula."""
        return volume.integral(lambda e: self.gain(P, e), eps)

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂/∂P of `gain_integral` [N/Pa²], analytic in P; by differences unless a law has a formula."""
        return volume.difference(lambda p: self.gain_integral(p, eps), P)

    def same_law(self, other: "Muscle") -> bool:
        """Return whether both pull alike, however much gas they hold."""

        def emptied(muscle: Muscle) -> Muscle:
            return replace(muscle, inner_radius=None, rest_volume=None, tube_volume=0.0)

        return self == other or (type(self) is type(other) and emptied(self) == emptied(other))

    # --- its parameters ---------------------------------------------------------------------------------------------

    @classmethod
    @cache
    def number_fields(cls) -> Mapping[str, bool]:
        """Return every field that holds numbers of the law, and whether it is a row of them."""
        return {f.name: f.type not in (float, "float") for f in fields(cls) if f.metadata.get("role") != "other"}

    @classmethod
    @cache
    def parameter_fields(cls) -> Mapping[str, bool]:
        """Return those number fields that are parameters."""
        structure = {f.name for f in fields(cls) if f.metadata.get("role") == "structure"}
        return {name: is_row for name, is_row in cls.number_fields().items() if name not in structure}

    @property
    def parameters(self) -> dict[str, float]:
        """Every parameter by its name; the members of a row are called name[0], name[1], …"""
        flat: dict[str, float] = {}
        for name, is_row in self.parameter_fields().items():
            value = getattr(self, name)
            flat |= {f"{name}[{i}]": v for i, v in enumerate(value)} if is_row else {name: value}
        return flat

    def with_parameters(self, values: Mapping[str, float]) -> Self:
        """Return the muscle with some parameters (named as in `parameters`) changed, checked, without covariance."""
        if unknown := values.keys() - self.parameters.keys():
            raise InvalidInput(
                f"{type(self).__name__} has no parameter {', '.join(map(repr, sorted(unknown)))}; "
                f"it has {', '.join(self.parameters)}"
            )
        changed = self._grouped([*(self.parameters | dict(values)).values()])
        return replace(self, **changed, covariance=None)

    def unchecked(self, values: Sequence[Value]) -> Self:
        """Return a copy with other values of all parameters, unchecked: complex (derivatives) or CasADi symbols."""
        copy = object.__new__(type(self))
        vars(copy).update(self._unchanged | self._grouped(values))
        return copy

    @cached_property
    def _unchanged(self) -> dict[str, object]:
        """Fields, without covariance, and edges, which are numbers whatever the parameters are."""
        own = {name: getattr(self, name) for name in _names(type(self))}
        return own | {"covariance": None, "edges": self.edges}

    def _grouped(self, values: Sequence[Value]) -> dict[str, Value]:
        """Return the field values from the flat list of all parameters."""
        left = iter(values)
        return {
            name: tuple(next(left) for _ in getattr(self, name)) if is_row else next(left)
            for name, is_row in self.parameter_fields().items()
        }

    @classmethod
    def recipe(cls, contraction: Array, pressure: Array, force: Array) -> Recipe[Self]:
        """Return how to fit this model to forces [N] (≤ 0: slack) at these contractions [-] and pressures [Pa]."""
        return Recipe()

    # --- on disk ----------------------------------------------------------------------------------------------------

    def save(self, path: str | PathLike[str], source: Mapping[str, str | float] | None = None) -> None:
        """Write the muscle, with its covariance, as a small TOML file; `source` says where the numbers come from."""
        from allocator.muscles import storage

        storage.save(self, path, source or {})

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a muscle from TOML: any model from `Muscle.load`, only its own kind from `Sarosi2012.load`.

        Raises `InvalidFile` if the file is not a muscle, or that of another model.
        """
        from allocator.muscles import storage

        return storage.load(cls, path)


@cache
def _names(model: type[Muscle]) -> tuple[str, ...]:
    """Return the names of all fields."""
    return tuple(f.name for f in fields(model))


SEARCH_CEILING = 20e5  # [Pa] far above any pneumatic muscle's burst pressure


class AffineMuscle(Muscle):
    """Muscle with a force law affine in pressure, F(P, ε) = P·A(ε) + B(ε). A model defines the two functions A and B.

    A and B are the formulas; `law` and all that follows from it continue them beyond the measured range. Most published
    laws are of this kind. Torque and stiffness are then affine in the two pressures, and every inverse is in closed
    form.
    """

    @abstractmethod
    def A(self, eps: Value) -> Value:
        """Return the force per pressure A(ε) [N/Pa], the effective area."""

    def B(self, eps: Value) -> Value:
        """Return the force at zero pressure B(ε) [N]; none unless the model has a passive part."""
        return 0.0 * eps

    @property
    def basis(self) -> Basis:
        """Basis functions of the pressure: 1 and P."""
        return Basis("quadratic")

    def law(self, P: Value, eps: Value) -> Value:
        """Return F = P·A(ε) + B(ε) [N], beyond the measured range by (R1)."""
        return P * continued(self.A, eps, self.edges) + self.passive_force(eps)

    def passive_force(self, eps: Value) -> Value:
        """Return the force at zero pressure B(ε) [N], beyond the measured range by (R1)."""
        return continued(self.B, eps, self.edges)

    def gain(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂P = A(ε) [N/Pa]."""
        return continued(self.A, eps, self.edges) + 0.0 * P

    def slope(self, P: Value, eps: Value) -> Value:
        """Return ∂F/∂ε = P·A'(ε) + B'(ε) [N]."""
        return P * self.gain_slope(0.0, eps) + self.passive_slope(eps)

    def passive_slope(self, eps: Value) -> Value:
        """Return ∂F/∂ε at zero pressure, B'(ε) [N]."""
        return derivative(self.B, eps if self.edges is None else held(eps, self.edges))

    def gain_slope(self, P: Value, eps: Value) -> Value:
        """Return ∂²F/∂P∂ε = A'(ε) [N/Pa]."""
        return derivative(self.A, eps if self.edges is None else held(eps, self.edges)) + 0.0 * P

    def gain_integral(self, P: Value, eps: Value) -> Value:
        """Return ∫_0^ε A(ε') dε' [N/Pa]: the volume does not depend on the pressure."""
        return continued_integral(self.A, self.A_integral, eps, self.edges) + 0.0 * P

    def gain_integral_slope(self, P: Value, eps: Value) -> Value:
        """Return 0."""
        return 0.0 * (P + eps)

    def A_integral(self, eps: Value) -> Value:
        """Return ∫_0^ε A(ε') dε' [N/Pa]; by quadrature unless a model has a formula."""
        return volume.integral(self.A, eps)

    def pressure(self, F: Value, eps: Value) -> Array:
        """Return P = (F - B(ε))/A(ε) [Pa]."""
        return np.asarray((F - self.law(0.0, eps)) / self.gain(0.0, eps))
