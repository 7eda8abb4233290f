"""Drawing of muscles on pulleys as capsules, with cables and pulleys, without mass or effect.

A muscle lies along -x of the joint that it moves first, at its true length; its far end moves with the cable. It is
mounted on the link before that joint if that is long enough, else on the ground, from which the cable runs through the
axes of the joints on its path.
"""

from itertools import pairwise
from math import pi, tan
from typing import NamedTuple
from xml.etree import ElementTree as Tree

import numpy as np

from allocator.calculus import Array
from allocator.mechanism import Mechanism
from allocator.mechanism.routes import Pulleys
from allocator.mechanism.routes.linkage import GROUND
from mpc.model.arm.bodies import Bodies

DRAWN = "drawn"
"""Class of geoms for display only."""
PALE, RED = (0.93, 0.86, 0.78), (0.80, 0.04, 0.05)
"""Colours of a muscle without pressure and with the supply's pressure."""

_RADIUS = 0.011  # [m] of a muscle before its pressure is known
_CABLE = 0.0015  # [m]
_GAP = 0.06  # [m] from the shortest cable's end to the joint's axis
_FIRST, _NEXT = 0.035, 0.045  # [m] from the middle to the first muscle at its side, and on to the next
_ANY_RANGE = 1.0  # [rad] for a joint without a range
_FOVY = 45.0  # [°]


class Place(NamedTuple):
    """Place of a drawn muscle: on a link, beginning at x = `begin`, at y = `side`."""

    link: int
    begin: float  # [m], behind the joint's axis
    side: float  # [m]


class Drawing:
    """Places of all muscles of a machine on pulleys."""

    def __init__(self, mechanism: Mechanism, bodies: Bodies) -> None:
        routes = mechanism.routes
        assert isinstance(routes, Pulleys)  # the only ones that `to_mjcf` draws
        self.mechanism, self.bodies, self.arms = mechanism, bodies, np.array(routes.arms)
        reach = (
            np.abs(mechanism.angle_limits).max(axis=1) if mechanism.angle_limits else np.full(mechanism.n, _ANY_RANGE)
        )
        rest = mechanism.lengths(np.zeros(mechanism.n))
        self._longest = rest + np.abs(self.arms) @ reach
        self._rest = rest
        self._sides = (self.arms * bodies.sense).tolist()  # (m, n) y of the cables at the joints [m]
        self.places = self._placed()

    @property
    def behind(self) -> float:
        """Extent of the muscles on the ground behind the first joint [m]."""
        return max([-place.begin for place in self.places if place.link == GROUND], default=0.0)

    def _placed(self) -> list[Place]:
        places: list[Place] = []
        taken: dict[tuple[int, float], int] = {}
        for j, arms in enumerate(self.arms):
            first = int(np.flatnonzero(arms)[0])
            room = 0.0 if first == 0 else self.bodies.length[first - 1]
            link = first - 1 if room >= self._longest[j] + _GAP else GROUND
            sign = 1.0 if self._sides[j][first] > 0 else -1.0
            beside = taken[link, sign] = taken.get((link, sign), -1) + 1
            axis = 0.0 if link == GROUND else room
            places.append(Place(link, axis - _GAP - self._longest[j], sign * (_FIRST + _NEXT * beside)))
        return places

    def draw(self, parts: dict[int, Tree.Element]) -> None:
        """Write capsules, cables and pulleys into the bodies (`parts`) of the links."""
        for j, (name, place) in enumerate(zip(self.mechanism.muscle_names, self.places, strict=True)):
            muscle = _geom(parts[place.link], "capsule", name=muscle_geom(name), rgba=row(*PALE, 1.0))
            half = self._rest[j] / 2
            muscle.set("pos", row(place.begin + half, place.side, 0.0))
            muscle.set("size", row(_RADIUS, half - _RADIUS))
            muscle.set("quat", row(0.5**0.5, 0.0, 0.5**0.5, 0.0))  # along x
            self._cable(parts, j, place)
        for i, column in enumerate(self.arms.T):
            for k, radius in enumerate(sorted({abs(r) for r in column.tolist() if r}, reverse=True)):
                pulley = _geom(parts[i], "cylinder", size=row(radius, 0.006), rgba="0.25 0.28 0.33 1")
                pulley.set("pos", row(0.0, 0.0, 0.013 * k))

    def _cable(self, parts: dict[int, Tree.Element], j: int, place: Place) -> None:
        """Draw the cable from the muscle's mount to the last joint that it moves, link by link."""
        last = int(np.flatnonzero(self.arms[j])[-1])
        at_joint = place.link + 1
        x = 0.0 if place.link == GROUND else self.bodies.length[place.link]
        bend = x - 0.7 * _GAP
        corners = [(place.begin, place.side), (bend, place.side), (x, self._sides[j][at_joint])]
        for (x0, y0), (x1, y1) in pairwise(corners):
            _line(parts[place.link], (x0, y0), (x1, y1))
        for i in range(at_joint, last):
            _line(parts[i], (0.0, self._sides[j][i]), (self.bodies.length[i], self._sides[j][i + 1]))


