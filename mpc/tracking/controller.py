"""Linear time-varying MPC of angle and stiffness. At every sample it solves, for a joint:

    minimise  ½ Σ_{k=1…N-1} [|x_k - x*_k|² + |y_k - y*_k|²] + ½ Σ_{k=0…N-1} [|e_k|² + |e_k - e_{k-1}|²/dt²]
            + ½ |L ξ|²  +  ρ s + ½ ρ₂ s²  +  ρ_F s_F + ½ ρ_F₂ s_F²,       e_k = u_k - u*_k,  ξ = (x_N - x*_N, e_{N-1})
    over      u_0 … u_{N-1},  s ≥ 0,  s_F ≥ 0
    subject to  x_{k+1} = f_d(x_k, u_k, d_k),  K_k = K(x_k),  x_0 = the measured state
                P_min ≤ u_k ≤ P_max,   |u_k - u_{k-1}| ≤ slew · dt                             (hard)
                θ_min - s ≤ θ_k ≤ θ_max + s,   F_i(x_k) ≥ F_min - s_F,   k = 1…N, i = 1, 2     (soft)

For an arm with n joints and m muscles, x is (q, ω, P), y is (svec K, F) and d is a torque at every joint; all angles
share one slack and all forces another. The decisions are then changes of the commands at the beginnings of blocks,
whose lengths grow along the horizon.

The squares of the first line are weighted entry by entry (`mpc.tracking.cost`); y = (K, F1, F2). θ* and K* are the
references, moved to the nearest feasible ones. The closed-form allocation gives u* and the pressures in
x* = (θ*, θ*', P1*, P2*) that follow them (`mpc.tracking.feedforward`). L is the terminal cost
(`mpc.tracking.cost`). The penalties ρ, ρ_F are large enough for slacks to be used only if necessary (`Weights`).
f_d, K and F are linearised along the previous plan, shifted by one sample (`mpc.tracking.linearise`). The result is a
QP in the changes of the commands (`mpc.tracking.qp.condense`). One QP is solved per sample, or `iterations` of them,
which converge to the solution of the nonlinear problem. With `blocks`, the commands depart from the previous plan only
where a block begins.

A `Compensation` has the known effects of the real joint. The problem begins in the state to which the commands under
way will have brought the joint at the end of the dead time, the torque d_k contains the friction of the intended motion
θ*, and the commands sent are the inverse of the regulators' dead band at u.

`mpc.tracking.qp.step` builds and solves one QP about a plan, `mpc.tracking.compiled.qp_step` does so in compiled code.

Every step returns a plan. If no solution of the QP passes the check of its optimality conditions
(`mpc.tracking.qp.step`) within the time budget, the fallback ladder chooses the commands
(`mpc.tracking.fallback`). Commands always satisfy the hard limits exactly.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from itertools import accumulate, chain, repeat
from math import inf
from time import perf_counter, thread_time
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput, notice
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.experiment import RESOLUTION
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.compiled.factory import factory
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.cost import Weights
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import LONGEST_HORIZON
from mpc.tracking.plan import Plan, PlanStatus, Rung
from mpc.tracking.qp.condense import NamedQP, TrackingProblem, condense, named, softened
from mpc.tracking.qp.solvers import Riccati, Solver
from mpc.tracking.qp.solvers import solver as solver_of
from mpc.tracking.qp.step import QPAnswer
from mpc.tracking.terminal import terminal_factor

if TYPE_CHECKING:
    from mpc.tracking.compiled.sample.whole import WholeStep  # which imports numba


@dataclass
class TrackingMPC(BaseController):
    """Linearised MPC that tracks references of angle and stiffness with `plant` as its model. It keeps its last plan.

    `plant` is a `Plant`, or an `Arm` of n joints and m muscles. The references of an arm are values (n,) [rad] and
    (k, k) [N·m/rad], or previews (ahead + 1, …) of them; the arrays of its `Plan` are u (N, m) [Pa], x (N+1, 2n + m)
    and K (N+1, k, k).

    `BaseController` defines its step: `Task` → `FeedForward` → `Optimised` → `Motion` → `Plan`. The optimisation solves
    `iterations` QPs (`mpc.tracking.qp.step`), or the softened one. At a constant reference the commands rest
    (`mpc.tracking.rest`). `qp` shows the QP of a step.

    A time `budget` of dt or less is for real-time operation; without one, a step takes as long as it needs. If the
    angle is missing, the controller uses its own prediction for `patience` seconds and then holds the pressures
    (`Rung.HOLD`). Raises `InvalidInput` for invalid settings.
    """

    machines = Plant, Arm
    plant: Any  # a `Machine`
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str | Mapping[str, object] | Solver = "riccati"  # or options, or `OSQP(…)`, or a function
    iterations: int = 1  # QPs per step
    compensation: Compensation = field(default_factory=Compensation)  # of the real joint
    min_force: float = 0.0  # F_min [N]
    blocks: Sequence[int] | None = None  # lengths of the blocks of samples, N in all; None: see `usual_blocks`
    budget: float | None = None  # greatest duration of a step [s]
    patience: float = 0.2  # [s]
    rest: bool = True  # whether commands come to rest at a constant reference, see `rests`
    wait: bool = True  # for compilation; else another process compiles, and the readable step is used
    compiled: bool = True  # False: use the readable step, for a controller that is only exported

    def __post_init__(self) -> None:
        """Check the settings and build the constant parts."""
        self.blocks = self._check_settings()
        self._build(self.N, self.min_force)
        L, plant = terminal_factor(self.plant, self.dt, self.weights), self.plant
        sizes = plant.n, plant.m, plant.stiffnesses
        self.problem = TrackingProblem(self.weights, self.limits, L, self.blocks, self.dt, *sizes)
        self._work()
        if self.compiled and (self.wait or self.implementation == "compiled"):  # otherwise `CompilingBeside` has warned
            check_pace(self._rehearse, self.plant, self.dt, self.N)
        self.reset()

    def __repr__(self) -> str:
        return (
            f"TrackingMPC: {self.N} samples of {1e3 * self.dt:g} ms, solver {self.solver}; model: {self.plant.summary}"
        )

    def _check_settings(self) -> tuple[int, ...]:
        """Check the settings, and return the blocks."""
        self._check_model()
        if not isinstance(self.weights, Weights):
            raise InvalidInput(f"weights = {checks.brief(self.weights)} have to be Weights")
        for name in ("rest", "wait", "compiled"):
            checks.flag(name, getattr(self, name))
        self.dt = checks.number("dt", self.dt, "s")
        self.N = checks.count("N", self.N, least=3, most=LONGEST_HORIZON)
        self.iterations = checks.count("iterations", self.iterations, least=1)
        self.patience = checks.not_negative("patience", self.patience, "s")
        self.budget = None if self.budget is None else checks.not_negative("budget", self.budget, "s")
        if self.blocks is None:
            return usual_blocks(self.plant, self.N)
        if not isinstance(self.blocks, Iterable):
            raise InvalidInput(f"blocks = {checks.brief(self.blocks)} have to be lengths [samples], N in all")
        lengths = tuple(checks.count("a length of blocks", length, least=1) for length in self.blocks)
        if lengths == usual_blocks(self.plant, sum(lengths)):
            return usual_blocks(self.plant, self.N)  # by `dataclasses.replace` with another N
        if sum(lengths) != self.N:
            raise InvalidInput(f"blocks = {lengths} cover {sum(lengths)} samples, not the N = {self.N} of the horizon")
        return lengths

    def _forget(self) -> None:
        self._qp_step.reset()
        if self._whole is not None:
            self._whole.behind = True

    def _whole_step(
        self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike, began: float
    ) -> Plan | None:
        whole = self._whole
        if whole is None:
            return None
        one_qp = self.iterations == 1 and self._solve == Riccati() and self.rest == whole.rest
        if one_qp and whole.qp_step is self._qp_step and whole.feed_forward is self._feed_forward:
            plan = whole.plan(x, theta_ref, K_ref, d, began, self._deadline(began))
            if plan is not None:
                return plan
        whole.give()
        return None

    @property
    def implementation(self) -> str:
        """Implementation of all steps: "compiled", or "readable", about forty times slower (after a `SlowStep` or
        `CompilingBeside` warning).
        """
        return self._qp_step.implementation

    @property
    def rests(self) -> bool:
        """Whether the commands come to rest at a constant reference."""
        return self.rest and self.rest_mode.worthwhile

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # non-finite results are refused below
    def qp(self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike = 0.0) -> NamedQP:
        """Return the QP that `step` would solve for these arguments, the first one if it solves `iterations` of them.

        The QP is not solved, and the controller does not change. A step that rests or has no angle solves no QP. Raises
        `InvalidInput` for implausible arguments, or if the prediction overflows.
        """
        preview = deepcopy(self._preview)
        preview.strict = True
        task = preview.task(x, theta_ref, K_ref, d, self.rest_mode.ringing)
        _, feed, previous, _ = self._situation(task, halts=False, began=0.0)
        u = self.limits.limited(previous.u, self.ladder.shift(feed.u))
        model = self._predictor.linearise(task.x, u, task.d[:-1])
        made = condense(self.problem, model, feed, *previous)
        if not (np.isfinite(made.H).all() and np.isfinite(made.f).all()):
            raise InvalidInput(f"the prediction from x = {x!r} under d = {d!r} N·m leaves the range of numbers")
        return named(self.problem, made, u, previous.u)

    # --- copies -----------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        """Create or load the solver and the compiled code."""
        self._solve = solver_of(self.solver)
        feed_forward = InverseDynamics(self.plant, self.dt, self.N, self.limits.min_force)
        self._qp_step, self._feed_forward = factory(
            self.plant, self.dt, self.problem, self._predictor, feed_forward,
            wait=self.wait, compiled=self.compiled,
        )  # fmt: skip
        self._join()

    def _join(self) -> None:
        """Join the compiled parts, if the whole ordinary step is compiled."""
        self._whole: WholeStep | None = None
        if isinstance(self._qp_step, CompiledQPStep) and isinstance(self._feed_forward, CompiledFeedForward):
            from mpc.tracking.compiled.sample import whole

            parts = whole.Parts(self._preview, self.ladder, self.rest_mode, self.rest, self.plant)
            self._whole = whole.joined(self._qp_step, self._feed_forward, parts)

    def __getstate__(self) -> dict[str, object]:
        """Leave out the solver and the compiled code, which each process creates for itself."""
        kept = {name: value for name, value in self.__dict__.items() if name not in _WORKERS}
        return kept | {"active_set": self._qp_step.active_set}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Continue from the state of the copied controller."""
        active_set = state.pop("active_set")
        self.__dict__.update(state)
        self._work()
        self._qp_step.active_set = active_set
        deepcopy(self)._rehearse()

    def __deepcopy__(self, memo: dict[int, object]) -> Self:
        """Copy all but the solver and the compiled code, which both controllers share in one process."""
        other = object.__new__(type(self))
        kept = {name: value for name, value in self.__dict__.items() if name != "_whole"}
        other.__dict__.update({name: deepcopy(value, memo) for name, value in kept.items()})
        other._join()
        return other

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _optimise(self, situation: Situation) -> Optimised:
        """Return the commands after `iterations` QPs; if the first one fails, unproved ones."""
        task, feed, previous, deadline = situation
        x, d, u = task.x, task.d[:-1], self.ladder.shift(feed.u)
        best, motion, status, spent, gap = None, None, PlanStatus.OPTIMAL, (0.0, 0.0, 0.0), 0.0
        for _ in range(self.iterations):
            if perf_counter() > deadline:
                status = status if best else PlanStatus.LATE
                break
            answer = self._qp_step(x, u, d, feed, previous, self._solve, deadline)
            spent = spent[0] + answer.times[0], spent[1] + answer.times[1], spent[2] + answer.times[2]
            if answer.status is not PlanStatus.OPTIMAL:
                if best is None:
                    best, status = self._softened(answer, previous.u, deadline), answer.status
                    motion, gap = answer.motion, answer.gap
                break
            u, motion = answer.u, answer.motion
            best = Rung.QP, u
        return Optimised(status, best, motion, spent, gap)

    def _softened(self, answer: QPAnswer, u_last: Array, deadline: float) -> tuple[Rung, Array] | None:
        """Return unproved commands: of the interrupted solver, or of the softened QP if there is time for it."""
        if answer.qp is None and answer.status is PlanStatus.UNSOLVED:
            return Rung.SOFTENED, answer.u
        if answer.qp is None or answer.status in (PlanStatus.LATE, PlanStatus.NOT_FINITE):
            return None
        if (z := softened(answer.qp, deadline)) is None:
            return None
        return Rung.SOFTENED, self.limits.limited(u_last, answer.u + self.problem.E @ z)

    def _rehearse(self) -> None:
        """Step away from the middle of all ranges, so that slew binds and all that is loaded on first use is loaded."""
        self.reset()
        budget, self.budget, plant = self.budget, None, self.plant
        (left, right), P = self.limits.theta, np.full(plant.m, np.mean(self.limits.pressure))
        x = np.concatenate([np.atleast_1d(plant.middle), np.zeros(plant.n), P])
        K = np.asarray(plant.tracked_stiffness(x))
        theta = np.clip(plant.middle + 0.1 * (right - left), left, right)
        self.step(x, theta, np.diag(np.abs(np.diag(K))) if K.ndim else K)
        self.budget = budget


