"""Linkages: bodies connected by hinges and slides, and the derivatives of their points.

For a point p on a link and a joint b that moves it, ∂p/∂q_b = w_b × (p - o_b) for a hinge, w_b for a slide; a hinge a
before b (or b itself) rotates that: ∂²p/∂q_a∂q_b = w_a × ∂p/∂q_b.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import SX

GROUND = -1
"""The link that does not move."""

Kind = Literal["hinge", "slide"]
Point: TypeAlias = tuple[float, ...]
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


@dataclass(frozen=True)
class Link:
    """Body connected to its parent by one joint; link i moves with joint i."""

    parent: int = GROUND  # index of an earlier link
    origin: Point = (0.0, 0.0, 0.0)  # of the joint, in the parent's frame [m]; two numbers lie in the plane z = 0
    axis: Point = (0.0, 0.0, 1.0)  # of the joint, in the link's own frame
    kind: Kind = "hinge"
    orientation: tuple[Point, ...] = _IDENTITY  # of the link's frame in the parent's: a rotation matrix
    zero: float = 0.0  # the joint's value in this orientation [rad or m]

    def __post_init__(self) -> None:
        """Check and normalise."""
        object.__setattr__(self, "parent", checks.count("Link: parent", self.parent, GROUND))
        object.__setattr__(self, "origin", point("Link: origin", self.origin))
        axis = np.array(point("Link: axis", self.axis))
        if not (norm := np.linalg.norm(axis)) > 0:
            raise InvalidInput("Link: axis = 0 is no direction")
        object.__setattr__(self, "axis", tuple((axis / norm).tolist()))
        if self.kind not in get_args(Kind):
            raise InvalidInput(f"Link: kind = {self.kind!r} is unknown; choose one of {', '.join(get_args(Kind))}")
        R = checks.real("Link: orientation", self.orientation, "-")
        if R.shape != (3, 3) or not np.allclose(R @ R.T, np.eye(3), atol=1e-9) or np.linalg.det(R) < 0:
            raise InvalidInput("Link: orientation has to be a rotation matrix (3, 3)")
        object.__setattr__(self, "orientation", tuple(map(tuple, R.tolist())))
        object.__setattr__(self, "zero", checks.number("Link: zero", self.zero, "rad or m"))


class Site(NamedTuple):
    """Point on a link: a via point of a muscle, or a hand."""

    link: int  # index, GROUND = -1
    position: Point  # in the link's frame [m]; two numbers lie in the plane z = 0


class Frame(NamedTuple):
    """Pose of a link at postures (…)."""

    rotation: Array  # (…, 3, 3) of the link's frame in the ground's
    origin: Array  # of its joint (…, 3) [m]
    axis: Array  # of its joint (…, 3)


class Moved(NamedTuple):
    """Position of a point at postures (…) of n joints, with its derivatives."""

    position: Array  # p (…, 3) [m]
    slope: Array  # ∂p/∂q (…, n, 3) [m/rad]
    curve: Array  # ∂²p/∂q² (…, n, n, 3) [m/rad²]


@dataclass(frozen=True)
class Linkage:
    """n links, each connected to an earlier one or to the ground."""

    links: tuple[Link, ...]

    def __init__(self, links: Sequence[Link]) -> None:
        """Take the links. Raises `InvalidInput` if a parent is not an earlier link."""
        for i, link in enumerate(links):
            if not link.parent < i:
                raise InvalidInput(f"link {i} has the parent {link.parent}; expected an earlier one, or -1")
        object.__setattr__(self, "links", tuple(links))

    @property
    def n(self) -> int:
        """Number of joints, one per link."""
        return len(self.links)

    def site(self, what: str, link: int, position: object) -> Site:
        """Return the checked point on a link. Raises `InvalidInput`, with a message that begins with `what`."""
        if link not in range(GROUND, self.n):  # a coordinate in place of the link is no whole number
            raise InvalidInput(f"{what} link {link}; expected a whole number from -1 (the ground) to {self.n - 1}")
        return Site(int(link), point(f"{what} link {link}: position", position))

    @cached_property
    def _moved_by(self) -> Array:
        """(n + 1, n): 1 if joint j moves link i (the ground last), else 0."""
        moved = np.zeros((self.n + 1, self.n))
        for i, link in enumerate(self.links):
            moved[i] = moved[link.parent]  # the ground, -1, is the last row
            moved[i, i] = 1.0
        return moved

    def frames(self, q: Array) -> list[Frame]:
        """Return the frame of every link at the postures `q` (…, n), and of the ground last."""
        still = np.zeros((*q.shape[:-1], 3))
        ground = Frame(np.broadcast_to(np.eye(3), (*still.shape, 3)), still, np.zeros(3))
        frames: list[Frame] = []
        for i, link in enumerate(self.links):
            R, o, _ = ground if link.parent == GROUND else frames[link.parent]
            origin, R = o + R @ np.array(link.origin), R @ np.array(link.orientation)
            axis, moved = R @ np.array(link.axis), q[..., i] - link.zero
            if link.kind == "hinge":
                frames.append(Frame(R @ _rotation(link.axis, moved), origin, axis))
            else:
                frames.append(Frame(R, origin + moved[..., None] * axis, axis))
        return [*frames, ground]

    def symbolic_frames(self, q: "SX") -> list[tuple["SX", "SX"]]:
        """Return (rotation (3, 3), origin (3, 1)) of every link, then of the ground, of a CasADi column `q` (n, 1)."""
        import casadi as ca

        ground = ca.SX.eye(3), ca.SX.zeros(3)
        frames: list[tuple[SX, SX]] = []
        for i, link in enumerate(self.links):
            R, o = ground if link.parent == GROUND else frames[link.parent]
            origin, R = o + R @ ca.DM(link.origin), R @ ca.DM(np.array(link.orientation))
            moved = q[i] - link.zero
            if link.kind == "hinge":
                W = ca.skew(ca.DM(link.axis))
                frames.append((R @ (ca.DM.eye(3) + ca.sin(moved) * W + (1 - ca.cos(moved)) * (W @ W)), origin))
            else:
                frames.append((R, origin + moved * (R @ ca.DM(link.axis))))
        return [*frames, ground]

    def point(self, site: Site, frames: list[Frame]) -> Moved:
        """Return the position of a site, with its derivatives, for links at `frames`."""
        R, o, _ = frames[site.link]
        p = o + R @ np.array(site.position)
        J = np.zeros((*p.shape[:-1], self.n, 3))
        C = np.zeros((*p.shape[:-1], self.n, self.n, 3))
        by = np.flatnonzero(self._moved_by[site.link])  # in the order of the chain
        for b in by:
            _, origin, axis = frames[b]
            J[..., b, :] = np.cross(axis, p - origin) if self.links[b].kind == "hinge" else axis
            for a in by[by <= b]:
                if self.links[a].kind == "hinge":
                    C[..., a, b, :] = C[..., b, a, :] = np.cross(frames[a][2], J[..., b, :])
        return Moved(p, J, C)


def point(name: str, value: object) -> Point:
    """Return three coordinates [m] from three, or from two in the plane z = 0. Raises `InvalidInput`."""
    array = checks.real(name, value, "m")
    if array.shape not in ((2,), (3,)):
        raise InvalidInput(f"{name} = {checks.brief(value)} has to be two or three coordinates [m]")
    return tuple(np.resize([*array.tolist(), 0.0], 3).tolist())


def _rotation(axis: Point, angle: Array) -> Array:
    """Return the rotation matrices (…, 3, 3) about a unit `axis` by `angle` (…) [rad] (Rodrigues)."""
    x, y, z = axis
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.asarray(np.eye(3) + s * W + (1 - c) * (W @ W))
