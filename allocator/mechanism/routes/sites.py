"""Muscles that run straight between points on links, with closed first and second derivatives of their lengths.

A segment between the points p_o and p_i of two links has D = p_i - p_o, u = D/|D| and J = ∂D/∂q; with it

    r = -Jᵀu,      H = (JᵀJ - Jᵀu uᵀJ)/|D| + Σ_c u_c ∂²D_c/∂q²          (several segments add up)

For a point p on a link and a joint b that moves it ∂p/∂q_b = w_b × (p - o_b) of a hinge, w_b of a slide; a hinge a
before b (or b itself) turns that: ∂²p/∂q_a∂q_b = w_a × ∂p/∂q_b.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism.routes.base import RoutedLengths, Routes, check_arms, per_muscle, rest_lengths

GROUND = -1
"""The link that does not move."""

Kind = Literal["hinge", "slide"]
Point: TypeAlias = tuple[float, ...]
_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_COINCIDE = 1e-9  # [m]
_SOMEWHERE = 0.3  # [rad] or [m] per joint: a posture in general position, at which structural zeros show


@dataclass(frozen=True)
class Link:
    """A `Link` is a body that hangs on its parent by one joint; link i moves with joint i."""

    parent: int = GROUND  # index of an earlier link
    origin: Point = (0.0, 0.0, 0.0)  # of the joint, in the parent's frame [m]; two numbers lie in the plane z = 0
    axis: Point = (0.0, 0.0, 1.0)  # of the joint, in the link's own frame
    kind: Kind = "hinge"
    orientation: tuple[Point, ...] = _IDENTITY  # of the link's frame in the parent's: a rotation matrix
    zero: float = 0.0  # the joint's value at which that is so [rad or m]

    def __post_init__(self) -> None:
        """Check and normalise."""
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
    """A `Site` is a point on a link that a muscle runs through."""

    link: int  # index, GROUND = -1
    position: Point  # in the link's frame [m]; two numbers lie in the plane z = 0


@dataclass(frozen=True)
class Sites(Routes):
    """`Sites` are routes along straight segments between points on links."""

    links: tuple[Link, ...]
    paths: tuple[tuple[Site, ...], ...]  # the sites of each of m muscles, in order
    cable: tuple[float, ...]  # (m,) length of the path that is not muscle but cable [m]

    def __init__(
        self, rest_length: Any, links: Sequence[Link], paths: Sequence[Sequence[Any]], cable: Any = 0.0
    ) -> None:
        """Check and keep `links` (n) and `paths` (m), of pairs (link, position [m]); the rest are numbers or rows (m,).

        The muscle's length is that of its path less `cable` [m]. Raises `InvalidInput`.
        """
        n, m = len(links), len(paths)
        if not n or not m:
            raise InvalidInput(f"Sites: n = {n} links and m = {m} paths; expected one or more of both")
        for i, link in enumerate(links):
            if not GROUND <= link.parent < i:
                raise InvalidInput(f"Sites: link {i} has the parent {link.parent}; expected an earlier one, or -1")
        object.__setattr__(self, "links", tuple(links))
        object.__setattr__(self, "paths", tuple(_path(f"Sites: path {j}", path, n) for j, path in enumerate(paths)))
        object.__setattr__(self, "rest_length", rest_lengths("Sites", rest_length, m))
        object.__setattr__(self, "cable", tuple(per_muscle("Sites: cable", cable, m, "m").tolist()))
        check_arms("Sites", self.at(_SOMEWHERE * np.arange(1.0, n + 1) / n).arm)

    @property
    def n(self) -> int:
        """Return the number of joints, one a link."""
        return len(self.links)

    @cached_property
    def _moved_by(self) -> Array:
        """Return (n + 1, n): 1 where link i (the ground last) is moved by joint j, else 0."""
        moved = np.zeros((self.n + 1, self.n))
        for i, link in enumerate(self.links):
            moved[i] = moved[link.parent]  # the ground, -1, is the last row
            moved[i, i] = 1.0
        return moved

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n). Raises `InvalidInput` where two sites meet."""
        frames = self._frames(q)
        length, arm, bend = (np.zeros((*q.shape[:-1], self.m, *(self.n,) * order)) for order in (0, 1, 2))
        length -= np.array(self.cable)
        for j, path in enumerate(self.paths):
            points = [self._point(site, frames) for site in path]
            for start, end in pairwise(points):
                D, J, C = (b - a for a, b in zip(start, end, strict=True))
                distance = np.sqrt((D * D).sum(-1))
                if not (distance > _COINCIDE).all():
                    raise InvalidInput(f"Sites: two neighbouring sites of muscle {j + 1} meet at one of the postures")
                u = D / distance[..., None]
                Ju = J @ u[..., None]  # (…, n, 1)
                length[..., j] += distance
                arm[..., j, :] -= Ju[..., 0]
                straight = (J @ J.swapaxes(-1, -2) - Ju @ Ju.swapaxes(-1, -2)) / distance[..., None, None]
                bend[..., j, :, :] += straight + (C @ u[..., None, :, None])[..., 0]
        return RoutedLengths(length, arm, bend)

    def positions(self, q: Array) -> list[Array]:
        """Return where the sites of each muscle are at the postures `q` (…, n): m arrays (…, sites, 3) [m]."""
        frames = self._frames(np.asarray(q, float))
        return [np.stack([self._point(site, frames)[0] for site in path], axis=-2) for path in self.paths]

    def _frames(self, q: Array) -> list[tuple[Array, Array, Array]]:
        """Return (rotation (…, 3, 3), origin (…, 3), joint axis (…, 3)) of every link, and of the ground last."""
        ground = np.broadcast_to(np.eye(3), (*q.shape[:-1], 3, 3)), np.zeros((*q.shape[:-1], 3)), np.zeros(3)
        frames: list[tuple[Array, Array, Array]] = []
        for i, link in enumerate(self.links):
            R, o, _ = ground if link.parent == GROUND else frames[link.parent]
            origin, R = o + R @ np.array(link.origin), R @ np.array(link.orientation)
            axis, moved = R @ np.array(link.axis), q[..., i] - link.zero
            if link.kind == "hinge":
                frames.append((R @ _rotation(link.axis, moved), origin, axis))
            else:
                frames.append((R, origin + moved[..., None] * axis, axis))
        return [*frames, ground]

    def _point(self, site: Site, frames: list[tuple[Array, Array, Array]]) -> tuple[Array, Array, Array]:
        """Return (p (…, 3), ∂p/∂q (…, n, 3), ∂²p/∂q² (…, n, n, 3)) of a site."""
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
        return p, J, C


