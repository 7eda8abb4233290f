"""Compiled feed-forward of an arm, with the same results as the readable one.

Targets of a hand become targets of the joints, if the hand has as many coordinates as there are joints. With J(q)
square, K_x = J⁻ᵀ K J⁻¹ is linear in the joints' stiffness, and so is E = S K Sᵀ, S = K_x*^(-1/2) J⁻ᵀ, which is 1 at the
target stiffness: the error that `allocate` minimises with an `endpoint`.

`addresses` and `allocating` let the compiled step call the allocation of many targets, and its proof.
"""

from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple, Self

import numpy as np
from numba import typeof, types

from allocator.allocation.box import pivoting
from allocator.allocation.box.kernel.data import workspace
from allocator.calculus import Array
from allocator.joint.limits import BINDS
from allocator.mechanism.endpoint.targets import EndpointTargets
from mpc.codegen.addresses import described, described_at
from mpc.codegen.views import flat, in_python, length_of
from mpc.model.arm.model import Arm
from mpc.tracking.compiled.arm.module import feeds_forward
from mpc.tracking.compiled.arm.records import ArmInverse, ArmTargets
from mpc.tracking.compiled.module import CompiledPlant
from mpc.tracking.compiled.qp_step import CompiledFeedForward
from mpc.tracking.compiled.sample.arrays import Allocating, Feeding
from mpc.tracking.compiled.sample.calls import address_of, caller
from mpc.tracking.feedforward import FeedForward, FeedForwardOf, InverseDynamics

LEVELS = 2  # torques before stiffness

_ROWS, _SIGNS, _PLACES = np.zeros((1, 1)), np.zeros((1, 1), np.int8), np.zeros(1, np.int64)
_TARGETS = _ROWS[None], _ROWS, np.zeros(1, np.bool_), _PLACES, _ROWS, _ROWS, _ROWS, _PLACES
_MU, _WORK = _ROWS[None], workspace(1, 1, LEVELS)
_KINDS: dict[str, tuple[Any, ...]] = {
    name: tuple(map(typeof, (*_TARGETS, *others)))
    for name, others in {
        "allocate_batch": (True, _ROWS, _SIGNS, _MU, _PLACES, _WORK),
        "residual_batch": (_ROWS, _MU, 0.0, 0.0, np.zeros(1), np.zeros(1, np.bool_), _WORK),
    }.items()
}  # of the arguments in `allocator.allocation.box.kernel.batch`

allocate_at, prove_at = (caller(kinds, types.none) for kinds in _KINDS.values())
allocation_at, proof_at = map(described_at, _KINDS.values())


@cache
def addresses() -> tuple[int, int] | None:
    """Return the addresses for `allocate_at` and `prove_at`, or None if the allocation cannot be compiled."""
    loops: dict[str, Any] = {name: pivoting.loop(name) for name in _KINDS}
    if not all(hasattr(loop, "overloads") for loop in loops.values()):  # plain Python
        return None
    one, other = (address_of(loops[name], kinds, types.none) for name, kinds in _KINDS.items())
    return one, other


def allocating(flat: Array, t: ArmTargets, of_hand: bool) -> Allocating:
    """Return the allocation of the targets `t`, which are views into `flat`, or of those for a hand."""
    functions = addresses()
    assert functions is not None  # otherwise the feed-forward is not compiled
    samples, p, m = t.A.shape
    side, rounds, work = np.zeros((samples, m + p), np.int8), np.zeros(samples, np.int64), workspace(p, m, LEVELS)
    onesided, ends, held = np.zeros(p, np.bool_), np.array([t.T.size, p]), np.empty(p + m, np.bool_)
    by_row = *((t.hand_A, t.hand_b) if of_hand else (t.A, t.b)), t.lo, t.hi, np.zeros((samples, m)), np.arange(samples)
    mu, words = np.empty((samples, LEVELS + 1, p)), []
    for rows in (1, samples):
        A, b, *box = (array[:rows] for array in by_row)
        problem, P, multipliers = (A, b, onesided, ends, *box), t.P[:rows], mu[:rows]
        words.append(described(*problem, True, P, side[:rows], multipliers, rounds[:rows], work))
        words.append(described(*problem, P, multipliers, 0.0, BINDS, t.residual[:rows], held, work))
    (one, prove_one, every, prove_every), (allocate, prove) = (word.ctypes.data for word in words), functions
    calls = allocate, one, every, prove, prove_one, prove_every
    return Allocating(flat, side.ravel(), rounds, calls, (words, by_row, mu, onesided, ends, held, work))


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
        regulators, (left, right) = (readable.alpha[0], readable.lags[0]), arm.angle_limits
        inverse = ArmInverse(*regulators, most, low, high, readable.min_force, np.array(left), np.array(right))
        module, of_hand = self.plant.step, arm.endpoint is not None
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
