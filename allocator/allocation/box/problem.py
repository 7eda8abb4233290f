"""The problem of m muscles in a box, which `allocate` solves for a mechanism.

At a posture y(P) = y0 + M P holds torques and stiffnesses of affine muscles (`Mechanism.targets_map`). Over the box
lo_j ≤ P_j ≤ hi_j that supply, taut cables, force and slew limits leave each muscle,

    priority "torque":     minimise Σ w_i (τ_i - τ_i*)²,  then Σ w_ij (K_ij - K_ij*)²,  then ‖P - P_ref‖²         [M]
    priority "stiffness":  the first two in the other order
    priority "weighted":   minimise both sums together,  then ‖P - P_ref‖²

    with a third weight: minimise w_P ‖P - P_ref‖² together with them

where the values achieved first are equality constraints for the rest. The sum over K has all n² entries (with equal
weights the Frobenius norm); entries of weight 0 are free. P_ref is 0 or the previous pressures. Of an endpoint E - 1
stands for K - K* (`allocator.mechanism.endpoint.targets`). The hysteresis K_h of each joint that a push meets is added
to the diagonal of K (S3).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import CLOSED_FORM, Priority
from allocator.calculus import Array, Mask
from allocator.joint.gas import HELD, StiffnessKind
from allocator.joint.limits import Limits, PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism.endpoint.targets import EndpointTargets
from allocator.mechanism.mechanism import Indices, Mechanism, TargetsMap

_STRETCHED = 1e-9  # of the contraction ratio: nearer to the threshold counts as on it


@dataclass(frozen=True, eq=False)
class BoxProblem:
    """N problems [M] of one mechanism, at N postures or all at one: Q is N or 1."""

    mechanism: Mechanism
    asked: Array  # requested posture (Q, n) [rad]
    y: Array  # targets (N, d), in the order of a `TargetsMap`
    weights: Array  # of the squared errors (d,), that of an entry beside the diagonal counted twice
    priority: Priority
    limits: tuple[Limits, ...]  # of each muscle (m)
    reference: Array  # P_ref (N or 1, m) [Pa]
    kind: StiffnessKind = HELD  # which stiffness K is
    endpoint: EndpointTargets | None = None  # if y holds its E instead of K
    added: Array | None = None  # K_h of each joint in K (n,) [N·m/rad]
    pull: float = 0.0  # weight of ‖(P - P_ref)/unit‖² among the targets; 0 if it comes after them

    @property
    def size(self) -> int:
        """N."""
        return len(self.y)

    @cached_property
    def q(self) -> Array:
        """Postures solved for (Q, n): the requested ones, moved within the angle limits."""
        return self.mechanism.within(self.asked)

    @property
    def outside(self) -> Mask:
        """Which joints are requested beyond their limits (Q, n)."""
        return np.asarray(self.q != self.asked)

    @cached_property
    def muscles(self) -> tuple[OneMuscle, ...]:
        """Muscles at the postures."""
        return self.mechanism.at(self.q, self.kind.fixed)

    @cached_property
    def stretched(self) -> Mask:
        """Which muscles are below the least contraction of their models (Q, m)."""
        eps = np.stack([muscle.contraction for muscle in self.muscles], axis=-1)
        return np.asarray(eps < self.mechanism.min_contraction - _STRETCHED)

    @cached_property
    def map(self) -> TargetsMap:
        """y0 (Q, d) and M (Q, d, m); (N, …) of endpoint stiffnesses that differ."""
        return self.joint_map if self.endpoint is None else self.endpoint.of(self.joint_map)

    @cached_property
    def joint_map(self) -> TargetsMap:
        """The same of the joints' stiffness, also if that of an endpoint is asked for."""
        y0, M = self.mechanism.map_of(self.muscles)
        if self.added is None:
            return TargetsMap(y0, M)
        rows, columns = self.mechanism.upper_triangle
        added = np.where(rows == columns, self.added[rows], 0.0)
        return TargetsMap(y0 + np.concatenate([np.zeros(self.mechanism.n), added]), M)

    @cached_property
    def box(self) -> tuple[PressureInterval, ...]:
        """Interval of each muscle's pressure, arrays (Q) or (N)."""
        return self.mechanism.intervals(self.muscles, self.limits)

    @cached_property
    def bounds(self) -> tuple[Array, Array]:
        """(lo, hi) (N, m) [Pa]."""
        shape = self.size, self.mechanism.m
        lo, hi = (np.stack([getattr(side, end) for side in self.box], axis=-1) for end in ("lo", "hi"))
        return np.broadcast_to(lo, shape), np.broadcast_to(hi, shape)

    @cached_property
    def which(self) -> NDArray[np.int64]:
        """Index of the map (N,) of each problem."""
        maps = len(self.asked if self.endpoint is None else self.map.y0)
        return np.arange(self.size) if maps > 1 else np.zeros(self.size, np.int64)

    # --- as least squares -------------------------------------------------------------------------------------------

    @property
    def unit(self) -> float:
        """Unit [Pa] of x = P/unit."""
        return self.mechanism.pressure_limits[1]

    @cached_property
    def rows(self) -> tuple[Indices, Indices]:
        """(the weighted components of y and the curvature, level after level; the end of each level)."""
        n = self.mechanism.n
        torque, stiffness = (np.flatnonzero(self.row_weights[part]) for part in (slice(n), slice(n, None)))
        stiffness += n
        if self.priority == "weighted":
            return np.concatenate([torque, stiffness]), np.array([torque.size + stiffness.size])
        first, second = (torque, stiffness) if self.priority == "torque" else (stiffness, torque)
        return np.concatenate([first, second]), np.array([first.size, first.size + second.size])

    @cached_property
    def curvature(self) -> TargetsMap:
        """Rows (N, c) for the curvature of an endpoint's stiffness, which should be 0; without redundancy c = 0."""
        if self.endpoint is None or self.endpoint.near is None:
            Q = len(self.map.y0)
            return TargetsMap(np.zeros((Q, 0)), np.zeros((Q, 0, self.mechanism.m)))
        return self.endpoint.curvature(self.joint_map, self.endpoint.near, self.weights[self.mechanism.n :])

    @cached_property
    def row_weights(self) -> Array:
        """Weights (d + c,) of the squared components of y and the curvature."""
        return np.append(self.weights, np.ones(self.curvature.y0.shape[1]))

    @cached_property
    def A(self) -> Array:
        """Weighted rows (Q, p, m), per unit of x."""
        rows, _ = self.rows
        M = np.concatenate([self.map.M, self.curvature.M], axis=1)
        return np.ascontiguousarray((np.sqrt(self.row_weights[rows])[:, None] * self.unit) * M[:, rows])

    @cached_property
    def b(self) -> Array:
        """Weighted right-hand sides (N, p)."""
        rows, left = self.rows[0], self.y - self.map.y0
        flat = np.broadcast_to(-self.curvature.y0, (self.size, self.row_weights.size - self.weights.size))
        return np.ascontiguousarray(np.sqrt(self.row_weights[rows]) * np.concatenate([left, flat], axis=1)[:, rows])

    def direction(self, mu: Array) -> Array:
        """Return d (N, d) of multipliers `mu` (N, k) of the first rows, on y."""
        rows = self.rows[0][: mu.shape[1]]
        d = np.zeros((len(mu), self.row_weights.size))
        d[:, rows] = -np.sqrt(self.row_weights[rows]) * mu
        return d[:, : self.weights.size]

    @cached_property
    def x_bounds(self) -> tuple[Array, Array, Array]:
        """(lo, hi, centre) (N, m) of x."""
        shape = self.size, self.mechanism.m
        centre = np.broadcast_to(self.reference, shape)
        lo, hi, c = (np.ascontiguousarray(P / self.unit) for P in (*self.bounds, centre))
        return lo, hi, c

    def by_posture(self, matrices: Array, rows: Array) -> Array:
        """Return rows_i · matrices of i's posture: (Q, p, m) and (N, p) to (N, m)."""
        if len(matrices) == 1:
            return np.asarray(rows @ matrices[0])
        return np.asarray((rows[:, None, :] @ matrices)[:, 0])

    def given(self, P: Array) -> Array:
        """Return y (N, d) at pressures (N, m) [Pa]."""
        if not self.mechanism.affine:
            return np.asarray(sum(self._added(P)))
        return self.map.y0 + self.by_posture(self.map.M.swapaxes(1, 2), P)

    def pressures(self, x: Array) -> Array:
        """Return pressures (N, m) [Pa], within the bounds."""
        return np.clip(x * self.unit, *self.bounds)

    def joint_stiffness(self, P: Array) -> Array:
        """Return K (N, n, n) [N·m/rad] at pressures (N, m) [Pa]."""
        if self.endpoint is None:
            return self.mechanism.whole(self.given(P)[:, self.mechanism.n :])
        K = np.asarray(sum(muscle.stiffness(P[:, j]) for j, muscle in enumerate(self.muscles)))
        return K if self.added is None else K + np.diag(self.added)

    def backbone(self, K: Array) -> Array:
        """Return joint stiffnesses `K` (N, n, n) without the hysteresis."""
        return K if self.added is None else K - np.diag(self.added)

    @cached_property
    def y_scale(self) -> Array:
        """Scale of large answers (N, d): the sums of the muscles' absolute values at their upper bounds."""
        if not self.mechanism.affine:
            return np.asarray(sum(map(np.abs, self._added(self.bounds[1])))) + np.abs(self.y)
        most = self.by_posture(np.abs(self.map.M).swapaxes(1, 2), np.abs(self.bounds[1]))
        return np.asarray(most + np.abs(self.map.y0) + np.abs(self.y))

    def costs(self, x: Array) -> Array:
        """Return the weighted squared errors of each level (N, K) at P/unit (N, m), for affine muscles."""
        left = (self.A @ x[:, :, None])[:, :, 0] - self.b
        return np.add.reduceat(left**2, [0, *self.rows[1][:-1].tolist()], axis=1)

    def _added(self, P: Array) -> list[Array]:
        """Return the muscles' contribution y - y0 (N, d) at pressures (N, m) [Pa]."""
        sides = enumerate(self.muscles)
        return [self.mechanism.stacked(side.torque(P[:, j]), side.stiffness(P[:, j])) for j, side in sides]


def positive_definite(K: Array) -> Mask:
    """Return whether the symmetric matrices (N, n, n) are positive definite, by the pivots of their elimination."""
    left = np.array(K)
    floor = CLOSED_FORM.met * np.abs(K).max(axis=(1, 2))
    good = np.ones(len(K), bool)
    for i in range(K.shape[-1]):
        pivot = left[:, i, i]
        good &= pivot > floor
        column = left[:, i + 1 :, i] / np.where(good, pivot, 1.0)[:, None]
        left[:, i + 1 :, i + 1 :] -= column[:, :, None] * left[:, i, None, i + 1 :]
    return good
