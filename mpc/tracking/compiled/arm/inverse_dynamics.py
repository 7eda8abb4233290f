"""Compiled feed-forward of an arm, with the same results as the readable one.

Targets of a hand become targets of the joints, if the hand has as many coordinates as there are joints. With J(q)
square, K_x = J⁻ᵀ K J⁻¹ is linear in the joints' stiffness, and so is E = S K Sᵀ, S = K_x*^(-1/2) J⁻ᵀ, which is 1 at the
target stiffness: the error that `allocate` minimises with an `endpoint`.
"""

from dataclasses import replace
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.endpoint.targets import EndpointTargets
from mpc.codegen.views import flat, in_python, length_of
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.allocation import addresses, allocating
from mpc.tracking.compiled.arm.module import feeds_forward
from mpc.tracking.compiled.arm.records import ArmInverse, ArmTargets
from mpc.tracking.compiled.module import CompiledPlant
from mpc.tracking.compiled.qp_step import CompiledFeedForward
from mpc.tracking.compiled.sample.arrays import Feeding
from mpc.tracking.feedforward import FeedForward, FeedForwardOf, InverseDynamics


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

    def seen(self, svec: Array) -> Array:
        """Return K_x (N+1, n, n) [N/m] of svec K (N+1, e)."""
        n = self.asked.shape[-1]
        rows, columns = np.triu_indices(n)
        K = np.empty((len(svec), n, n))
        K[:, rows, columns] = K[:, columns, rows] = svec / np.where(rows == columns, 1.0, np.sqrt(2))
        G = self.to_hand
        return np.asarray(G.swapaxes(-1, -2) @ K @ G)


class CompiledArmFeedForward(CompiledFeedForward):
    """Compiled feed-forward of an arm without a hand."""

    def _feeding(self, readable: InverseDynamics) -> Feeding:
        """Return the arrays of the `readable` feed-forward."""
        arm: Arm = readable.plant
        low, high = arm.mechanism.pressure_limits
        most = np.array([min(muscle.max_pressure, high) for muscle in arm.mechanism.muscles])
        inverse = ArmInverse(readable.alpha, most, low, high, readable.min_force, *map(np.array, arm.angle_limits))
        module, of_hand = self._plant.step, arm.endpoint is not None
        targets = np.zeros(length_of(ArmTargets, len(readable.slopes[0]) - 1, known=module.ARM))
        room = allocating(targets, in_python(module.targets_in)(targets), of_hand)
        return Feeding(flat(inverse), readable.slopes, np.zeros(0), room)


class CompiledHandFeedForward(CompiledArmFeedForward):
    """Compiled feed-forward of an arm whose hand has a target stiffness."""

    whole = False

    def _feeding(self, readable: InverseDynamics) -> Feeding:
        """Return the arrays of the `readable` feed-forward, with room for the rows that turn svec K."""
        rows = readable.plant.stiffnesses
        return super()._feeding(readable)._replace(turned=np.zeros(len(readable.slopes[0]) * rows**2))

    def __call__(self, theta: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for `theta` (N+1, n) [rad], the hand's `K` (N+1, n, n) [N/m], `d` (N+1, n) [N·m]."""
        arm = self.readable.plant
        still = all((array == array[:1]).all() for array in (theta, K, d))
        hand = HandTargets.at(arm, theta[:1] if still else theta, K[:1] if still else K)
        self.arrays.turned[: hand.rows.size] = hand.rows.ravel()
        found = self._found(theta, np.broadcast_to(hand.joint_stiffness, K.shape), d)
        if found is None:
            return self.readable(theta, K, d)
        k = arm.stiffnesses
        K_x = hand.seen(found.y[:, :k])
        found.y[:, :k] = arm.svec(K_x)
        return replace(found, moved=found.moved._replace(K=float(np.abs(K - K_x).max())))


def feed_forward_of(arm: Arm, made: CompiledPlant, readable: InverseDynamics) -> FeedForwardOf:
    """Return the compiled feed-forward, or the `readable` one if there is none or the allocation is not compiled."""
    if not feeds_forward(arm) or addresses() is None:
        return readable.ready()
    return (CompiledArmFeedForward if arm.endpoint is None else CompiledHandFeedForward)(made, readable)
