"""Base class of tracking controllers: the stages of a control step, independent of the method of optimisation."""

from abc import ABC, abstractmethod
from math import inf
from threading import RLock
from time import perf_counter
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.model.real import RealPlant
from mpc.observer.base import units_shown
from mpc.tracking.fallback import Ladder
from mpc.tracking.feedforward import FeedForward, FeedForwardOf
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Motion, Predictor
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times, status_of
from mpc.tracking.preview import Preview, Task
from mpc.tracking.qp.step import PreviousSample
from mpc.tracking.rest import RestMode

_SHARE = 0.9  # [-] of the time budget, for optimising; the rest is for predicting the motion


class Situation(NamedTuple):
    """Starting point of the optimisation."""

    task: Task
    feed: FeedForward
    previous: PreviousSample
    deadline: float  # [s] on the clock of `perf_counter`


class Optimised(NamedTuple):
    """Result of the optimisation, or the reason why there is none."""

    status: PlanStatus
    best: tuple[Rung, Array] | None = None  # commands (N, m) and their rung of the ladder
    motion: Motion | None = None  # under these commands, if already known
    times: tuple[float, float, float] = (0.0, 0.0, 0.0)  # of linearising, condensing, solving [s]
    gap: float = 0.0  # see `Plan`


class Turns:
    """Lock of an object whose threads take turns; copies of the object have their own."""

    def __init__(self) -> None:
        self._lock = RLock()  # a signal may interrupt a step and begin another one

    def __enter__(self) -> None:
        self._lock.acquire()

    def __exit__(self, *error: object) -> None:
        self._lock.release()

    def __reduce__(self) -> tuple[type["Turns"], tuple[()]]:
        return Turns, ()