def point(name: str, value: Any) -> Point:
    """Return three coordinates [m] from three, or from two in the plane z = 0. Raises `InvalidInput`."""
    array = checks.real(name, value, "m")
    if array.shape not in ((2,), (3,)):
        raise InvalidInput(f"{name} = {checks.brief(value)} has to be two or three coordinates [m]")
    return tuple(np.resize([*array.tolist(), 0.0], 3).tolist())


def _path(name: str, path: Sequence[Any], n: int) -> tuple[Site, ...]:
    if len(path) < 2:
        raise InvalidInput(f"{name} has {len(path)} sites; a muscle runs through two or more")
    sites = []
    for link, position in path:
        if not GROUND <= link < n:
            raise InvalidInput(f"{name} runs through link {link}; expected -1 (the ground) to {n - 1}")
        sites.append(Site(int(link), point(f"{name}: position", position)))
    return tuple(sites)


def _rotation(axis: Point, angle: Array) -> Array:
    """Return the rotation matrices (…, 3, 3) about a unit `axis` by `angle` (…) [rad] (Rodrigues)."""
    x, y, z = axis
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    s, c = np.sin(angle)[..., None, None], np.cos(angle)[..., None, None]
    return np.asarray(np.eye(3) + s * W + (1 - c) * (W @ W))


__all__ = ["GROUND", "Link", "Site", "Sites", "point"]
