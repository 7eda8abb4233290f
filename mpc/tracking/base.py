"""A controller's step has one skeleton, whatever optimises: the stages that `BaseController` names, in that order."""

from abc import ABC, abstractmethod
from math import inf, isfinite
from time import perf_counter
from typing import Any, ClassVar, NamedTuple, Protocol

import numpy as np

from allocator.calculus import Array
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.ladder import Ladder, status_of
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Preview, Task
from mpc.tracking.qp_step import PreviousSample

_SHARE = 0.9  # of the time budget for optimising; the rest predicts what the commands will do


class Held(NamedTuple):
    """The pressures of a rest, and the edge of the dead band on which the regulators hold them."""

    P: Array  # (2,) [Pa]
    side: float  # 1 or -1


class Situation(NamedTuple):
    """The situation is what optimisation starts from."""

    task: Task
    feed: FeedForward
    previous: PreviousSample
    deadline: float  # [s] on the clock of `perf_counter`


class Optimised(NamedTuple):
    """The result of optimisation, or why there is none."""

    status: PlanStatus
    best: tuple[Rung, Array] | None = None  # commands (N, 2) and the rung that they are worth
    motion: Motion | None = None  # under them, where it is known already
    times: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of linearising, condensing, solving [s]


class _FeedForwardOf(Protocol):
    def __call__(self, theta: Array, K: Array, d: Array, /) -> FeedForward:
        """Return the feed-forward for references and torques (N+1,)."""


class BaseController(ABC):
    """A controller makes a `Plan` of a measured state and references, in stages, each with a noun for its result:

        inputs checked    `Task`         what can be meant, from when a command acts on    `mpc.tracking.preview`
        feed-forward      `FeedForward`  state, outputs, commands that would follow it      `mpc.tracking.feedforward`
        optimise          `Optimised`    commands and their status: what a member fills in  `_optimise`
        ladder            `Motion`       of the best commands whose prediction is finite    `mpc.tracking.ladder`
        plan              `Plan`         what is sent, how it came about, where it leads    `mpc.tracking.plan`

    A member has the attributes below; `_build` makes those that all of them have in common.
    """

    plant: Plant
    dt: float  # sample time [s]
    compensation: Compensation
    patience: float  # for how long the angle may be missing [s]
    budget: float | None = None  # time for a step [s]
    says_moved: ClassVar[bool] = True  # whether its plans say how far the references were moved
    _feed_forward: _FeedForwardOf

    def _build(self, N: int, min_force: float = 0.0) -> None:
        self.limits = Limits.of(self.plant, self.dt, min_force)
        self._predictor = Predictor(self.plant, self.dt, N)
        self._preview = Preview(self.plant, self.dt, N, self.compensation, self.limits)
        self.ladder = Ladder(self.limits, self._predictor)

    def reset(self) -> None:
        """Forget the past: the next step begins from the pressures it measures."""
        self._preview.reset()
        self.ladder.reset()
        self._u_star: Array | None = None  # the feed-forward of the previous sample (2,)
        self._forget()

    @property
    def ahead(self) -> int:
        """The samples of preview that `step` takes after the present one."""
        return self._preview.ahead

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """Return the plan from the measured state `x` (4,) for references θ [rad] and K [N·m/rad].

        A reference is a value, held for the whole horizon, or a preview (ahead + 1,) that begins now. `d` is the
        disturbance torque [N·m] known to act. What is NaN in `x`, or beyond what the joint can do, is replaced by what
        the last plan predicted. Numbers never make it raise: where they cannot be meant the status says so. Raises
        `InvalidInput` for shapes and kinds that are wrong.
        """
        began = perf_counter()
        with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # the ladder looks for what is not finite
            task = self._preview.task(x, theta_ref, K_ref, d, self._ringing)
            held, halted = self._held(task), task.halted(self.patience)
            situation = self._situation(task, halted is not None, began)
            fed = perf_counter()
            if halted:
                found = Optimised(halted)
            elif held is not None:
                found = self._resting_at(situation, held)
            else:
                found = self._optimise(situation)
            rung, motion = self._descended(situation, found, halted is not None)
            times = Times(fed - began, *found.times, perf_counter() - began)
            self._remember(situation, rung, motion)
            return self._plan(situation, found.status, rung, motion, held, times)

    # --- what a member may fill in ----------------------------------------------------------------------------------

    @abstractmethod
    def _optimise(self, situation: Situation) -> Optimised:
        """Return the commands that are best by the member's lights."""

    def _forget(self) -> None:
        """Forget what the member remembers beyond the skeleton."""
        return None

    def _torques(self, task: Task) -> Array:
        """Return the torques (N+1,) [N·m] that the feed-forward reckons with."""
        return task.d

    def _held(self, task: Task) -> Held | None:
        """Return what to rest at; None: no rest. It is asked at every sample."""
        return None

    @property
    def _ringing(self) -> bool:
        """The joint swings by itself: see `mpc.tracking.rest`."""
        return False

    # --- the stages -------------------------------------------------------------------------------------------------

    def _situation(self, task: Task, halts: bool, began: float) -> Situation:
        """Return the situation of `task`, with its feed-forward."""
        feed = self._feed_forward(task.theta, task.K, task.d if halts else self._torques(task))
        u_star = feed.u[0] if self._u_star is None else self._u_star
        deadline = inf if self.budget is None else began + _SHARE * self.budget
        return Situation(task, feed, PreviousSample(self.ladder.u_last(task.x), u_star), deadline)

    def _resting_at(self, situation: Situation, held: Held) -> Optimised:
        """Return the approach to the pressures of a rest."""
        u = self.limits.limited(situation.previous.u, np.tile(held.P, (self._predictor.N, 1)))
        return Optimised(PlanStatus.RESTING, (Rung.ALLOCATION, u))

    def _descended(self, situation: Situation, found: Optimised, blind: bool) -> tuple[Rung, Motion]:
        """Return the rung that bears, and the motion under its commands."""
        if found.best is not None and found.motion is not None:
            return found.best[0], found.motion
        task, feed, previous, _ = situation
        return self.ladder.descend(task.x, found.best, blind, feed.u, previous.u, task.d[:-1])

    def _remember(self, situation: Situation, rung: Rung, motion: Motion) -> None:
        """Remember for the next sample what is commanded at this one."""
        self.ladder.remember(rung, motion)
        u_star = situation.feed.u[0]
        if not situation.task.refused and isfinite(u_star[0]) and isfinite(u_star[1]):
            self._u_star = u_star

    def _plan(
        self, situation: Situation, status: PlanStatus, rung: Rung, motion: Motion, held: Held | None, times: Times
    ) -> Plan:
        """Return what is sent for `motion`, and what is said of it."""
        task, feed = situation.task, situation.feed
        return Plan(
            self._preview.sent(motion.u, motion.x, 0.0 if held is None else held.side),
            motion.x,
            motion.K,
            status_of(status, rung, task.measured),
            rung,
            self.limits.excursion(motion.x[:, 0]),
            times,
            self.limits.slackening(motion.F[1:]),
            feed.moved if self.says_moved and not task.refused else None,
        )


__all__ = ["BaseController", "Held", "Optimised", "Situation"]
