"""`Floors` are what the stiffness has to be at least: the one asked for, and the margin of a posture that holds itself.

All are compared in a frame in which what is asked for is 1, so that a shortfall is a share of it:

    W (K_q + Γ) Wᵀ ⪰ diag(1_dim, 0),     W = [ K*^(-1/2) Gᵀ ; Nᵀ/√k ]     and     K_q/κ ⪰ 1,

where J G = 1 and J N = 0. The first is K_q ⪰ Jᵀ K* J - Γ, which by Schur's complement of [[K*⁻¹, J], [Jᵀ, K_q + Γ]]
says K_x ⪰ K* of the hand, with as many joints as there may be. Without an endpoint J = 1 and Γ = 0.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.at_least.semidefinite import LinearMatrix, Programme
from allocator.mechanism.endpoint.endpoint import inverses
from allocator.mechanism.mechanism import TargetsMap
from allocator.mechanism.problem import BoxProblem


@dataclass(frozen=True, eq=False)
class Floors:
    """`Floors` are matrix inequalities K_q ⪰ B_i, each with the frame W_i that it is measured in."""

    problem: BoxProblem  # of one target
    torque: Array  # asked for (n,) [N·m]
    least: tuple[Array, ...]  # B_i (n, n) [N·m/rad]: of the stiffness, then of the margin
    frames: tuple[Array, ...]  # W_i (n, n)

    @classmethod
    def of(cls, problem: BoxProblem, margin: float | None) -> Self:
        """Return the floor of a problem, and that of the margin [N·m/rad], if it is asked for."""
        n, hand = problem.mechanism.n, problem.endpoint
        torque = problem.y[0, :n]
        if hand is None:
            floor = problem.mechanism.whole(problem.y[0, n:])
            frame = _root(floor)
        else:
            J, asked = hand.place.jacobian[0], hand.asked[0]
            seen = J.T @ asked @ J
            floor = seen - hand.load[0]
            plus, unseen = (part[0] for part in inverses(hand.place))
            frame = np.vstack([_root(asked) @ plus.T, unseen.T / np.sqrt(np.trace(seen) / hand.endpoint.dim)])
        least, frames = [floor], [frame]
        if margin is not None:
            least.append(margin * np.eye(n))
            frames.append(np.eye(n) / np.sqrt(margin if margin > 0 else np.trace(floor) / n))
        return cls(problem, torque, tuple(least), tuple(frames))

    @cached_property
    def programme(self) -> Programme:
        """Return the data of the semidefinite programme, torques in fractions of what the muscles can do."""
        p, n = self.problem, self.problem.mechanism.n
        y0, M = self.given.y0, self.given.M * p.unit
        size = self.torque_size
        lo, hi, centre = (x[0] for x in p.x_bounds)
        constant, slope = p.mechanism.whole(y0[n:]), p.mechanism.whole(M[n:].T)
        matrices = [
            LinearMatrix(W @ (constant - B) @ W.T, W @ slope @ W.T)
            for B, W in zip(self.least, self.frames, strict=True)
        ]
        return Programme(M[:n] / size, (self.torque - y0[:n]) / size, lo, hi, centre, matrices)

    @cached_property
    def given(self) -> TargetsMap:
        """Return (y0 (d,), M (d, m)) of torques and joint stiffness."""
        y0, M = self.problem.mechanism.map_of(self.problem.muscles)
        return TargetsMap(y0[0], M[0])

    @property
    def torque_size(self) -> float:
        """Return the torque [N·m] that the programme counts as 1."""
        return float(np.abs(self.given.M[: self.problem.mechanism.n]).max() * self.problem.unit)

    def excess(self, K: Array) -> tuple[float, ...]:
        """Return the least eigenvalue of W_i (K - B_i) W_iᵀ of a joint stiffness (n, n), for each floor."""
        pairs = zip(self.least, self.frames, strict=True)
        return tuple(float(np.linalg.eigvalsh(W @ (K - B) @ W.T)[0]) for B, W in pairs)


def _root(K: Array) -> Array:
    """Return K^(-1/2)."""
    size, axes = np.linalg.eigh(K)
    return np.asarray((axes / np.sqrt(size)) @ axes.T)
