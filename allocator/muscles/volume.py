"""Volume of a muscle, which follows from its force law but for one number.

Quasi-static work on a muscle of rest length L is dE = P dV + F dl with l = L(1 - ε). With G = E - PV the mixed
derivatives of dG = -V dP + F dl are equal, so that of any law without hysteresis

    ∂V/∂ε |P = L ∂F/∂P        V(P, ε) = V_0 + L ∫_0^ε F_P(P, ε') dε'                                              (G1)

V_0, the volume at ε = 0 with its tubing, is not in the force: it is given (`Muscle.rest_volume`) or that of a cylinder.
"""

from collections.abc import Callable
from math import pi, sin, sqrt, tan
from typing import TYPE_CHECKING

import numpy as np

from allocator import checks
from allocator.calculus import Value, five_point
from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from allocator.muscles.base import Muscle

_BRAID = np.radians(25.0)  # of the fibres of an ordinary muscle at rest [rad]
_HALF_WAY = 0.1  # contraction at which laws agree best [-]
_NODES, _WEIGHTS = (column.tolist() for column in np.polynomial.legendre.leggauss(24))
_MOST_VOLUME = 5e-3  # [m³] of a muscle; a number above this is litres or cubic centimetres
_MOST_TUBE = 1e-3  # [m³]
_MOST_RADIUS = 0.2  # [m]
_LITRE, _CM3 = 1e-3, 1e-6  # [m³]


def integral(f: Callable[[Value], Value], eps: Value) -> Value:
    """Return ∫_0^ε f(ε') dε' by Gauss–Legendre quadrature with 24 nodes, of numbers, arrays or CasADi symbols."""
    half = eps / 2
    total = 0.0 * eps
    for node, weight in zip(_NODES, _WEIGHTS, strict=True):
        total = total + weight * f(half * (1 + node))
    return half * total


def usual_volume(muscle: "Muscle", P: float, rest_length: float) -> tuple[float, float]:
    """Return the volume at rest [m³] of an ordinary braid that pulls at `P` [Pa] as hard as `muscle`, and its radius.

    Its fibres are at 25°: F_P = π r² (a (1 - ε)² - b), a = 3/tan²α, b = 1/sin²α, by Tondu & Lopez's equation (7), is
    solved for r at ε = 0.1, where both hold as much gas. That is 4 to 24 % more than the catalogue's muscles hold.
    Raises InvalidInput for a muscle that does not pull there.
    """
    gain = float(muscle.gain(P, _HALF_WAY))
    if not gain > 0:
        raise InvalidInput(f"this {type(muscle).__name__} gains no force by pressure at {_HALF_WAY:.0%} contraction")
    e, a, b = _HALF_WAY, 3 / tan(_BRAID) ** 2, 1 / sin(_BRAID) ** 2
    radius = sqrt(gain / pi / (a * (1 - e) ** 2 - b))
    there = pi * radius**2 * (1 + a * (e - e**2 + e**3 / 3) - b * e)
    return rest_length * (there - float(muscle.gain_integral(P, e))), radius


def difference(f: Callable[[Value], Value], P: Value) -> Value:
    """Return f'(P) by a five-point difference over 1/1000 of P and an atmosphere: analytic in P, also of symbols.

    Its error is about 1e-12 of f/P for a law that changes over pressures of a bar.
    """
    return five_point(f, P, 1e-3 * (P + 1e5))


def checked(name: str, value: object, tube: bool = False) -> float:
    """Return a volume [m³]: positive, or of a tube not negative; litres and cubic centimetres are pointed out."""
    volume = checks.number(name, value, "m³")
    if volume < 0 or (volume == 0 and not tube):
        raise InvalidInput(f"{name} = {volume:g} m³ has to be {'zero or more' if tube else 'positive'}")
    most = _MOST_TUBE if tube else _MOST_VOLUME
    if volume > most:
        unit, scale = ("litres", _LITRE) if volume * _LITRE <= most else ("cubic centimetres", _CM3)
        raise InvalidInput(
            f"{name} = {volume:g} m³ is more than any {'tubing' if tube else 'muscle'} holds; "
            f"if {unit} were meant, pass {volume * scale:.4g}"
        )
    return volume


def checked_radius(name: str, value: object) -> float:
    """Return a radius [m]; millimetres are pointed out."""
    radius = checks.number(name, value, "m")
    if not 0 < radius <= _MOST_RADIUS:
        hint = f"; if millimetres were meant, pass {radius / 1e3:g}" if radius > 0 else ""
        raise InvalidInput(f"{name} = {radius:g} m is no muscle's radius{hint}")
    return radius
