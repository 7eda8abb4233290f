"""Condensing of stage matrices to a dense QP in the changes of the commands, with the states eliminated.

The commands are u = ū + E z, where E (N, 2, n) maps decisions to commands. The decisions z are the N changes
Δu_k = u_k - u_{k-1}, minus those of ū, so that every command contains the sum of the changes up to it, followed by the
slacks s of the joint range and s_F of the muscle forces. Blocked moves have fewer: one pair of changes at the beginning
of every block, after which the commands move as ū does. With δx_0 = 0 the linear model gives

    δx_{k+1} = A_k δx_k + B_k E_k z      so      x_k = x̄_k + G_k z,    G_0 = 0,    G_{k+1} = A_k G_k + B_k E_k

and every term of the cost is a residual r̄ + J z of the weight w: H = Σ w JᵀJ, f = Σ w Jᵀr̄. Pressures count in bar
within z, s in rad, s_F in N.

A `NamedQP` shows a step's QP for inspection: its matrices, and the names of its decisions and rows.

`softened` solves the QP with soft rows, which always has a solution, by a different method:

    minimise   ½ zᵀ H z + fᵀ z + ½ Σ_i w_i max(0, breach_i(z))²      over      lower ≤ z ≤ upper

Only the bounds on z, the slew limits, are hard. Every other row costs the square of its violation; slacks are left out.
The method is bounded least squares (SciPy's BVLS), repeated with the rows violated by the last solution: a Newton
method for a convex, piecewise quadratic cost, which has converged when the rows repeat. The result is the best point
found when the time is over. It is feasible and better than z = 0.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import perf_counter

import numpy as np

from allocator.calculus import Array, Mask
from allocator.units import BAR
from mpc.model.plant import NU
from mpc.tracking.cost import Rows, Weights, charged, diagonal
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Linearisation
from mpc.tracking.qp.programme import QP

SLACKS = 2  # s and s_F, the last decisions


@dataclass(frozen=True)
class TrackingProblem:
    """Constant data of the problem in `mpc.tracking.controller`."""

    weights: Weights
    limits: Limits
    L: Array  # (6, 6) terminal factor
    blocks: tuple[int, ...]  # samples from one change of the commands to the next, N in all
    dt: float  # [s]
    joints: int = 1  # n; for (4) read 2n + m
    muscles: int = NU  # m; for (2) read m, for (6) 2n + 2m
    stiffnesses: int = 1  # entries of svec K

    @cached_property
    def starts(self) -> Array:
        """Samples at which the commands may leave ū, one for each block."""
        return np.cumsum([0, *self.blocks[:-1]])

    @cached_property
    def rows(self) -> Rows:
        """Weights of the stage cost by kinds of rows."""
        return diagonal(self.weights, self.joints, self.muscles, self.stiffnesses)

    @cached_property
    def curvature(self) -> float:
        """Curvature c [cost]/[bar]², a lower bound of the eigenvalues of H, because every change has this cost."""
        return float(self.rows.rate.min()) * BAR**2 / self.dt**2

    @cached_property
    def E(self) -> Array:
        """Change E (N, 2, n) [Pa] of the commands per unit of each decision."""
        return increments(self.blocks, self.muscles)


def increments(blocks: Sequence[int], m: int = NU) -> Array:
    """Return E (N, 2, 2 blocks + 2) [Pa/bar]: a block's change moves all commands from there on; slacks move none."""
    E = np.zeros((sum(blocks), m, len(blocks) * m + SLACKS))
    for j, start in enumerate(np.cumsum([0, *blocks[:-1]])):
        E[start:, :, j * m : (j + 1) * m] = BAR * np.eye(m)
    return E


def sensitivity(A: Array, B: Array, E: Array) -> Array:
    """Return G (N+1, 4, n) = ∂x/∂z, the linear model unrolled."""
    N, _, n = E.shape
    moves = B @ E  # (N, 4, n)
    G = np.zeros((N + 1, A.shape[1], n))
    for k in range(N):
        G[k + 1] = A[k] @ G[k] + moves[k]
    return G


