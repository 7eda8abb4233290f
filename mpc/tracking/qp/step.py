"""QP step: one QP about a sequence of commands, built and solved once or several times per sample.

The readable step calls `mpc.tracking.linearise`, `mpc.tracking.qp.condense` and `mpc.tracking.qp.step` one after
the other; `mpc.tracking.compiled.qp_step` does the same in compiled code.

`certified` solves a QP with many rows of which few bind, and proves the solution. Rows are left out until a solution
violates them. This is faster than passing all rows to a solver and leads to the same point: a solution of the problem
with fewer rows that violates none of the others solves the whole problem. A solution is accepted by the certificate of
`mpc.tracking.qp.solvers` for the whole problem: gap ≤ ½ c ACCURACY², c the curvature that every change of a command
has by itself. The changes are then within ACCURACY [bar] of the solution.
"""

from math import inf
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Linearisation, Motion, Predictor
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.condense import SLACKS, TrackingProblem, condense
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import Riccati, Solver

if TYPE_CHECKING:
    from mpc.tracking.compiled.structured_qp.structured import StructuredQP


PRIMAL_TOLERANCE = 1e-4  # [bar], [rad], [N] by which an answer may violate a limit; commands are clipped
ACCURACY = 5e-3  # [bar] from an answer to the solution, at most; DAQP reaches 4e-4, Clarabel 5e-3
LAZY_TOLERANCE = 1e-6  # [bar], [rad], [N] below which an omitted row counts as satisfied


class Answer(NamedTuple):
    """Point and its residuals; it is a solution only if the status is OPTIMAL."""

    z: Array  # (n,)
    multipliers: Array  # (n + m,)
    status: PlanStatus


def certified(solve: Solver, qp: QP, deadline: float, curvature: float) -> Answer:
    """Return the proved solution of `qp`, or the reason for its absence by `deadline` [s] (clock: `perf_counter`).

    `curvature` [cost]/[bar]² is a lower bound of the eigenvalues of H without slacks
    (`mpc.tracking.qp.condense.TrackingProblem.curvature`).
    """
    z, multipliers = np.zeros_like(qp.f), np.zeros(qp.f.size + len(qp.R))
    if not (np.isfinite(qp.H).all() and np.isfinite(qp.f).all()):
        return Answer(z, multipliers, PlanStatus.NOT_FINITE)
    within = np.zeros(len(qp.R), bool)
    while True:
        left = deadline - perf_counter()
        found = solve(qp.with_rows(within), left) if left > 0 else None
        if perf_counter() > deadline:
            return Answer(z, multipliers, PlanStatus.LATE)
        if found is None:
            return Answer(z, multipliers, PlanStatus.UNSOLVED)
        z = found[0]
        broken = (qp.breaches(z) > LAZY_TOLERANCE) & ~within
        if not broken.any():
            break
        within = within | broken
    multipliers[np.append(np.full(z.size, True), within)] = found[1]
    right = qp.certify(z, multipliers).within(PRIMAL_TOLERANCE, 0.5 * curvature * ACCURACY**2)
    return Answer(z, multipliers, PlanStatus.OPTIMAL if right else PlanStatus.REFUSED)


class SlowStep(UserWarning):
    """Warning that a controller's step could not be compiled; the uncompiled one is about forty times slower."""


class CompilingBeside(UserWarning):
    """Warning that a controller's step is being compiled in the background; about forty times slower until then."""


class PreviousSample(NamedTuple):
    """Data of the previous sample.

    All QPs of a sample get the same object, those of another sample get another one.
    """

    u: Array  # command (2,) [Pa]
    u_star: Array  # its feed-forward (2,) [Pa]


class QPAnswer(NamedTuple):
    """Result of one QP."""

    status: PlanStatus
    u: Array  # (N, 2) within the limits [Pa]: optimal if the status is OPTIMAL, else those of the interrupted
    # structured solver, or of the linearisation
    motion: Motion | None  # finite motion under these commands, if already known
    qp: QP | None  # None if there was no need to build it
    times: tuple[float, float, float]  # of linearising, condensing, solving with its proof [s]; 0.0: not needed
    gap: float = 0.0  # bound of the cost of `u` minus that of the solution; inf: unknown


