"""Muscles that run straight between points on links, with closed first and second derivatives of their lengths.

A segment between the points p_o and p_i of two links has D = p_i - p_o, u = D/|D| and J = ∂D/∂q; with it

    r = -Jᵀu,      H = (JᵀJ - Jᵀu uᵀJ)/|D| + Σ_c u_c ∂²D_c/∂q²          (several segments add up)

The derivatives of the points are those of `allocator.mechanism.routes.linkage`. A joint that moves both ends of a
segment leaves its length alone: there r and H are exactly 0.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import SX
from allocator.mechanism.routes.base import (
    RoutedLengths,
    Routes,
    check_arms,
    check_lengths,
    per_muscle,
    rest_lengths,
)
from allocator.mechanism.routes.linkage import Link, Linkage, Site

Path = Sequence[tuple[int, ArrayLike]]
"""Where a muscle runs: (link, position on it [m]), site after site."""

_COINCIDE = 1e-9  # [m]
_SOMEWHERE = 0.3  # [rad] or [m] per joint: a generic posture, which reveals structural zeros


@dataclass(frozen=True)
class Sites(Routes):
    """Routes along straight segments between points on links."""

    links: tuple[Link, ...]
    paths: tuple[tuple[Site, ...], ...]  # the sites of each of m muscles, in order
    cable: tuple[float, ...]  # (m,) length of cable in the path [m]

    def __init__(self, rest_length: object, links: Sequence[Link], paths: Sequence[Path], cable: object = 0.0) -> None:
        """Check and keep `links` (n) and `paths` (m), of pairs (link, position [m]); the rest are numbers or rows (m,).

        The muscle's length is that of its path less `cable` [m]. Raises `InvalidInput`.
        """
        n, m = len(links), len(paths)
        if not n or not m:
            raise InvalidInput(f"Sites: n = {n} links and m = {m} paths; expected one or more of both")
        linkage = Linkage(links)
        object.__setattr__(self, "links", linkage.links)
        checked = tuple(_path(f"Sites: path {j}", path, linkage) for j, path in enumerate(paths))
        object.__setattr__(self, "paths", checked)
        object.__setattr__(self, "rest_length", rest_lengths("Sites", rest_length, m))
        object.__setattr__(self, "cable", tuple(per_muscle("Sites: cable", cable, m, "m").tolist()))
        somewhere = self.at(_SOMEWHERE * np.arange(1.0, n + 1) / n)
        check_arms("Sites", somewhere.arm)
        check_lengths("Sites", somewhere.length)

    @property
    def n(self) -> int:
        """Number of joints, one a link."""
        return len(self.links)

    @cached_property
    def linkage(self) -> Linkage:
        """Motion of the sites."""
        return Linkage(self.links)

    @cached_property
    def _bending(self) -> list[list[Array]]:
        """Whether each joint (n,) moves one end of each segment of each path alone."""
        moved = np.zeros((self.n + 1, self.n))  # by link, the ground last: its joints
        for i, link in enumerate(self.links):
            moved[i] = moved[link.parent]
            moved[i, i] = 1.0
        return [[np.abs(moved[a.link] - moved[b.link]) for a, b in pairwise(path)] for path in self.paths]

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends at the postures `q` (…, n). Raises `InvalidInput` if two sites coincide."""
        frames = self.linkage.frames(q)
        length, arm, bend = (np.zeros((*q.shape[:-1], self.m, *(self.n,) * order)) for order in (0, 1, 2))
        length -= np.array(self.cable)
        for j, path in enumerate(self.paths):
            points = [self.linkage.point(site, frames) for site in path]
            for (start, end), bends in zip(pairwise(points), self._bending[j], strict=True):
                D, J, C = (b - a for a, b in zip(start, end, strict=True))
                distance = np.sqrt((D * D).sum(-1))
                if not (distance > _COINCIDE).all():
                    raise InvalidInput(f"Sites: two neighbouring sites of muscle {j + 1} meet at one of the postures")
                u = D / distance[..., None]
                Ju = bends[:, None] * (J @ u[..., None])  # (…, n, 1)
                length[..., j] += distance
                arm[..., j, :] -= Ju[..., 0]
                straight = (J @ J.swapaxes(-1, -2) - Ju @ Ju.swapaxes(-1, -2)) / distance[..., None, None]
                bend[..., j, :, :] += np.outer(bends, bends) * (straight + (C @ u[..., None, :, None])[..., 0])
        return RoutedLengths(length, arm, bend)

    def symbolic(self, q: "SX") -> Sequence["SX | float"]:
        """Return the lengths of the segments of each path, less the cable, of a CasADi column `q` (n, 1)."""
        import casadi as ca

        frames, found = self.linkage.symbolic_frames(q), []
        for path, cable in zip(self.paths, self.cable, strict=True):
            points = [frames[site.link][1] + frames[site.link][0] @ ca.DM(site.position) for site in path]
            found.append(sum(ca.norm_2(end - start) for start, end in pairwise(points)) - cable)
        return found

    def positions(self, q: Array) -> list[Array]:
        """Return the positions of each muscle's sites at the postures `q` (…, n): m arrays (…, sites, 3) [m]."""
        frames = self.linkage.frames(np.asarray(q, float))
        return [np.stack([self.linkage.point(site, frames)[0] for site in path], axis=-2) for path in self.paths]


def _path(name: str, path: Path, linkage: Linkage) -> tuple[Site, ...]:
    if len(path) < 2:
        raise InvalidInput(f"{name} has {len(path)} sites; a muscle runs through two or more")
    return tuple(linkage.site(f"{name} runs through", link, position) for link, position in path)