def condense(
    problem: TrackingProblem, model: Linearisation, feed: FeedForward, u_last: Array, u_star_last: Array
) -> QP:
    """Return the QP of a step about `model`; `u_last`, `u_star_last` (2,) are the previous command and feed-forward."""
    G = sensitivity(model.A, model.B, problem.E)
    H, f = np.zeros((G.shape[-1], G.shape[-1])), np.zeros(G.shape[-1])
    terms = _residuals(problem, model, G, feed, u_last - u_star_last)
    for w, J, r in terms:  # one large product would wait for the threads of a library
        H += w * (J.T @ J)
        f += w * (J.T @ r)
    weights = problem.weights
    H[-SLACKS:, -SLACKS:] = np.diag([weights.slack_square, weights.slack_force_square])
    f[-SLACKS:] = weights.slack, weights.slack_force

    changes = np.diff(model.u, axis=0, prepend=u_last[None])[problem.starts].ravel() / BAR
    step = problem.limits.step / BAR
    # z = 0 is feasible despite rounding
    lower, upper = np.minimum(-step - changes, 0.0), np.maximum(step - changes, 0.0)
    lower, upper = np.append(lower, SLACKS * [0.0]), np.append(upper, SLACKS * [np.inf])
    return QP(H, f, lower, upper, *_rows(problem, model, G))


def _residuals(
    problem: TrackingProblem, model: Linearisation, G: Array, feed: FeedForward, e_last: Array
) -> list[tuple[float, Array, Array]]:
    """Return the terms w, J, r̄ of the cost ½ Σ w |r̄ + J z|²."""
    E, L, W = problem.E, problem.L, problem.rows
    N, _, n = E.shape
    e = model.u - feed.u  # (N, 2) [Pa]
    rate = np.diff(e, axis=0, prepend=e_last[None]) / problem.dt
    E_rate = np.diff(E, axis=0, prepend=np.zeros((1, problem.muscles, n))) / problem.dt
    x, y = model.x - feed.x, model.y - feed.y
    xi = np.concatenate([x[-1], e[-1]])
    inner = slice(1, N)  # the states before the last, which has the terminal cost
    return [
        *((w, G[inner, i], x[inner, i]) for i, w in charged(W.x)),
        *((w, (model.slope[inner, None, i] @ G[inner])[:, 0], y[inner, i]) for i, w in charged(W.y)),
        *((w, E[:, i], e[:, i]) for i, w in charged(W.e)),
        *((w, E_rate[:, i], rate[:, i]) for i, w in charged(W.rate)),
        (1.0, L @ np.concatenate([G[-1], E[-1]]), L @ xi),
    ]


def _rows(problem: TrackingProblem, model: Linearisation, G: Array) -> tuple[Array, Array, Array]:
    """Return the rows: commands within the supply; θ - s at most its upper, θ + s at least its lower limit; F + s_F at
    least its own. An arm has as many angles as it has limits.

    Pressures that start outside the supply return no faster than the slew limit, as those of `model` do; z = 0 has to
    stay feasible.
    """
    E, limits = problem.E, problem.limits
    n = E.shape[-1]
    s, s_F = np.eye(n)[-SLACKS:]
    (P_lo, P_hi), (left, right) = limits.pressure, limits.theta
    joints = np.size(left)
    commands, angle = E.reshape(-1, n) / BAR, G[1:, :joints].reshape(-1, n)
    force = (model.D[1:] @ G[1:]).reshape(-1, n)
    u, theta, F = model.u.ravel() / BAR, model.x[1:, :joints], model.F[1:].ravel()
    below, above, never = (left - theta).ravel(), (right - theta).ravel(), np.full(theta.size, np.inf)
    return (
        np.concatenate([commands, angle - s, angle + s, force + s_F]),
        np.concatenate([np.minimum(P_lo / BAR - u, 0.0), -never, below, limits.min_force - F]),
        np.concatenate([np.maximum(P_hi / BAR - u, 0.0), above, never, np.full(F.shape, np.inf)]),
    )


