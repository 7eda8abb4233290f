"""What is asked of a hand becomes what is asked of the joints, where it has as many coordinates as there are joints.

With J(q) square, K_x = J⁻ᵀ K J⁻¹ is linear in the joints' stiffness, and so is E = S K Sᵀ, S = K_x*^(-1/2) J⁻ᵀ, which
is 1 where the stiffness is as asked: the error that `allocate` makes least with an `endpoint`.
"""

from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.endpoint.targets import EndpointTargets
from mpc.model.arm.model import Arm


class HandTargets(NamedTuple):
    """`HandTargets` are what is asked of a hand at N+1 samples; svecs are those of the joints' stiffness."""

    to_hand: Array  # J⁻¹ (N+1, n, n)
    asked: Array  # K_x* (N+1, n, n) [N/m]
    rows: Array  # (N+1, e, e): svec K ↦ svec E

    @classmethod
    def at(cls, arm: Arm, q: Array, K: Array) -> Self:
        """Return the targets `K` (N+1, n, n) [N/m] at `q` (N+1, n), moved to within the ranges.

        Raises `InvalidInput` where the hand is singular.
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
        """Return Jᵀ K_x* J (N+1, n, n) [N·m/rad]."""
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
