"""Compiled feed-forward of an arm, with the same results as the readable one.

Targets of a hand become targets of the joints, if the hand has as many coordinates as there are joints. With J(q)
square, K_x = J⁻ᵀ K J⁻¹ is linear in the joints' stiffness, and so is E = S K Sᵀ, S = K_x*^(-1/2) J⁻ᵀ, which is 1 at the
target stiffness: the error that `allocate` minimises with an `endpoint`.
"""

from copy import deepcopy
from typing import NamedTuple, Self

import numpy as np

from allocator.allocation.box import pivoting
from allocator.allocation.box.kernel.data import workspace
from allocator.calculus import Array
from allocator.joint.limits import BINDS
from allocator.mechanism.endpoint.targets import EndpointTargets
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import CompiledArm
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.plan import Moved

_SURE = 1e-9  # residual of optimality up to which an allocation is accepted


class HandTargets(NamedTuple):
    """Targets of a hand at N+1 samples; svecs are those of the joints' stiffness."""

    to_hand: Array  # J⁻¹ (N+1, n, n)
    asked: Array  # K_x* (N+1, n, n) [N/m]
    rows: Array  # (N+1, e, e): svec K ↦ svec E

    @classmethod
    def at(cls, arm: Arm, q: Array, K: Array) -> Self:
        """Return the targets `K` (N+1, n, n) [N/m] at `q` (N+1, n), which is moved to within the ranges.

        Raises `InvalidInput` at singular configurations of the hand.
        """
        assert arm.endpoint is not None
        q = np.clip(q, *arm.angle_limits)
        targets = EndpointTargets.at(arm.endpoint, q, np.zeros((1, arm.n)), K)
        rows, columns = np.triu_indices(arm.n)
        pairs = np.stack([rows, columns], axis=-1)
        S = targets.view
        one, other = S[:, rows][:, :, rows], S[:, columns][:, :, columns]  # S_ac S_bd + S_ad S_bc of ab and cd
        crossed = S[:, rows][:, :, columns] * S[:, columns][:, :, rows]
        factors = np.where(pairs[:, 0] == pairs[:, 1], 1.0, np.sqrt(2))
        L = (one * other + crossed) * factors[:, None] * factors / 2
        return cls(targets.lift, K, L)

    @property
    def joint_stiffness(self) -> Array:
        """Target stiffness Jᵀ K_x* J (N+1, n, n) [N·m/rad] of the joints."""
        J = np.linalg.inv(self.to_hand)
        return np.asarray(J.swapaxes(-1, -2) @ self.asked @ J)

    def turned(self, A: Array, b: Array) -> tuple[Array, Array]:
        """Return the rows `A` (N+1, n + e, m), `b` (N+1, n + e) of (τ, svec K) as those of (τ, svec E)."""
        n = self.asked.shape[-1]
        A, b = A.copy(), b.copy()
        A[:, n:], b[:, n:] = self.rows @ A[:, n:], (self.rows @ b[:, n:, None])[..., 0]
        return A, b

    def seen(self, svec: Array) -> Array:
        """Return K_x (N+1, n, n) [N/m] of svec K (N+1, e)."""
        n = self.asked.shape[-1]
        rows, columns = np.triu_indices(n)
        K = np.empty((len(svec), n, n))
        K[:, rows, columns] = K[:, columns, rows] = svec / np.where(rows == columns, 1.0, np.sqrt(2))
        G = self.to_hand
        return np.asarray(G.swapaxes(-1, -2) @ K @ G)


class CompiledArmFeedForward:
    """Compiled `mpc.tracking.feedforward.InverseDynamics`; the readable one is used if the kernel is not sure."""

    def __init__(self, arm: Arm, made: CompiledArm, readable: InverseDynamics) -> None:
        rows, n, m = len(readable.slopes[0]), arm.n, arm.m
        self._arm, self._stiffnesses = arm, n * (n + 1) // 2
        self._readable, self._compiled, self._c = readable, made.feed_forward, made.c
        d = n + self._stiffnesses
        low, high = arm.mechanism.pressure_limits
        most = [min(muscle.max_pressure, high) for muscle in arm.mechanism.muscles]
        self._limits = *map(np.ascontiguousarray, readable.slopes), np.array(arm.angle_limits)
        self._supply, self._unit = np.array([*most, low, high, readable.min_force]), high
        self._T, self._A, self._b = np.zeros((rows, n)), np.zeros((rows, d, m)), np.zeros((rows, d))
        self._box = np.zeros((rows, m)), np.zeros((rows, m)), np.zeros((rows, m))
        self._rows_are = np.zeros(d, np.bool_), np.array([n, d])  # not one-sided; the ends of the levels
        self._which = np.arange(rows)
        self._found = (
            np.zeros((rows, m)),
            np.zeros((rows, m + d), np.int8),
            np.zeros((rows, 3, d)),
            np.zeros(rows, np.int64),
        )
        self._residual, self._memory = np.zeros(rows), (np.empty(d + m, np.bool_), workspace(d, m, 2))
        self._sizes = rows, 2 * n + m, n * (n + 1) // 2 + m, m
        self._alpha = readable.alpha

    def __deepcopy__(self, memo: dict[int, object]) -> "CompiledArmFeedForward":
        """Return a copy with its own buffers."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        for name in ("_T", "_A", "_b", "_residual"):
            setattr(other, name, getattr(self, name).copy())
        other._memory = deepcopy(self._memory)
        other._box, other._found = tuple(a.copy() for a in self._box), tuple(a.copy() for a in self._found)  # type: ignore[assignment]
        return other

    def __call__(self, q: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for previews `q` (N+1, n) [rad], `K` (N+1, k, k), and torques `d` (N+1, n) [N·m]."""
        samples, size, outputs, m = self._sizes
        given, hand = (q, K, d), None
        rows = 1 if self._compiled.still(q, K, d) else samples  # to allocate
        q, K, d = q[:rows], K[:rows], d[:rows]
        asked_K = K
        if self._arm.endpoint is not None:
            hand = HandTargets.at(self._arm, q, K)
            K = hand.joint_stiffness
        x, y, u = np.empty((samples, size)), np.zeros((samples, outputs)), np.empty((samples - 1, m))
        lo, hi, centre = self._box
        problem = self._A[:rows], self._b[:rows], *self._rows_are, lo, hi, centre, self._which[:rows]
        asked = self._c, *self._limits, self._supply, q, K, d
        if not self._compiled.targets(*asked, x, self._T, self._A, self._b, lo, hi):
            return self._readable(*given)
        straight = problem[:2]
        if hand is not None:
            problem = *hand.turned(*straight), *problem[2:]
        found, side, mu, rounds = self._found
        side[0] = 0
        held, work = self._memory
        pivoting.loop("allocate_batch")(*problem, True, found, side, mu, rounds, work)
        pivoting.loop("residual_batch")(*problem, found, mu, 0.0, BINDS, self._residual, held, work)
        if not (rounds[:rows].all() and self._residual[:rows].max() <= _SURE):
            return self._readable(*given)
        moved = Moved(*self._compiled.follow(self._alpha, self._unit, q, *straight, found, K, x, y, u))
        if hand is not None:
            K_x = hand.seen(y[:, : self._stiffnesses])
            y[:, : self._stiffnesses] = self._arm.svec(K_x)
            moved = moved._replace(K=float(np.abs(asked_K - K_x).max()))
        return FeedForward(x, y, u, moved)
