"""Semidefinite programme for at least a given stiffness, for cvxpy and Clarabel; their answers are checked.

In x = P/unit, with torques A x = b and linear matrices F_i(x) = F_i0 + Σ_j x_j F_ij,

    least:   minimise ½ ‖x - c‖²   subject to   A x = b,   F_i(x) ⪰ 0,     lo ≤ x ≤ hi                       [S]
    widest:  maximise s            subject to   A x = b,   F_i(x) ⪰ s 1,   lo ≤ x ≤ hi

Multipliers λ of the equations and Z_i ⪰ 0 of the matrices give dual bounds of both, whatever solver found them, because
the box is separable in x_j: `bound` and `reach` are such bounds.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from allocator.allocation.box.problem import BoxProblem
from allocator.calculus import Array
from allocator.mechanism.endpoint.endpoint import inverses
from allocator.mechanism.mechanism import TargetsMap

if TYPE_CHECKING:
    import cvxpy

_TOLERANCES = {"tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}


class LinearMatrix(NamedTuple):
    """F(x) = F0 + Σ_j x_j F_j, symmetric."""

    constant: Array  # F0 (k, k)
    slope: Array  # F_j (m, k, k)

    def at(self, x: Array) -> Array:
        """Return F(x) (k, k)."""
        return np.asarray(self.constant + np.tensordot(x, self.slope, 1))


class Programme(NamedTuple):
    """Data of [S]."""

    A: Array  # (n, m)
    b: Array  # (n,)
    lo: Array  # (m,)
    hi: Array
    centre: Array
    matrices: Sequence[LinearMatrix]


class Multipliers(NamedTuple):
    """Multipliers that prove bounds."""

    torque: Array  # λ (n,)
    matrices: list[Array]  # Z_i (k, k), positive semidefinite


def least(programme: Programme) -> tuple[Array, Multipliers] | None:
    """Return (x, multipliers) of the least x; None if the solver finds none."""
    return _solve(programme, "least")


def widest(programme: Programme) -> tuple[Array, Multipliers] | None:
    """Return (x, multipliers) of the widest margin; None if the solver finds none."""
    return _solve(programme, "widest")


def slope(programme: Programme, found: Multipliers) -> tuple[float, Array]:
    """Return (constant, slope (m,)) of λ·(A x - b) + Σ ⟨Z_i, F_i(x)⟩ over x."""
    constant = -found.torque @ programme.b
    row = found.torque @ programme.A
    for Z, F in zip(found.matrices, programme.matrices, strict=True):
        constant += np.sum(Z * F.constant)
        row = row + np.tensordot(F.slope, Z, 2)
    return float(constant), np.asarray(row)


def bound(programme: Programme, found: Multipliers) -> float:
    """Return a lower bound of ½ ‖x - c‖² in [S], proved by the multipliers."""
    constant, row = slope(programme, found)
    x = np.clip(programme.centre + row, programme.lo, programme.hi)
    return float(0.5 * np.sum((x - programme.centre) ** 2) - row @ x - constant)


def _solve(programme: Programme, kind: str) -> tuple[Array, Multipliers] | None:
    import cvxpy

    size = programme.matrices[0].constant.shape[0]
    built = _built(kind, *programme.A.shape, size, len(programme.matrices))
    built.fill(programme)
    try:
        with warnings.catch_warnings():  # "may be inaccurate": every answer is checked
            warnings.simplefilter("ignore", UserWarning)
            warnings.simplefilter("ignore", RuntimeWarning)  # the cost at a direction that proves infeasibility
            built.problem.solve(solver="CLARABEL", **_TOLERANCES)
    except cvxpy.SolverError:
        return None
    if built.problem.status not in ("optimal", "optimal_inaccurate"):
        return None
    duals = [_semidefinite(constraint.dual_value) for constraint in built.ordered]
    # Clarabel's multipliers are those of A x - b = 0 in the Lagrangian cost + λ·(A x - b)
    return np.clip(built.x.value, programme.lo, programme.hi), Multipliers(-np.array(built.exact.dual_value), duals)


def _semidefinite(Z: Array) -> Array:
    """Return the nearest positive semidefinite matrix."""
    size, axes = np.linalg.eigh(0.5 * (Z + Z.T))
    return np.asarray((axes * np.maximum(size, 0.0)) @ axes.T)


class _Built(NamedTuple):
    problem: "cvxpy.Problem"
    x: "cvxpy.Variable"
    exact: "cvxpy.Constraint"
    ordered: list["cvxpy.Constraint"]
    parameters: dict[str, "cvxpy.Parameter"]
    flat: list[tuple["cvxpy.Parameter", "cvxpy.Parameter"]]  # of each matrix

    def fill(self, programme: Programme) -> None:
        """Set the values of the parameters."""
        for name, parameter in self.parameters.items():
            parameter.value = getattr(programme, name)
        for (constant, slope), F in zip(self.flat, programme.matrices, strict=True):
            constant.value, slope.value = F.constant.ravel(), F.slope.reshape(len(F.slope), -1).T


@lru_cache(maxsize=8)
def _built(kind: str, n: int, m: int, size: int, count: int) -> _Built:
    """Build the programme once for its sizes, with parameters for changing data."""
    import cvxpy

    x, s = cvxpy.Variable(m), cvxpy.Variable()
    p = {"A": cvxpy.Parameter((n, m)), "b": cvxpy.Parameter(n), "lo": cvxpy.Parameter(m), "hi": cvxpy.Parameter(m)}
    flat = [(cvxpy.Parameter(size * size), cvxpy.Parameter((size * size, m))) for _ in range(count)]
    ordered = []
    for constant, slope in flat:
        F = cvxpy.reshape(constant + slope @ x, (size, size), order="C")
        ordered.append(F - (s * np.eye(size) if kind == "widest" else 0) >> 0)
    exact = p["A"] @ x == p["b"]
    if kind == "least":
        p["centre"] = cvxpy.Parameter(m)
        cost = 0.5 * cvxpy.sum_squares(x - p["centre"])
    else:
        cost = -s
    problem = cvxpy.Problem(cvxpy.Minimize(cost), [exact, x >= p["lo"], x <= p["hi"], *ordered])
    return _Built(problem, x, exact, ordered, p, flat)


@dataclass(frozen=True, eq=False)
class Floors:
    """Matrix inequalities K_q ⪰ B_i, each with the frame W_i of its measure."""

    problem: BoxProblem  # of one target
    torque: Array  # requested (n,) [N·m]
    least: tuple[Array, ...]  # B_i (n, n) [N·m/rad]: of the stiffness, then of the margin
    frames: tuple[Array, ...]  # W_i (n, n)

    @classmethod
    def of(cls, problem: BoxProblem, margin: float | None) -> Self:
        """Return the floor of a problem, and that of the margin [N·m/rad], if any."""
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
            least.append(margin * np.eye(n) - problem.backbone(np.zeros((n, n))))  # of the backbone
            frames.append(np.eye(n) / np.sqrt(margin if margin > 0 else np.trace(floor) / n))
        return cls(problem, torque, tuple(least), tuple(frames))

    @cached_property
    def programme(self) -> Programme:
        """Data of the semidefinite programme, torques in fractions of `torque_size`."""
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
        """(y0 (d,), M (d, m)) of torques and joint stiffness."""
        y0, M = self.problem.joint_map
        return TargetsMap(y0[0], M[0])

    @property
    def torque_size(self) -> float:
        """Torque [N·m] that the programme counts as 1."""
        return float(np.abs(self.given.M[: self.problem.mechanism.n]).max() * self.problem.unit)

    def excess(self, K: Array) -> tuple[float, ...]:
        """Return the least eigenvalue of W_i (K - B_i) W_iᵀ of a joint stiffness (n, n), for each floor."""
        pairs = zip(self.least, self.frames, strict=True)
        return tuple(float(np.linalg.eigvalsh(W @ (K - B) @ W.T)[0]) for B, W in pairs)


def _root(K: Array) -> Array:
    """Return K^(-1/2)."""
    size, axes = np.linalg.eigh(K)
    return np.asarray((axes / np.sqrt(size)) @ axes.T)