class BaseController(ABC):
    """Base of controllers. A step computes a `Plan` from a measured state and references, in stages with one result
    each:

        inputs checked    `Task`         valid references from the time a command acts     `mpc.tracking.preview`
        feed-forward      `FeedForward`  state, outputs and commands that follow them       `mpc.tracking.feedforward`
        optimise          `Optimised`    commands and their status, by the subclass         `_optimise`
        ladder            `Motion`       of the best commands with a finite prediction      `mpc.tracking.fallback`
        plan              `Plan`         commands, their status and predicted motion        `mpc.tracking.plan`

    Subclasses define the attributes below; `_build` sets the common ones.
    """

    plant: Any  # a `Machine`
    dt: float  # sample time [s]
    compensation: Compensation
    patience: float  # longest time without a measured angle [s]
    budget: float | None = None  # greatest duration of a step [s]
    rest: bool = False  # whether commands rest at a constant reference, if the compensation has effects
    machines: ClassVar[tuple[type, ...]] = (Plant,)  # supported types of plants
    says_moved: ClassVar[bool] = True  # whether plans report moves of the references
    _feed_forward: FeedForwardOf
    _units_shown: bool = False  # whether a state since the last reset has shown the units

    def __repr__(self) -> str:
        return f"{type(self).__name__}: samples of {1e3 * self.dt:g} ms; model: {self.plant.summary}"

    def _check_model(self) -> None:
        """Raise `InvalidInput` unless plant and compensation have the right types."""
        if not isinstance(self.plant, self.machines):
            known = " or ".join(f"{'an' if kind is Arm else 'a'} {kind.__name__}" for kind in self.machines)
            of_nominal = "; a RealPlant's model is its nominal" if isinstance(self.plant, RealPlant) else ""
            raise InvalidInput(f"plant = {checks.brief(self.plant)} has to be {known}{of_nominal}")
        if not isinstance(self.compensation, Compensation):
            raise InvalidInput(f"compensation = {checks.brief(self.compensation)} has to be a Compensation")

    def _build(self, N: int, min_force: float = 0.0) -> None:
        self._turns = Turns()
        self.limits = Limits.of(self.plant, self.dt, min_force)
        self._predictor = Predictor(self.plant, self.dt, N)
        self._preview = Preview(self.plant, self.dt, N, self.compensation, self.limits)
        self.rest_mode = RestMode(self.plant, self.dt, self.compensation, self.limits)
        self.ladder = Ladder(self.limits, self._predictor)

    def reset(self) -> None:
        """Forget the past, so that the next step begins from the measured pressures."""
        with self._turns:
            self._units_shown = False
            self._preview.reset()
            self.rest_mode.reset()
            self.ladder.reset()
            self._forget()

    @property
    def ahead(self) -> int:
        """Number of preview samples that `step` takes after the present one."""
        return self._preview.ahead

    def step(self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike = 0.0) -> Plan:
        """Return the plan from the measured state `x` (2n + m,) for references θ [rad] and K [N·m/rad].

        A reference is a value, held for the whole horizon, or a preview (ahead + 1, …) that begins now; the values of
        an arm are (n,) and (k, k). `d` is the disturbance torque [N·m] known to act, of an arm also (n,). Entries
        of `x` that are NaN or physically impossible are replaced by the prediction of the last plan. No number makes
        this method raise: invalid ones are reported by the status. Threads that share a controller take turns. Warns
        (`BadNumbers`) if the first pressures above 0 look like bar, or angles like degrees. Raises `InvalidInput` for
        wrong shapes and types.
        """
        began = perf_counter()
        if not self._units_shown:
            self._point_out_units(x)
        with self._turns:
            return self._whole_step(x, theta_ref, K_ref, d, began) or self._staged(x, theta_ref, K_ref, d, began)

    def _point_out_units(self, x: object) -> None:
        """Warn of pressures that look like bar, and of angles that look like degrees."""
        state, n = checks.floats("x", x, "rad, rad/s, Pa"), self.plant.n
        if state.shape == (self.plant.size,):  # the preview refuses others
            self._units_shown = units_shown("x", state[2 * n :], state[:n])

    @np.errstate(over="ignore", invalid="ignore", divide="ignore")  # the ladder rejects non-finite plans
    def _staged(self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike, began: float) -> Plan:
        """Return the plan after all stages."""
        task = self._preview.task(x, theta_ref, K_ref, d, self.rest_mode.ringing)
        held = self.rest_mode.pressures(task) if self.rest and self.rest_mode.worthwhile else None
        halted = task.halted(self.patience)
        situation = self._situation(task, halted is not None, began)
        fed = perf_counter()
        if halted:
            found = Optimised(halted)
        elif held is not None:
            found = self._approach(held, situation)
        else:
            found = self._optimise(situation)
        feed, u_last = situation.feed, situation.previous.u
        if found.best is not None and found.motion is not None:
            rung, motion = found.best[0], found.motion
        else:
            rung, motion = self.ladder.descend(task.x, found.best, halted is not None, feed.u, u_last, task.d[:-1])
        times = Times(fed - began, *found.times, perf_counter() - began)
        self.ladder.remember(rung, motion, None if task.refused else feed.u[0])
        gap = found.gap if rung in (Rung.QP, Rung.SOFTENED) else inf
        side = 0.0 if held is None else self.rest_mode.side
        return self._plan(situation, found.status, rung, motion, side, times, gap)

    # --- hooks for subclasses -------------------------------------------------------------------------------------

    @abstractmethod
    def _optimise(self, situation: Situation) -> Optimised:
        """Return the best commands by the subclass's criterion."""

    def _whole_step(
        self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike, began: float
    ) -> Plan | None:
        """Return the same plan by compiled code; None, with the controller unchanged, if that is impossible."""
        return None

    def _forget(self) -> None:
        """Forget the state of the subclass."""
        return None

    def _torques(self, task: Task) -> Array:
        """Return the torques (N+1,) [N·m] for the feed-forward."""
        return task.d

    # --- the stages -------------------------------------------------------------------------------------------------

    def _situation(self, task: Task, halts: bool, began: float) -> Situation:
        """Return the situation of `task`, with its feed-forward."""
        feed = self._feed_forward(task.theta, task.K, task.d if halts else self._torques(task))
        return Situation(task, feed, self.ladder.previous(task.sent, feed.u[0]), self._deadline(began))

    def _deadline(self, began: float) -> float:
        """Return the time at which the optimisation has to end [s]."""
        return inf if self.budget is None else began + _SHARE * self.budget

    def _approach(self, P: Array, situation: Situation) -> Optimised:
        """Return commands that approach the rest pressures `P` (m,)."""
        u = self.limits.limited(situation.previous.u, np.tile(P, (self._predictor.N, 1)))
        return Optimised(PlanStatus.RESTING, (Rung.ALLOCATION, u))

    def _plan(
        self,
        situation: Situation,
        status: PlanStatus,
        rung: Rung,
        motion: Motion,
        side: float,
        times: Times,
        gap: float,
    ) -> Plan:
        """Return the plan of `motion`; `side` is the edge of the dead band to stay on."""
        task, feed = situation.task, situation.feed
        return Plan(
            self._preview.sent(motion.u, motion.x, side),
            motion.x,
            self.plant.matrix(motion.K),
            status_of(status, rung, task.measured),
            rung,
            self.limits.excursion(self.plant.angles(motion.x)),
            times,
            self.limits.slackening(motion.F[1:]),
            feed.moved if self.says_moved and not task.refused else None,
            gap,
        )
