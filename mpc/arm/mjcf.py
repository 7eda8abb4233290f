"""Export of mechanisms with rigid bodies as MJCF, MuJoCo's format, with muscles as tendons.

`Sites` become spatial tendons through sites on bodies, which are exact everywhere. `Pulleys` become *fixed* tendons,
l = -r·q, with constant arms at every posture; MuJoCo's wrapping round a cylinder has a constant arm only while the
tendon touches it. MuJoCo does not draw fixed tendons; their muscles are drawn as capsules without mass or contact. Such
a muscle lies along -x of the joint that it moves first, at its true length; its far end moves with the cable. It is
mounted on the link before that joint if that is long enough, else on the ground, from which the cable runs through the
axes of the joints on its path.

`Mechanism.from_mjcf` reads routes, names and ranges back, with rest lengths and cables from the tendons' user data.
"""

from itertools import pairwise
from math import pi, tan
from typing import Any, NamedTuple
from xml.etree import ElementTree as Tree

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism import Mechanism
from allocator.mechanism.bodies import Bodies
from allocator.mechanism.routes import Pulleys, Sites
from allocator.mechanism.routes.linkage import GROUND, Link
from allocator.mechanism.routes.mjcf import MARK, Source
from mpc.model.arm.model import Arm

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


_TIMESTEP = 0.002  # [s]
_SLENDER = 0.01  # a rod's inertia about its axis, over that across; there is no rotation about it in the plane
_THIN, _THICK = 0.004, 0.012  # [m] radii of drawn links and muscles
_ABOVE_FLOOR = 0.05  # [m] of a chain, which throws a shadow on the floor
_GREY = "0.55 0.58 0.62 1"


def to_mjcf(mechanism: Mechanism, bodies: Bodies, *, name: str = "antagonist", timestep: float = _TIMESTEP) -> str:
    """Return the MJCF text of a mechanism with `Pulleys` or `Sites` and of its `bodies`; MuJoCo is not needed.

    On `Pulleys` the links are the bodies' chain in the plane. On `Sites` they are the routes' own links, with the
    masses of the bodies on their x-axes; the equations of motion are those of `bodies` if both are the same chain.
    Ranges of the joints become their limits, the gravity of the plane that of the model. `timestep` [s] is that of
    simulations. Raises `InvalidInput` for other routes and other bodies, and for another number of joints.
    """
    if not isinstance(bodies, Bodies):
        raise InvalidInput(f"{type(bodies).__name__} cannot be written as MJCF; Bodies, a chain in the plane, can")
    if bodies.n != mechanism.n:
        raise InvalidInput(f"bodies have n = {bodies.n} links; the mechanism has n = {mechanism.n} joints")
    routes, root = mechanism.routes, Tree.Element("mujoco", model=name)
    if not isinstance(routes, Pulleys | Sites):
        raise InvalidInput(f"{type(routes).__name__} cannot be written as MJCF; Pulleys and Sites can")
    _settings(root, bodies, timestep)
    world = Tree.SubElement(root, "worldbody")
    light = {"pos": "-1 1.5 3", "dir": "0.3 -0.45 -1", "directional": "true", "castshadow": "true"}
    Tree.SubElement(world, "light", light, diffuse="0.55 0.55 0.55")
    floor = {"class": DRAWN, "name": "floor", "type": "plane", "material": "floor", "size": "3 3 0.1"}
    Tree.SubElement(world, "geom", floor, pos=row(0.0, 0.0, -_ABOVE_FLOOR))
    parts = _links(world, mechanism, bodies.links if isinstance(routes, Pulleys) else routes.links, bodies)
    tendons = Tree.SubElement(root, "tendon")
    if isinstance(routes, Sites):
        _spatial(tendons, mechanism, routes, parts)
        ground = [np.linalg.norm(site.position) for path in routes.paths for site in path if site.link == GROUND]
        Tree.SubElement(world, "camera", {"name": "view", **view(bodies, float(max(ground, default=0.0)))})
    else:
        _fixed(tendons, mechanism, routes)
        drawing = Drawing(mechanism, bodies)
        drawing.draw(parts)
        Tree.SubElement(world, "camera", {"name": "view", **view(bodies, drawing.behind)})
    Tree.indent(root)
    return Tree.tostring(root, encoding="unicode") + "\n"


def model_of(arm: Arm) -> tuple[Source, dict[str, Any]]:
    """Return the MuJoCo model of `arm`, and the rest lengths and cables of its tendons, arguments of a `MujocoPlant`.

    The model is the one that the arm was read from, else `to_mjcf` writes it. Raises `InvalidInput`.
    """
    checks.instance("arm", arm, Arm, "an Arm, such as Arm.machine('arm26')")
    routes: Any = arm.mechanism.routes
    model = getattr(arm.bodies, "model", None)
    if model is None:
        return to_mjcf(arm.mechanism, arm.bodies), {}
    L = np.array(routes.rest_length)
    cable = L * (np.array(routes.initial_contraction) - 1) if isinstance(routes, Pulleys) else routes.cable
    return model, {"rest_length": routes.rest_length, "cable": cable}


