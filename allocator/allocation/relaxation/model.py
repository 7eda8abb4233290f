"""Problem in the muscles' forces and own stiffnesses, linear except for one curve per muscle.

With v = (F_1, k_1, …, F_m, k_m), y = C v: column 2j of C is (r_j ; H_j), column 2j + 1 is (0 ; r_j r_jᵀ). Only v(P)
depends on the muscles' laws.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.relaxation.curves import Curve, Level, not_rising
from allocator.calculus import Array
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism.mechanism import Indices

_LOOKED_AT = 33  # pressures at which rising forces are checked


@dataclass(frozen=True, eq=False)
class Model:
    """`BoxProblem` whose muscles are curves; targets are chosen by their indices `which` (S,)."""

    problem: BoxProblem

    @cached_property
    def C(self) -> Array:
        """y = C v (Q, d, 2m)."""
        rows, columns = self.problem.mechanism.upper_triangle
        found = []
        for side in self.problem.muscles:
            outer = side.arm[..., :, None] * side.arm[..., None, :]
            found.append(np.concatenate([side.arm, side.bend[..., rows, columns]], axis=-1))
            found.append(np.concatenate([0.0 * side.arm, outer[..., rows, columns]], axis=-1))
        return np.stack(found, axis=-1)

    @cached_property
    def root_weights(self) -> Array:
        """Roots of the weights of the rows (p,)."""
        return np.asarray(np.sqrt(self.problem.weights[self.problem.rows[0]]))

    @cached_property
    def weighted(self) -> Array:
        """Weighted rows of C, in the order of the levels (Q, p, 2m)."""
        return np.asarray(self.root_weights[:, None] * self.C[:, self.problem.rows[0]])

    @cached_property
    def asked(self) -> Array:
        """Weighted targets (N, p)."""
        return np.asarray(self.root_weights * self.problem.y[:, self.problem.rows[0]])

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """Least and greatest pressures (N, m) [Pa]."""
        return self.problem.bounds

    @cached_property
    def force_bounds(self) -> tuple[Array, Array]:
        """Least and greatest forces (N, m) [N]."""
        lo, hi = self.bounds
        every = np.arange(self.problem.size)
        return self.forces(every, lo), self.forces(every, hi)

    @cached_property
    def reference(self) -> Array:
        """Reference pressures P_ref (N, m) [Pa]."""
        return np.broadcast_to(self.problem.reference, self.bounds[0].shape)

    @cached_property
    def scale(self) -> Array:
        """Scale of large weighted errors of each level (N, K)."""
        every = np.arange(self.problem.size)
        size = np.abs(self.product(np.abs(self.weighted), every, np.abs(self.states(every, self.bounds[1]))))
        size += np.abs(self.asked)
        return np.maximum.reduceat(size, [0, *self.problem.rows[1][:-1].tolist()], axis=1)

    def check(self) -> None:
        """Raise `InvalidInput` unless forces rise with the pressure at sampled pressures."""
        lo, hi = self.bounds
        every = np.arange(self.problem.size)
        for share in np.linspace(0.0, 1.0, _LOOKED_AT):
            falls = (self.force_gains(every, lo + share * (hi - lo)) <= 0) & (lo < hi)
            if falls.any():
                i, j = np.argwhere(falls)[0]
                raise not_rising(self.problem.muscles[j], float(lo[i, j]), float(hi[i, j]))

    def posture(self, which: Indices) -> Indices:
        """Return the index of each target's posture."""
        return np.asarray(self.problem.which[which])

    def _each(self, name: str, which: Indices, P: Array) -> Array:
        """Return the values of the method `name` of every muscle at pressures (S, m)."""
        found = np.empty(P.shape)
        for j, side in enumerate(self._held(self.posture(which))):
            found[:, j] = getattr(side, name)(P[:, j])
        return found

    def _held(self, at: Indices) -> tuple[OneMuscle, ...]:
        """Return the muscles at these postures (S,), or at the single one."""
        if len(self.C) == 1:
            return self.problem.muscles
        if len(at) > 1:
            return tuple(side.moved(*(array[at] for array in side.arrays)) for side in self.problem.muscles)
        if int(at[0]) not in self._alone:
            self._alone.clear()
            self._alone[int(at[0])] = tuple(side.moved(*(a[at] for a in side.arrays)) for side in self.problem.muscles)
        return self._alone[int(at[0])]

    @cached_property
    def _alone(self) -> dict[int, tuple[OneMuscle, ...]]:
        """Muscles at the last posture, where a search stays."""
        return {}

    def forces(self, which: Indices, P: Array) -> Array:
        """Return F (S, m) [N]."""
        return self._each("force", which, P)

    def force_gains(self, which: Indices, P: Array) -> Array:
        """Return dF/dP (S, m) [N/Pa]."""
        return self._each("force_gain", which, P)

    def states(self, which: Indices, P: Array) -> Array:
        """Return v (S, 2m) at pressures (S, m)."""
        return _interleaved(self.forces(which, P), self._each("own_stiffness", which, P))

    def state_gains(self, which: Indices, P: Array) -> Array:
        """Return the derivatives (S, 2m) of the components of v by the muscles' own pressures."""
        return _interleaved(self.force_gains(which, P), self._each("own_stiffness_gain", which, P))

    def given(self, P: Array) -> Array:
        """Return y (N, d) of all targets at their pressures (N, m)."""
        every = np.arange(self.problem.size)
        return self.product(self.C, every, self.states(every, P))

    def product(self, matrices: Array, which: Indices, v: Array) -> Array:
        """Return matrices · v, of the targets' own postures: (Q, p, 2m) and (S, 2m) to (S, p)."""
        if len(matrices) == 1:
            return np.asarray(v @ matrices[0].T)
        return np.asarray((matrices[self.posture(which)] @ v[:, :, None])[:, :, 0])

    def left(self, which: Indices, v: Array) -> Array:
        """Return the weighted errors C v - y* (S, p), in the order of the levels."""
        return self.product(self.weighted, which, v) - self.asked[which]

    @cached_property
    def curves(self) -> tuple[tuple[Curve, ...], ...]:
        """Curves of all muscles at each posture (Q), between the least and the greatest pressure allowed."""
        lo, hi = self.bounds
        found = []
        for i in range(len(self.C)):
            here = np.flatnonzero(self.problem.which == i)
            low, high = lo[here].min(axis=0), hi[here].max(axis=0)
            sides = [side.moved(side.contraction[i], side.arm[i], side.bend[i]) for side in self.problem.muscles]
            found.append(tuple(Curve.of(*of) for of in zip(sides, low.tolist(), high.tolist(), strict=True)))
        return tuple(found)

    def level(self, target: int, k: int, achieved: Array) -> Level:
        """Return level k of a target, with the weighted values achieved by the earlier levels (p,)."""
        end = [0, *self.problem.rows[1].tolist()]
        rows = self.weighted[int(self.problem.which[target])]
        before, own = slice(0, end[k]), slice(end[k], end[k + 1])
        return Level(rows[own], self.asked[target, own], rows[before], achieved[before])


def _interleaved(first: Array, second: Array) -> Array:
    return np.stack([first, second], axis=-1).reshape(len(first), -1)
