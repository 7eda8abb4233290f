"""The tracking controller is a linear time-varying MPC. This is the problem it solves at every sample:

    minimise  ½ Σ_{k=1…N-1} [|x_k - x*_k|² + |y_k - y*_k|²] + ½ Σ_{k=0…N-1} [|e_k|² + |e_k - e_{k-1}|²/dt²]
            + ½ |L ξ|²  +  ρ s + ½ ρ₂ s²  +  ρ_F s_F + ½ ρ_F₂ s_F²,       e_k = u_k - u*_k,  ξ = (x_N - x*_N, e_{N-1})
    over      u_0 … u_{N-1},  s ≥ 0,  s_F ≥ 0
    subject to  x_{k+1} = f_d(x_k, u_k, d_k),  K_k = K(x_k),  x_0 = the measured state
                P_min ≤ u_k ≤ P_max,   |u_k - u_{k-1}| ≤ slew · dt                             (hard)
                θ_min - s ≤ θ_k ≤ θ_max + s,   F_i(x_k) ≥ F_min - s_F,   k = 1…N, i = 1, 2     (soft)

The squares of the first line are weighted, entry by entry, as `mpc.tracking.cost` states; y = (K, F1, F2). θ* and K*
are the references, brought to the nearest that the joint can reach, u* and the pressures in x* = (θ*, θ*', P1*, P2*)
what follows them by the closed-form allocation (`mpc.tracking.feedforward`); L is the terminal cost
(`mpc.tracking.terminal`), and ρ, ρ_F are so dear that a slack is used only where it has to be (`mpc.tracking.penalty`).
f_d, K and F are linearised along the previous plan, moved on by one sample (`mpc.tracking.linearise`), which makes the
problem a QP in the changes of the commands (`mpc.tracking.qp.condense`); one such QP is solved per sample, or
`iterations` of them, which converge to the nonlinear problem's solution. With `blocks` the commands leave the previous
plan only where a block begins.

What a `Compensation` knows of the real joint is taken account of: the problem begins where the commands under way will
have brought the joint at the end of the dead time, the torque d_k contains the friction of the intended motion θ*, and
the commands that are sent are those that regulators with a dead band hear as u.

One QP about a plan is `mpc.tracking.qp_step`, in compiled code where that can be had (`mpc.tracking.compiled.qp_step`).

No step is without an answer. If the QP has none that passes the check of its optimality conditions
(`mpc.tracking.qp.certified`) within the time budget, the fallback ladder leads down (`mpc.tracking.ladder`). Whatever
is sent keeps the hard limits exactly.
"""

from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from math import inf, isfinite
from time import perf_counter
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.compensation import Compensation
from mpc.model.plant import NU, Plant
from mpc.tracking.compiled.factory import factory
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.ladder import Ladder, honest
from mpc.tracking.limits import LONGEST_HORIZON, Limits
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.pace import check_pace
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Foresight
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.qp.softened import softened
from mpc.tracking.qp.solvers import Solver, guarded
from mpc.tracking.qp.solvers import solver as solver_by_name
from mpc.tracking.qp_step import PreviousSample, QPAnswer
from mpc.tracking.rest import RestMode
from mpc.tracking.terminal import terminal_factor
from mpc.tracking.weights import Weights

_THINKING = 0.9  # share of the time budget for optimising; the rest predicts what the commands will do


class _Optimised(NamedTuple):
    """What optimisation came to."""

    best: tuple[Rung, Array] | None  # commands (N, 2) and the rung that they are worth
    motion: Motion | None  # under them, finite, where it is known already
    status: PlanStatus
    times: tuple[float, float, float]  # of linearising, condensing, solving [s]