_SHOWN = 3  # of a kind, from each end


@dataclass(frozen=True, eq=False)
class NamedQP:
    """Unsolved problem of one step of a `TrackingMPC`; its arrays are read-only.

        minimise ½ zᵀ H z + fᵀ z   subject to   lower ≤ z ≤ upper,   rows_lower ≤ rows z ≤ rows_upper

    The decisions z are the changes of the commands, less those of `u`, and the slacks. The horizon begins when a
    command given now acts; [k] counts its samples.
    """

    H: Array  # (n, n)
    f: Array  # (n,)
    lower: Array  # (n,)
    upper: Array  # (n,)
    rows: Array  # (m, n)
    rows_lower: Array  # (m,)
    rows_upper: Array  # (m,)
    decisions: tuple[str, ...]  # n names; pressures count in bar, slacks in rad and N
    row_names: tuple[str, ...]  # m
    u: Array  # (N, m) commands for z = 0 [Pa], without those of a dead band's inverse
    _u_last: Array = field(repr=False)  # (m,) [Pa]
    _E: Array = field(repr=False)  # (N, m, n) [Pa]
    _limits: Limits = field(repr=False)

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        for array in (self.H, self.f, self.lower, self.upper, self.rows, self.rows_lower, self.rows_upper, self.u):
            array.setflags(write=False)

    def __setstate__(self, state: dict[str, object]) -> None:
        """Make the arrays of a copy read-only."""
        self.__dict__.update(state)
        self.__post_init__()

    def commands(self, z: Array) -> Array:
        """Return the commands [Pa] of the decisions `z` (n,), within the hard limits as a plan's are."""
        return self._limits.limited(self._u_last, self.u + self._E @ z)

    def __repr__(self) -> str:
        """Return tables of decisions and rows, long ones shortened."""
        n, m = self.rows.shape[1], len(self.rows)
        head = f"QP of a step: {n} decisions, {m} rows; minimise ½ zᵀ H z + fᵀ z"
        decisions = [f"{'decision':<24}{'lower':>12}{'upper':>12}{'f':>12}{'H[i, i]':>12}"]
        of_decisions = self.lower, self.upper, self.f, np.diag(self.H)
        decisions += [_line(name, *numbers) for name, *numbers in zip(self.decisions, *of_decisions, strict=True)]
        rows = [f"{'row':<24}{'lower':>12}{'upper':>12}"]
        of_rows = self.rows_lower, self.rows_upper
        rows += [_line(name, *numbers) for name, *numbers in zip(self.row_names, *of_rows, strict=True)]
        return "\n".join([head, "", *_shortened(decisions), "", *_shortened(rows)])


def named(problem: TrackingProblem, qp: QP, u: Array, u_last: Array) -> NamedQP:
    """Return `qp` of `problem` about the commands `u` (N, m) after `u_last` (m,), with names."""
    arrays = qp.H, qp.f, qp.lower, qp.upper, qp.R, qp.rows_lower, qp.rows_upper
    names = tuple(decision_names(problem)), tuple(row_names(problem))
    return NamedQP(*arrays, *names, u, u_last, problem.E, problem.limits)


def decision_names(problem: TrackingProblem) -> Iterator[str]:
    """Yield the names of the decisions, in the order of `mpc.tracking.qp.condense`."""
    for k in problem.starts:
        yield from (f"ΔP{j}[{k}]" for j in range(1, problem.muscles + 1))
    yield from ("slack angle", "slack force")


def row_names(problem: TrackingProblem) -> Iterator[str]:
    """Yield the names of the rows, in the order of `mpc.tracking.qp.condense`."""
    N, n, m = sum(problem.blocks), problem.joints, problem.muscles
    angles = ["angle"] if n == 1 else [f"angle {i}" for i in range(1, n + 1)]
    muscles = ["agonist", "antagonist"] if (n, m) == (1, 2) else [f"muscle {j}" for j in range(1, m + 1)]
    for k in range(N):
        yield from (f"P{j}[{k}] supply" for j in range(1, m + 1))
    for side in ("upper", "lower"):
        for k in range(1, N + 1):
            yield from (f"{angle}[{k}] {side}" for angle in angles)
    for k in range(1, N + 1):
        yield from (f"{muscle} taut[{k}]" for muscle in muscles)


