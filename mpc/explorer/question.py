"""Questions of the page's controls, and the answers of `allocate` and of the feasible set.

Questions and answers are in degrees, bar and millimetres, as on the page; computations are in SI. The page rounds.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from allocator import AntagonistJoint, Lever, Pulley, allocate, feasibility_map, stiffness_interval
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.edges import Edge
from allocator.joint.gas import Stiffness, Valves
from allocator.joint.geometry import Geometry
from allocator.units import BAR, DEG, MM

_VALVES: dict[str, Valves] = {
    "open": "open",
    "shut": "shut",
    "agonist": (True, False),
    "antagonist": (False, True),
    "free": "free",
}
_PUSH = 2 * DEG  # by a hand
_SLACK = 1e-3  # [N] that a muscle may push by rounding
_COLUMNS = 41
_DRAWN = 120  # points of an edge, at most


class _Control(NamedTuple):
    """Slider for a number of the geometry."""

    name: str
    label: str
    unit: float
    low: float
    high: float
    step: float


_REST_LENGTH = _Control("rest_length", "Rest length of the muscles [mm]", MM, 50, 1000, 5)
_CONTROLS: dict[str, tuple[_Control, ...]] = {  # by the class of the geometry; other classes have none
    Pulley.__name__: (
        _REST_LENGTH,
        _Control("radius", "Radius of the pulley [mm]", MM, 5, 100, 0.5),
        _Control("initial_contraction", "Contraction at 0° [ratio]", 1.0, 0.02, 0.3, 0.0025),
    ),
    Lever.__name__: (
        _REST_LENGTH,
        _Control("anchor", "Axis to anchor [mm]", MM, 20, 1000, 1),
        _Control("lever", "Axis to the lever's end [mm]", MM, 5, 200, 0.5),
        _Control("offset", "Muscle beyond the anchor [mm], negative: cable", MM, -500, 500, 1),
    ),
}


@dataclass(frozen=True)
class Question:
    """Target and changes of the joint; None leaves a number unchanged."""

    theta: float = 0.0  # [°]
    stiffness: float = 7.5  # [N·m/rad]
    torque: float = 0.0  # [N·m]
    valves: str = "open"
    supply: float | None = None  # [bar]
    rest_length: float | None = None  # [mm]
    radius: float | None = None  # [mm]
    initial_contraction: float | None = None  # [-]
    anchor: float | None = None  # [mm]
    lever: float | None = None  # [mm]
    offset: float | None = None  # [mm]

    @classmethod
    def of(cls, given: Mapping[str, str]) -> Self:
        """Read the question from texts by name. Raises `InvalidInput` for unknown names and invalid numbers."""
        if unknown := given.keys() - {field.name for field in fields(cls)}:
            raise InvalidInput(f"nothing is known of {', '.join(sorted(unknown))}")
        if (valves := given.get("valves", "open")) not in _VALVES:
            raise InvalidInput(f"valves = {valves!r}: choose one of {', '.join(_VALVES)}")
        values = {name: _number(name, text) for name, text in given.items() if name != "valves"}
        return cls(**values, valves=valves)

    @property
    def meant(self) -> Stiffness:
        """Kind of the target stiffness."""
        return Stiffness(_VALVES[self.valves])

    def joint(self, base: AntagonistJoint) -> AntagonistJoint:
        """Return the joint with the changes. Raises `InvalidInput` for numbers that are not in its geometry."""
        geometry, kind = base.geometry, type(base.geometry).__name__
        own = {control.name: control for control in _controls(geometry)}
        every = {control.name for controls in _CONTROLS.values() for control in controls}
        given = {name: getattr(self, name) for name in every if getattr(self, name) is not None}
        if strange := sorted(given.keys() - own.keys()):
            raise InvalidInput(f"the joint's geometry is a {kind}, which has no {', '.join(strange)}")
        if given:
            geometry = replace(geometry, **{name: value * own[name].unit for name, value in given.items()})
        high = base.pressure_limits[1] if self.supply is None else self.supply * BAR
        return replace(base, geometry=geometry, pressure_limits=(base.pressure_limits[0], high))


def _number(name: str, text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{name} = {text!r} is no number") from None


@dataclass(frozen=True)
class Answer:
    """Answer of the page to one question."""

    question: Question
    base: AntagonistJoint

    @cached_property
    def joint(self) -> AntagonistJoint:
        """Joint of the question."""
        return self.question.joint(self.base)

    def state(self, reach: tuple[float, float] | None = None) -> dict[str, object]:
        """Return pressures, their results, the active limit, and both muscles.

        `reach` has the ends of the feasible stiffnesses [N·m/rad] at the angle and the torque if they are known.
        """
        asked = self.question
        a = allocate(asked.theta * DEG, asked.stiffness, asked.torque, joint=self.joint, stiffness=asked.meant)
        theta = float(a.theta)
        low, high = reach or stiffness_interval(theta, asked.torque, joint=self.joint, stiffness=asked.meant)
        return {
            "theta": theta / DEG,
            "pressures": [a.P1 / BAR, a.P2 / BAR],
            "stiffness": a.K,
            "torque": a.T,
            "name": a.stiffness_name,
            "three": three(self.joint, theta, a.P1, a.P2),
            "status": a.status.name,
            "met": bool(a.success),
            "message": a.message,
            "binding": list(a.active),
            "reach": [_or_none(low), _or_none(high)],
            "muscles": muscles(self.joint, theta, a.P1, a.P2),
            "geometry": _numbers(self.joint.geometry),
        }

    def outline(self) -> dict[str, object]:
        """Return the border of the feasible stiffnesses at the torque, by the limits that define it.

        With trapped gas in muscles that are not affine, the complete search takes too long for an interactive page. The
        border is then found angle by angle, without the names of the limits.
        """
        left, right = self.joint.angle_range
        quick = self.joint.affine or self.question.valves == "open"
        edges = self._edges(left, right) if quick else self._columns(np.linspace(left, right, _COLUMNS))
        return {"angles": [left / DEG, right / DEG], "edges": edges}

    def _edges(self, left: float, right: float) -> list[dict[str, object]]:
        some = np.array([left, right]), np.array([1.0, 2.0])  # edges do not depend on the cells
        asked = self.question
        found = feasibility_map(*some, asked.torque, joint=self.joint, stiffness=asked.meant)
        return [_edge(edge) for edge in found.edges]

    def _columns(self, theta: Array) -> list[dict[str, object]]:
        asked = self.question
        ends = stiffness_interval(theta, asked.torque, joint=self.joint, stiffness=asked.meant)
        there = ~np.isnan(ends[0])
        curves = ((theta[there] / DEG).tolist(), *(end[there].tolist() for end in ends))
        return [{"limits": None, "theta": curves[0], "stiffness": K} for K in curves[1:] if there.any()]


def three(joint: AntagonistJoint, theta: float, P1: float, P2: float) -> dict[str, float | None]:
    """Return the backbone's stiffness, that felt by ±2° and that with shut valves [N·m/rad]; None for unknown gas."""
    shut = _shut(joint, theta, P1, P2)
    found = {
        "backbone": float(joint.stiffness(theta, P1, P2)),
        "felt": float(joint.stiffness(theta, P1, P2, amplitude=_PUSH)),
    }
    return {name: _or_none(K) for name, K in found.items()} | {"shut": shut}