@dataclass
class TrackingMPC:
    """Tracks references of angle and stiffness with `plant` as its model. It remembers its last plan.

    A time `budget` is for work in real time, where dt or less of it is there; without one a step takes what it takes.
    Without the angle it goes on from its own prediction for `patience` seconds, and then stands still (`Rung.HOLD`).
    """

    plant: Plant
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str | Solver = "daqp"  # or a name of qpsolvers
    iterations: int = 1  # QPs per step
    compensation: Compensation = field(default_factory=Compensation)  # what is known beyond the plant
    min_force: float = 0.0  # F_min [N]
    blocks: Sequence[int] | None = None  # lengths of the blocks of samples, N in all; None: every sample is one
    budget: float | None = None  # time for a step [s]
    patience: float = 0.2  # [s]
    rest: bool = True  # whether commands come to rest at a constant reference, if the compensation knows anything

    def __post_init__(self) -> None:
        """Check the settings and build what does not change."""
        self.dt = float(checks.real("dt", self.dt, "s"))
        self.limits = Limits.of(self.plant, self.dt, self.min_force)
        self.N = checks.count("N", self.N, least=3, most=LONGEST_HORIZON)
        self.iterations = checks.count("iterations", self.iterations, least=1)
        self.blocks = _blocks(self.blocks, self.N)
        self.patience = checks.not_negative("patience", self.patience, "s")
        self.budget = None if self.budget is None else checks.not_negative("budget", self.budget, "s")
        self._predictor = Predictor(self.plant, self.dt, self.N)
        L = terminal_factor(self.plant, self.dt, self.weights)
        self._foresight = Foresight(self.plant, self.dt, self.N, self.compensation, self.limits)
        self.rest_mode = RestMode(self.plant, self.dt, self.compensation, self.limits)
        self.ladder = Ladder(self.limits, self._predictor)
        self.problem = TrackingProblem(self.weights, self.limits, L, self.blocks, self.dt)
        self._work()
        check_pace(self._rehearse, self.plant, self.dt, self.N)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next step begins from the pressures it measures."""
        self._foresight.reset()
        self.rest_mode.reset()
        self.ladder.reset()
        self._qp_step.reset()
        self._u_star: Array | None = None  # the feed-forward of the last sample (2,)

    @property
    def implementation(self) -> str:
        """How a step is computed: "compiled", or "readable", about ten times as slowly (then `SlowStep` has warned)."""
        return self._qp_step.implementation

    @property
    def rests(self) -> bool:
        """Whether its commands come to rest at a constant reference."""
        known = self.compensation
        return self.rest and not (known.friction.absent and known.dead_band == 0)

    @property
    def ahead(self) -> int:
        """Samples of preview that `step` takes after the present one."""
        return self._foresight.ahead

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # numbers out of range: the ladder looks for them
    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """The plan from the measured state `x` (4,) for references θ [rad] and K [N·m/rad].

        A reference is a value, held for the whole horizon, or a preview (ahead + 1,) that begins now. `d` is the
        disturbance torque [N·m] known to act. What is NaN in `x`, or beyond what the joint can do, is replaced by what
        the last plan predicted. Numbers never make it raise: where they cannot be meant the status says so. Raises
        `InvalidInput` for shapes and kinds that are wrong.
        """
        clock = [perf_counter()]
        deadline = clock[0] + (inf if self.budget is None else _THINKING * self.budget)
        task = self._foresight.task(x, theta_ref, K_ref, d, self.rest_mode.ringing)
        held = self.rest_mode.pressures(task) if self.rests else None
        x, torques = task.x, task.d[:-1]
        feed = self._feed_forward(task.theta, task.K, task.d)
        u_last = self.ladder.u_last(x)
        clock.append(perf_counter())

        if halted := task.halted(self.patience):
            found = _Optimised(None, None, halted, (0.0, 0.0, 0.0))
        elif held is not None:
            u = self.limits.limited(u_last, np.tile(held, (self.N, 1)))
            found = _Optimised((Rung.ALLOCATION, u), None, PlanStatus.RESTING, (0.0, 0.0, 0.0))
        else:
            found = self._optimise(x, feed, u_last, torques, deadline)
        if found.motion is not None:
            rung, motion = Rung.QP, found.motion
        else:
            rung, motion = self.ladder.descend(x, found.best, halted is not None, feed.u, u_last, torques)
        clock.append(perf_counter())
        self.ladder.stand(rung, motion)
        if not task.refused and isfinite(feed.u[0, 0]) and isfinite(feed.u[0, 1]):
            self._u_star = feed.u[0]
        return Plan(
            self._foresight.spoken(motion.u, motion.x, self.rest_mode.side if self.rest_mode.resting else 0.0),
            motion.x,
            motion.K,
            honest(found.status, rung, task.measured),
            rung,
            self.limits.excursion(motion.x[:, 0]),
            Times(clock[1] - clock[0], *found.times, clock[2] - clock[0]),
            self.limits.slackening(motion.F[1:]),
            None if task.refused else feed.moved,
        )

    # --- copies -----------------------------------------------------------------------------------------------------

    def _work(self) -> None:
        """Make or load what does the work of a step: the solver, and compiled code."""
        self._solve = solver_by_name(self.solver) if isinstance(self.solver, str) else guarded(self.solver)
        feed_forward = InverseDynamics(self.plant, self.dt, self.N, self.limits.min_force)
        self._qp_step, self._feed_forward = factory(self.plant, self.dt, self.problem, self._predictor, feed_forward)

    def __getstate__(self) -> dict[str, Any]:
        """Without what does the work, which each process makes for itself."""
        kept = {name: value for name, value in self.__dict__.items() if name not in _WORKERS}
        return kept | {"active_set": self._qp_step.active_set}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Go on where the copied one was."""
        active_set = state.pop("active_set")
        self.__dict__.update(state)
        self._work()
        self._qp_step.active_set = active_set
        deepcopy(self)._rehearse()

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        """Of the memory: in the same process the work can be done as before."""
        other = object.__new__(type(self))
        other.__dict__.update({name: deepcopy(value, memo) for name, value in self.__dict__.items()})
        return other

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _rehearse(self) -> None:
        """A step from the middle of all ranges away, so that slew binds; what the first use loads is loaded now."""
        self.reset()
        budget, self.budget = self.budget, None
        P = np.full(NU, np.mean(self.limits.pressure))
        x = np.array([np.mean(self.limits.theta), 0.0, *P])
        self.step(x, float(np.quantile(self.limits.theta, 0.6)), float(self.plant.stiffness(x)))
        self.budget = budget

    def _optimise(self, x: Array, feed: FeedForward, u_last: Array, d: Array, deadline: float) -> _Optimised:
        """The commands after `iterations` QPs, or up to one that failed; the softened QP's if it was the first."""
        u = self.ladder.onward(feed.u)
        previous = PreviousSample(u_last, feed.u[0] if self._u_star is None else self._u_star)
        best, motion, status, spent = None, None, PlanStatus.OPTIMAL, (0.0, 0.0, 0.0)
        for _ in range(self.iterations):
            if perf_counter() > deadline:
                status = status if best else PlanStatus.LATE
                break
            step = self._qp_step(x, u, d, feed, previous, self._solve, deadline)
            spent = spent[0] + step.times[0], spent[1] + step.times[1], spent[2] + step.times[2]
            if step.status is not PlanStatus.OPTIMAL:
                if best is None:
                    best, status = self._softened(step, u_last, deadline), step.status
                break
            u, motion = step.u, step.motion
            best = Rung.QP, u
        return _Optimised(best, motion, status, spent)

    def _softened(self, step: QPAnswer, u_last: Array, deadline: float) -> tuple[Rung, Array] | None:
        """The next rung, if there is time for it and numbers to work with."""
        if step.qp is None or step.status in (PlanStatus.LATE, PlanStatus.NOT_FINITE):
            return None
        if (z := softened(step.qp, deadline)) is None:
            return None
        return Rung.SOFTENED, self.limits.limited(u_last, step.u + self.problem.E @ z)


_WORKERS = ("_solve", "_qp_step", "_feed_forward")


def _blocks(blocks: Sequence[int] | None, N: int) -> tuple[int, ...]:
    if blocks is None:
        return (1,) * N
    lengths = tuple(checks.count("a length of blocks", length, least=1) for length in blocks)
    if sum(lengths) != N:
        raise InvalidInput(f"blocks = {lengths} cover {sum(lengths)} samples, not the N = {N} of the horizon")
    return lengths


__all__ = ["TrackingMPC"]