def _line(name: str, *numbers: float) -> str:
    return f"{name:<24}" + "".join(f"{number:12.4g}" for number in numbers)


def _shortened(lines: list[str]) -> list[str]:
    """Return the lines without those in the middle of runs of one kind: names that differ in their numbers only."""
    kinds = ["".join(c for c in line.split("  ")[0] if not c.isdigit()) for line in lines]
    kept: list[str] = []
    for i, line in enumerate(lines):
        same = [j for j in range(len(lines)) if kinds[j] == kinds[i]]
        at = same.index(i)
        if at < _SHOWN or at >= len(same) - _SHOWN:
            kept.append(line)
        elif kept[-1] != "…":
            kept.append("…")
    return kept


COMMAND = 1e6  # w of the supply [cost]/[bar]²; commands are clipped to it before they are sent
ROUNDS = 10


def softened(qp: QP, deadline: float) -> Array | None:
    """Return decisions z (n,) with zero slacks, found by `deadline` [s]; None if z = 0 is the best point found."""
    hard, w = _without_slacks(qp), _charges(qp)
    best, least = None, cost(hard, w, np.zeros_like(hard.f))
    z, charged = np.zeros_like(hard.f), np.zeros(len(w), bool)
    took = 0.0  # duration of the last round [s]
    for _ in range(ROUNDS):
        if (began := perf_counter()) + took > deadline:
            break
        try:
            z = _bounded_least_squares(_charging(hard, w, charged, z))
        except np.linalg.LinAlgError:  # H is not positive definite to rounding: keep the best point
            break
        took = perf_counter() - began
        if (price := cost(hard, w, z)) < least:
            best, least = z, price
        broken = hard.breaches(z) > 0
        if (broken == charged).all():
            break
        charged = broken
    return None if best is None else np.append(best, SLACKS * [0.0])


def cost(qp: QP, w: Array, z: Array) -> float:
    """Return the cost to minimise; `qp` has no slacks."""
    return qp.cost(z) + 0.5 * float(w @ np.maximum(qp.breaches(z), 0.0) ** 2)


def _without_slacks(qp: QP) -> QP:
    n = qp.f.size - SLACKS
    return replace(qp, H=qp.H[:n, :n], f=qp.f[:n], lower=qp.lower[:n], upper=qp.upper[:n], R=qp.R[:, :n])


def _charges(qp: QP) -> Array:
    """Return w (m,), the QP's cost of the square of each row's slack, and COMMAND for the rows of commands."""
    w = np.square(qp.R[:, -SLACKS:]) @ np.diag(qp.H)[-SLACKS:]
    return np.where(w > 0, w, COMMAND)


def _charging(qp: QP, w: Array, charged: Mask, z: Array) -> QP:
    """Return `qp` without rows, with a cost ½ w (R z' - b)² for each `charged` one; `z` violates the bounds b."""
    R, w = qp.R[charged], w[charged]
    b = np.clip(R @ z, qp.rows_lower[charged], qp.rows_upper[charged])
    H, f = qp.H + R.T @ (w[:, None] * R), qp.f - R.T @ (w * b)
    return replace(qp.with_rows(np.zeros(len(qp.R), bool)), H=H, f=f)


def _bounded_least_squares(qp: QP) -> Array:
    """Return the minimum within the bounds, of ½ |Lᵀ z + L⁻¹ f|² with H = L Lᵀ."""
    from scipy.linalg import solve_triangular
    from scipy.optimize import lsq_linear

    L = np.linalg.cholesky(qp.H)
    found = lsq_linear(L.T, -solve_triangular(L, qp.f, lower=True), (qp.lower, qp.upper), method="bvls")
    return np.asarray(np.clip(found.x, qp.lower, qp.upper))