def muscle_geom(name: str) -> str:
    """Return the name of the drawn geom of the muscle `name`."""
    return f"muscle {name}"


def paint(model: object, names: tuple[str, ...], lengths: Array, radii: Array, fill: Array) -> None:
    """Set `lengths` and `radii` (m,) [m] of the drawn muscles of an `MjModel`, or else of its tendons.

    `fill` (m,) are the pressures in fractions of the supply's, from pale to red.
    """
    import mujoco

    for j, (name, length, radius) in enumerate(zip(names, lengths.tolist(), radii.tolist(), strict=True)):
        colour = (1 - fill[j]) * np.array(PALE) + fill[j] * np.array(RED)
        geom = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, muscle_geom(name))
        if geom < 0:
            model.tendon_width[j], model.tendon_rgba[j, :3] = radius, colour  # type: ignore[attr-defined]
            continue
        m: object = model
        begin = m.geom_pos[geom, 0] - m.geom_size[geom, 1] - m.geom_size[geom, 0]  # type: ignore[attr-defined]
        m.geom_size[geom, :2] = radius, length / 2 - radius  # type: ignore[attr-defined]
        m.geom_pos[geom, 0] = begin + length / 2  # type: ignore[attr-defined]
        m.geom_rgba[geom, :3] = colour  # type: ignore[attr-defined]


def view(bodies: Bodies, behind: float) -> dict[str, str]:
    """Return the attributes of a camera for a chain and its muscles `behind` it [m], with gravity downwards."""
    reach = sum(bodies.length)
    middle = np.array([(reach - behind) / 2, 0.0, 0.0])
    down = np.array([*bodies.gravity, 0.0])
    up = -down / np.linalg.norm(down) if down.any() else np.array([0.0, 1.0, 0.0])
    distance = 0.56 * (reach + behind) / tan(_FOVY / 2 * pi / 180)
    back = np.array([0.0, 0.0, 1.0]) * np.cos(0.45) - up * np.sin(0.45)  # a little from below, to show the depth
    right = np.cross(up, back)
    upward = np.cross(back, right)
    place = middle + distance * back
    return {"pos": row(*place), "xyaxes": row(*right, *upward), "fovy": repr(_FOVY)}


def _geom(part: Tree.Element, kind: str, **attributes: str) -> Tree.Element:
    return Tree.SubElement(part, "geom", {"class": DRAWN}, type=kind, **attributes)


def _line(part: Tree.Element, begin: tuple[float, float], end: tuple[float, float]) -> None:
    if np.hypot(end[0] - begin[0], end[1] - begin[1]) > _CABLE:
        cable = _geom(part, "capsule", size=repr(_CABLE), rgba="0.2 0.2 0.2 1")
        cable.set("fromto", row(*begin, 0.0, *end, 0.0))


def row(*numbers: float) -> str:
    """Return numbers in the format of MJCF."""
    return " ".join(repr(float(number)) for number in numbers)