def _settings(root: Tree.Element, bodies: Bodies, timestep: float) -> None:
    Tree.SubElement(root, "compiler", angle="radian", autolimits="true")
    option = Tree.SubElement(root, "option", timestep=repr(timestep), gravity=row(*bodies.gravity, 0.0))
    Tree.SubElement(option, "flag", contact="disable")
    Tree.SubElement(root, "size", nuser_tendon="2")
    custom = Tree.SubElement(root, "custom")
    Tree.SubElement(custom, "text", name=MARK, data="user data of a tendon: rest length and cable [m] of the muscle")
    visual = Tree.SubElement(root, "visual")
    Tree.SubElement(visual, "global", offwidth="1280", offheight="960")
    Tree.SubElement(visual, "headlight", ambient="0.4 0.4 0.4", diffuse="0.3 0.3 0.3", specular="0.1 0.1 0.1")
    Tree.SubElement(visual, "quality", offsamples="8", shadowsize="4096")
    Tree.SubElement(visual, "map", shadowclip="2")  # avoids stray shadows at the edges of a wide picture
    drawn = Tree.SubElement(Tree.SubElement(root, "default"), "default", {"class": DRAWN})
    Tree.SubElement(drawn, "geom", contype="0", conaffinity="0", mass="0", rgba=_GREY)
    sky = {"type": "skybox", "builtin": "gradient", "rgb1": "1 1 1", "rgb2": "0.8 0.85 0.9"}
    tiles = {"type": "2d", "builtin": "checker", "rgb1": "0.93 0.94 0.95", "rgb2": "0.88 0.9 0.92"}
    asset = Tree.SubElement(root, "asset")
    Tree.SubElement(asset, "texture", {**sky, "width": "64", "height": "64"})
    Tree.SubElement(asset, "texture", {**tiles, "name": "floor", "width": "128", "height": "128"})
    Tree.SubElement(asset, "material", name="floor", texture="floor", texrepeat="10 10", texuniform="true")


def _links(
    world: Tree.Element, mechanism: Mechanism, links: tuple[Link, ...], bodies: Bodies
) -> dict[int, Tree.Element]:
    """Write one body per link, and return the elements by the links' numbers."""
    parts = {GROUND: world}
    for i, link in enumerate(links):
        part = parts[i] = Tree.SubElement(parts[link.parent], "body", name=f"{mechanism.joint_names[i]} link")
        part.set("pos", row(*link.origin))
        part.set("quat", row(*_quaternion(np.array(link.orientation))))
        joint = Tree.SubElement(part, "joint", name=mechanism.joint_names[i], type=link.kind, axis=row(*link.axis))
        joint.set("damping", repr(bodies.damping[i]))
        joint.set("ref", repr(link.zero))
        if mechanism.angle_limits is not None:
            joint.set("range", row(*mechanism.angle_limits[i]))
        across = bodies.inertia[i]
        inertial = Tree.SubElement(part, "inertial", pos=row(bodies.centre[i], 0.0, 0.0), mass=repr(bodies.mass[i]))
        inertial.set("diaginertia", row(_SLENDER * across, across, across))
        rod = Tree.SubElement(part, "geom", {"class": DRAWN}, type="capsule", size=repr(2 * _THIN))
        rod.set("fromto", row(0.0, 0.0, 0.0, bodies.length[i], 0.0, 0.0))
    return parts


def _tendon(tendons: Tree.Element, kind: str, mechanism: Mechanism, j: int, cable: float) -> Tree.Element:
    tendon = Tree.SubElement(tendons, kind, name=mechanism.muscle_names[j])
    tendon.set("user", row(mechanism.routes.rest_length[j], cable))
    return tendon


def _fixed(tendons: Tree.Element, mechanism: Mechanism, routes: Pulleys) -> None:
    """Write l_j + L_j (1 - ε0_j) = -r_j·q: the constant part of the length counts as cable."""
    for j, arms in enumerate(routes.arms):
        at_zero = routes.rest_length[j] * (1 - routes.initial_contraction[j])
        tendon = _tendon(tendons, "fixed", mechanism, j, -at_zero)
        for joint, arm in zip(mechanism.joint_names, arms, strict=True):
            if arm:
                Tree.SubElement(tendon, "joint", joint=joint, coef=repr(-arm))


def _spatial(tendons: Tree.Element, mechanism: Mechanism, routes: Sites, parts: dict[int, Tree.Element]) -> None:
    for j, path in enumerate(routes.paths):
        tendon = _tendon(tendons, "spatial", mechanism, j, routes.cable[j])
        tendon.set("width", repr(_THICK))
        tendon.set("rgba", row(*PALE, 1.0))
        for k, (link, position) in enumerate(path):
            site = f"{mechanism.muscle_names[j]} {k + 1}"
            Tree.SubElement(parts[link], "site", name=site, pos=row(*position), size=repr(_THIN))
            Tree.SubElement(tendon, "site", site=site)


def _quaternion(R: ArrayLike) -> tuple[float, ...]:
    """Return the unit quaternion (w, x, y, z) of a rotation matrix."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(R).as_quat().tolist()
    return w, x, y, z