def muscles(joint: AntagonistJoint, theta: float, P1: float, P2: float) -> list[dict[str, object]]:
    """Return pressure [bar], contraction, length [mm] and force [N] of both muscles at the angle [rad]."""
    sides, forces = joint.sides(theta), joint.forces(theta, P1, P2)
    return [
        {
            "pressure": P / BAR,
            "contraction": float(one.contraction),
            "length": joint.geometry.rest_length * (1 - float(one.contraction)) / MM,
            "force": float(force),
            "taut": bool(force > -_SLACK),
        }
        for one, P, force in zip(sides, (P1, P2), forces, strict=True)
    ]


def _edge(edge: Edge) -> dict[str, object]:
    every = slice(None, None, max(1, edge.theta.size // _DRAWN))
    return {
        "limits": list(edge.active),
        "theta": _with_last(edge.theta, every, 1 / DEG),
        "stiffness": _with_last(edge.K, every, 1.0),
    }


def _with_last(values: Array, every: slice, factor: float) -> list[float]:
    """Return some of the values, and the last one in any case."""
    return [*(values[every] * factor).tolist(), float(values[-1] * factor)]


def _or_none(value: float | Array) -> float | None:
    """Return the number, or None for NaN: JSON has none."""
    return None if np.isnan(value) else float(value)


def describe(joint: AntagonistJoint) -> dict[str, object]:
    """Return the data of the joint that the page needs before the first question."""
    theta = sum(joint.angle_range) / 2
    low, high = stiffness_interval(theta, 0.0, joint=joint)
    return {
        "angles": [angle / DEG for angle in joint.angle_range],
        "supply": joint.pressure_limits[1] / BAR,
        "geometry": type(joint.geometry).__name__,
        "stiffness": _or_none((low + high) / 2),
        "controls": [
            {"name": c.name, "label": c.label, "step": c.step, "value": value}
            | {"low": min(c.low, value), "high": max(c.high, value)}
            for c, value in zip(_controls(joint.geometry), _numbers(joint.geometry).values(), strict=True)
        ],
        "gas": _has_gas(joint),
        "hysteresis": not joint.loop.absent,
    }


def _controls(geometry: Geometry) -> tuple[_Control, ...]:
    return _CONTROLS.get(type(geometry).__name__, ())


def _numbers(geometry: Geometry) -> dict[str, float]:
    """Return the numbers with a slider, in its unit."""
    return {control.name: getattr(geometry, control.name) / control.unit for control in _controls(geometry)}


def _has_gas(joint: AntagonistJoint) -> bool:
    """Return whether the volume of both muscles is known, so that valves may be shut."""
    return _shut(joint, sum(joint.angle_range) / 2, *2 * (joint.pressure_limits[1],)) is not None


def _shut(joint: AntagonistJoint, theta: float, P1: float, P2: float) -> float | None:
    """Return the stiffness with shut valves [N·m/rad], or None where the gas is unknown or its model does not hold."""
    try:
        return float(joint.stiffness(theta, P1, P2, "shut"))
    except InvalidInput:
        return None