class QPStep(Protocol):
    """Step that builds the QP about the commands `u` (N, 2) from `x` (4,) under the torques `d` (N,), and solves it.

    The linearisation is about the commands within the limits that are nearest to `u`.
    """

    @property
    def implementation(self) -> str:
        """Kind of implementation: "compiled" or "readable"."""

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Solve the QP with `solve`, by `deadline` [s] on the clock of `perf_counter`."""

    def reset(self) -> None:
        """Forget the past samples."""

    active_set: NDArray[np.int8] | None
    """State remembered from sample to sample, for a copy in another process to continue with."""


class ReadableQPStep:
    """QP step by NumPy and CasADi; its structured QP is solved sample by sample if the solver can be compiled."""

    implementation = "readable"
    active_set: NDArray[np.int8] | None = None

    def __init__(
        self, problem: TrackingProblem, predictor: Predictor, structured: "StructuredQP | None" = None
    ) -> None:
        self.problem, self.predictor, self.structured = problem, predictor, structured

    def reset(self) -> None:
        """Forget which bounds were active, if that is remembered."""
        if self.structured is not None:
            self.structured.reset()

    def __call__(
        self, x: Array, u: Array, d: Array, feed: FeedForward, previous: PreviousSample, solve: Solver, deadline: float
    ) -> QPAnswer:
        """Solve the QP as `QPStep` describes."""
        began = perf_counter()
        u = self.problem.limits.limited(previous.u, u)
        model = self.predictor.linearise(x, u, d)
        linearised = perf_counter()
        if self.structured is not None and isinstance(solve, Riccati):
            self.structured.take(x, u, d, feed, previous)
            self.structured.take_model(model)
            proved = self.structured.solved(solve.limit)
            now, z = perf_counter(), np.append(self.structured.z, SLACKS * [0.0])
            u = commands(self.problem, u, z, previous)
            gap, times = self.structured.gap, (linearised - began, 0.0, now - linearised)
            return structured_answer(proved, bool(np.isfinite(u).all()), u, None, gap, times, now > deadline)
        return dense_answer(self.problem, model, feed, previous, solve, began, deadline)


def dense_answer(
    problem: TrackingProblem, model: Linearisation, feed: FeedForward, previous: PreviousSample, solve: Solver,
    began: float, deadline: float
) -> QPAnswer:  # fmt: skip
    """Return the solution of the condensed QP about `model` by `solve`; times count from `began` [s]."""
    linearised = perf_counter()
    qp = condense(problem, model, feed, previous.u, previous.u_star)
    condensed = perf_counter()
    answer = certified(solve, qp, deadline, problem.curvature)
    u = model.u
    if answer.status is PlanStatus.OPTIMAL:
        u = commands(problem, u, answer.z, previous)
    times = linearised - began, condensed - linearised, perf_counter() - condensed
    return QPAnswer(answer.status, u, None, qp, times, 0.0 if answer.status is PlanStatus.OPTIMAL else inf)


def structured_answer(
    proved: bool, finite: bool, u: Array, motion: Motion | None, gap: float, times: tuple[float, float, float],
    late: bool,
) -> QPAnswer:  # fmt: skip
    """Return the answer with the commands `u` of the structured QP; `finite` is whether they and the motion are."""
    if not finite:
        return QPAnswer(PlanStatus.NOT_FINITE, u, None, None, times, inf)
    if late:
        return QPAnswer(PlanStatus.LATE, u, None, None, times, inf)
    status, gap = (PlanStatus.OPTIMAL, 0.0) if proved else (PlanStatus.UNSOLVED, gap)
    return QPAnswer(status, u, motion, None, times, gap)


def commands(problem: TrackingProblem, u: Array, z: Array, previous: PreviousSample) -> Array:
    """Return `u` changed by the decisions `z`, within the limits (N, 2) [Pa]."""
    return problem.limits.limited(previous.u, u + problem.E @ z)
