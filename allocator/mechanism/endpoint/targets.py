"""Endpoint stiffness as a target: a linear image of the joint stiffness, so the problem keeps its form.

With K = K_q + Γ(f) and the G with J G = 1 and the least K_x = Gᵀ K G, the target of the hand is

    E = S K Sᵀ = 1,     S = K_x*^(-1/2) Gᵀ;     its error ‖E - 1‖_F = ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F

which is independent of units and directions of the hand. A square J has one G, its inverse. With more joints than
coordinates G follows from K (`lifted`), see `allocator.allocation.box.pivoting`.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.mechanism.endpoint.endpoint import Endpoint, Place, inverses, lifted, load_of, stiffness_of, torque_of
from allocator.mechanism.mechanism import TargetsMap


@dataclass(frozen=True, eq=False)
class EndpointTargets:
    """N stiffness targets of an endpoint, or one at one posture: every array has N rows or 1."""

    endpoint: Endpoint
    place: Place
    force: Array  # f (N, dim) [N]
    asked: Array  # K_x* (N, dim, dim) [N/m]; a diagonal if only that is given
    lift: Array  # G (N, n, dim)

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
        n, dim = self.endpoint.n, self.endpoint.dim
        rows, columns = np.triu_indices(n)
        units = np.zeros((rows.size, n, n))
        units[np.arange(rows.size), rows, columns] = units[np.arange(rows.size), columns, rows] = 1.0
        S, out = self.view[:, None], (..., *np.triu_indices(dim))
        L = (S @ units @ S.swapaxes(-1, -2))[out].swapaxes(-1, -2)
        return L, (self.view @ self.load @ self.view.swapaxes(-1, -2))[out]

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
        dim = self.endpoint.dim
        rows, columns = np.triu_indices(dim)
        Z = np.zeros((len(d), dim, dim))
        Z[:, rows, columns] = Z[:, columns, rows] = d[:, self.endpoint.n :] * np.where(rows == columns, 1.0, 0.5)
        size = np.linalg.eigvalsh(Z)
        return np.asarray((size[:, 0] >= -1e-12 * np.abs(size).max(axis=1)) | (not self.redundant))

    def stiffness(self, K_q: Array) -> Array:
        """Return K_x (N, dim, dim) [N/m] of joint stiffnesses (N, n, n)."""
        return stiffness_of(self.place, K_q + self.load)

    def seen(self, K_q: Array) -> Array:
        """Return the upper triangle of K_x*^(-1/2) K_x K_x*^(-1/2) (N, e) of joint stiffnesses (N, n, n)."""
        root = self._root
        return np.asarray((root @ self.stiffness(K_q) @ root)[(..., *np.triu_indices(self.endpoint.dim))])

    def relifted(self, K_q: Array) -> tuple[Self, Array]:
        """Return the targets with the G of joint stiffnesses (N, n, n), and the resulting change of E (N).

        If the joints are unstable in the null space of J, G is unchanged and the change infinite.
        """
        K = K_q + self.load
        G = lifted(self.place, K)
        found = np.asarray(np.isfinite(G).all(axis=(1, 2)))
        G = np.where(found[:, None, None], G, self.lift)
        new = replace(self, lift=G)
        E_old, E_new = (t.view @ K @ t.view.swapaxes(-1, -2) for t in (self, new))
        return new, np.where(found, np.abs(E_new - E_old).max(axis=(1, 2)), np.inf)
