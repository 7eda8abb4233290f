"""Endpoint stiffness as a target: a linear image of the joint stiffness, so the problem keeps its form.

With K = K_q + Γ(f) and the G with J G = 1 and the least K_x = Gᵀ K G, the target of the hand is

    E = S K Sᵀ = 1,     S = K_x*^(-1/2) Gᵀ;     its error ‖E - 1‖_F = ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F

which is independent of units and directions of the hand. A square J has one G, its inverse. With more joints than
coordinates G follows from K (`lifted`), see `allocator.allocation.box.pivoting`. Then near a K with this G

    E(K') = S K' Sᵀ - YᵀY,     Y = (Nᵀ K N)^(-1/2) Nᵀ K' Sᵀ = 0 at K,     N a basis of the null space of J,

to second order. Of a hand too soft, Z = W (1 - E) ⪰ 0, YᵀY adds 2 ⟨Z, YᵀY⟩ = ‖√2 Y Z^(1/2)‖² to the weighted squared
error: as rows beside those of S K' Sᵀ they make a step of Gauss and Newton one of Newton.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.mechanism.endpoint.endpoint import Endpoint, Place, inverses, lifted, load_of, stiffness_of, torque_of
from allocator.mechanism.mechanism import TargetsMap

_CURVED = 1e-6  # of E, which is near 1: a hand that misses less is met, without curvature


@dataclass(frozen=True, eq=False)
class EndpointTargets:
    """N stiffness targets of an endpoint, or one at one posture: every array has N rows or 1."""

    endpoint: Endpoint
    place: Place
    force: Array  # f (N, dim) [N]
    asked: Array  # K_x* (N, dim, dim) [N/m]; a diagonal if only that is given
    lift: Array  # G (N, n, dim)
    near: Array | None = None  # K (N, n, n) of which G is the lift, 0 for targets without curvature

    @classmethod
    def at(cls, endpoint: Endpoint, q: Array, force: Array, asked: Array) -> Self:
        """Return the targets at the postures `q` (N or 1, n). Raises `InvalidInput` where J is singular."""
        place = endpoint.at(q)
        endpoint.check_rank(place)
        return cls(endpoint, place, force, asked, inverses(place)[0])

    @property
    def redundant(self) -> bool:
        """Whether there are more joints than coordinates."""
        return self.endpoint.n > self.endpoint.dim

    @property
    def load(self) -> Array:
        """Γ(f) (N, n, n) [N·m/rad]."""
        return load_of(self.place, self.force)

    @property
    def torque(self) -> Array:
        """Jᵀf (N, n) [N·m], in equilibrium with the hand's force."""
        return torque_of(self.place, self.force)

    @cached_property
    def _root(self) -> Array:
        """K_x*^(-1/2) (N, dim, dim)."""
        size, axes = np.linalg.eigh(self.asked)
        return np.asarray((axes / np.sqrt(size)[:, None, :]) @ axes.swapaxes(-1, -2))

    @cached_property
    def view(self) -> Array:
        """S (N, dim, n)."""
        return np.asarray(self._root @ self.lift.swapaxes(-1, -2))

    @cached_property
    def _linear(self) -> tuple[Array, Array]:
        """(L (N, e, k), c (N, e)): E = L K_q + c, for upper triangles of symmetric matrices."""
        out = np.triu_indices(self.endpoint.dim)
        L, c = self._between(self.view, self.view)
        return L[(slice(None), *out)], c[(slice(None), *out)]

    def _between(self, left: Array, right: Array) -> tuple[Array, Array]:
        """Return (L (N, a, b, k), c (N, a, b)): left (K_q + Γ) rightᵀ = L K_q + c, of the upper triangle of K_q."""
        n = self.endpoint.n
        rows, columns = np.triu_indices(n)
        units = np.zeros((rows.size, n, n))
        units[np.arange(rows.size), rows, columns] = units[np.arange(rows.size), columns, rows] = 1.0
        L = left[:, None] @ units @ right[:, None].swapaxes(-1, -2)
        return np.moveaxis(L, 1, -1), left @ self.load @ right.swapaxes(-1, -2)

    def curvature(self, given: TargetsMap, near: Array, weights: Array) -> TargetsMap:
        """Return the map of √2 Y Z^(1/2) (N, c) `near` K, from that of (τ, K_q), for `weights` (e,) of E."""
        unseen, out = inverses(self.place)[1], np.triu_indices(self.endpoint.dim)
        short = np.eye(self.endpoint.dim) - self.view @ near @ self.view.swapaxes(-1, -2)
        size, axes = np.linalg.eigh(self._dual(weights * short[(slice(None), *out)]))
        root = axes * np.sqrt(np.where(size > _CURVED, 2 * size, 0.0))[:, None, :]
        own, across = np.linalg.eigh(unseen.swapaxes(-1, -2) @ near @ unseen)
        left = (unseen @ across / np.sqrt(np.where(own > 0, own, np.inf))[:, None, :]).swapaxes(-1, -2)
        L, c = self._between(left, root.swapaxes(-1, -2) @ self.view)
        L, c = L.reshape(len(L), -1, L.shape[-1]), c.reshape(len(c), -1)
        K0, M = (part[:, self.endpoint.n :] for part in given)
        return TargetsMap((L @ K0[:, :, None])[:, :, 0] + c, L @ M)

    def of(self, given: TargetsMap) -> TargetsMap:
        """Return the map of (τ, E) from that of (τ, K_q)."""
        n, (L, c) = self.endpoint.n, self._linear
        E0 = (L @ given.y0[:, n:, None])[..., 0] + c
        y0 = np.broadcast_to(given.y0[:, :n], (len(E0), n))
        torque, stiffness = (np.broadcast_to(M, (len(E0), *M.shape[1:])) for M in (given.M[:, :n], L @ given.M[:, n:]))
        return TargetsMap(np.concatenate([y0, E0], axis=1), np.concatenate([torque, stiffness], axis=1))

    def on_joints(self, d: Array) -> tuple[Array, Array]:
        """Return (d' (N, …), b (N)) with d·(τ, E) = d'·(τ, K_q) + b for directions `d` (N, …)."""
        n, (L, c) = self.endpoint.n, self._linear
        K = (d[:, n:, None] * L).sum(axis=1)
        return np.concatenate([d[:, :n], K], axis=1), (d[:, n:] * c).sum(axis=1)

    def bounds_true(self, d: Array) -> Mask:
        """Return (N) whether d·(τ, E) with this G is never less than with the true one: that of E is ⪰ 0."""
        size = np.linalg.eigvalsh(self._dual(d[:, self.endpoint.n :]))
        return np.asarray((size[:, 0] >= -1e-12 * np.abs(size).max(axis=1)) | (not self.redundant))

    def _dual(self, weights: Array) -> Array:
        """Return the symmetric Z (N, dim, dim) with ⟨Z, E⟩ = weights·E, for weights (N, e) of the upper triangle."""
        rows, columns = np.triu_indices(self.endpoint.dim)
        Z = np.zeros((len(weights), self.endpoint.dim, self.endpoint.dim))
        Z[:, rows, columns] = Z[:, columns, rows] = weights * np.where(rows == columns, 1.0, 0.5)
        return Z

    def stiffness(self, K_q: Array) -> Array:
        """Return K_x (N, dim, dim) [N/m] of joint stiffnesses (N, n, n)."""
        return stiffness_of(self.place, K_q + self.load)

    def seen(self, K_q: Array) -> Array:
        """Return the upper triangle of K_x*^(-1/2) K_x K_x*^(-1/2) (N, e) of joint stiffnesses (N, n, n)."""
        root = self._root
        return np.asarray((root @ self.stiffness(K_q) @ root)[(..., *np.triu_indices(self.endpoint.dim))])

    def relifted(self, K_q: Array, curved: Mask) -> tuple[Self, Array]:
        """Return the targets near joint stiffnesses (N, n, n), with their G, and the resulting change of E (N).

        The `curved` ones (N) also have their curvature. If the joints are unstable in the null space of J, G is
        unchanged and the change infinite.
        """
        K = K_q + self.load
        G = lifted(self.place, K)
        found = np.asarray(np.isfinite(G).all(axis=(1, 2)))
        G = np.where(found[:, None, None], G, self.lift)
        new = replace(self, lift=G, near=np.where(curved[:, None, None], K, 0.0) if curved.any() else None)
        E_old, E_new = (t.view @ K @ t.view.swapaxes(-1, -2) for t in (self, new))
        return new, np.where(found, np.abs(E_new - E_old).max(axis=(1, 2)), np.inf)