_BLOCKS = 1, 1, 2, 4, 6  # lengths of the first blocks of an arm; the others are as long as the last of these
_TRIES = 5  # calls of a step that are timed
_STIFF = 20  # integration steps per sample beyond those of ordinary plants
_WORKERS = ("_solve", "_qp_step", "_feed_forward", "_whole")


def usual_blocks(plant: Machine, N: int) -> tuple[int, ...]:
    """Return the lengths of blocks, `N` in all: 1 for a joint, 1, 1, 2, 4, 6, 6, … for an arm, the last shortened."""
    if not isinstance(plant, Arm):
        return (1,) * N
    ends = accumulate(chain(_BLOCKS, repeat(_BLOCKS[-1])))
    starts = [0]
    while (end := next(ends)) < N:
        starts.append(end)
    return tuple(np.diff([*starts, N]).tolist())


class LongStep(UserWarning):
    """Warning that a controller's step takes longer than its sample time: commands are late except in simulation."""


def check_pace(step: Callable[[], object], plant: Machine, dt: float, N: int) -> None:
    """Warn with `LongStep` if even the quickest of several calls of `step` takes longer than `dt` [s].

    The thread's own CPU time counts, so that other programs do not. If the first call is quick, it is the only one.
    """
    took = inf
    for _ in range(_TRIES):
        began = thread_time()
        step()
        took = min(took, thread_time() - began)
        if took <= dt:
            return
    said = f"a step takes {1e3 * took:.3g} ms, longer than its sample dt = {1e3 * dt:g} ms: {_way_out(plant, dt, N)}"
    notice(said, LongStep)


def _way_out(plant: Machine, dt: float, N: int) -> str:
    substeps = plant.substeps(dt, RESOLUTION)
    if substeps > _STIFF:
        return (
            f"the plant moves within {1 / plant.fastest_rate:.2g} s, so that every sample takes {substeps} steps of "
            f"integration; check {plant.summary}"
        )
    return f"a horizon shorter than N = {N}, longer blocks or a longer dt take less"
