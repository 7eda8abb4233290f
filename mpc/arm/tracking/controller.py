"""The MPC of an arm is a controller of all its muscles: angles and stiffness matrix follow references.

It is the controller of `mpc.tracking.controller`, with vectors where that has numbers: the state x = (q, ω, P) ∈
R^(2n+m), outputs y = (svec K, F) and a torque d from outside at every joint. The same squares are charged, the same
limits are kept: supply and slew by every command, hard; the range of every joint and taut muscles, soft, with one slack
for all angles and one for all forces. Its stages are those of `mpc.tracking.base`, its QP is that of
`mpc.tracking.qp.condense`, and the fallback ladder that of `mpc.tracking.fallback`.

The decisions are changes of the commands at the beginnings of blocks, which grow along the horizon.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, chain, repeat
from typing import Any

import numpy as np

from allocator import checks
from mpc.arm.model import Arm
from mpc.arm.tracking.compiled.factory import factory
from mpc.arm.tracking.feedforward import ArmInverseDynamics
from mpc.arm.tracking.prediction import predictor_of
from mpc.arm.tracking.preview import ArmPreview
from mpc.arm.tracking.problem import problem_of
from mpc.tracking.fallback import Ladder
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Motion
from mpc.tracking.optimising import OptimisingController
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times, status_of
from mpc.tracking.qp.solvers import Solver
from mpc.tracking.qp.solvers import solver as solver_of
from mpc.tracking.weights import Weights

_BLOCKS = 1, 1, 2, 4, 6  # lengths of the first blocks; the others are as long as the last of these


class _NoRest:
    """An arm's controller has no rest mode: its commands follow the MPC at a constant reference, too."""

    ringing, worthwhile, side = False, False, 0.0

    def reset(self) -> None:
        """Do nothing."""


@dataclass
class ArmMPC(OptimisingController):
    """The MPC of an `arm` follows previews of angles (n) and stiffness (n, n). It remembers its last plan.

    References are values (n,) [rad] and (n, n) [N·m/rad], or previews (ahead + 1, …) of them that begin now; d are the
    known torques from outside, (n,) or one for all [N·m]. The arrays of a `Plan` are u (N, m) [Pa], x (N+1, 2n + m) and
    K (N+1, n, n).

    A time `budget` is for work in real time, where dt or less of it is there; without one a step takes what it takes.
    Without one of the angles it goes on from its own prediction for `patience` seconds, and then holds the pressures.
    Raises `InvalidInput` for settings that make no sense, and for muscles that are not affine in the pressure.
    """

    arm: Arm
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)  # of every joint, entry of K and muscle
    solver: str | Mapping[str, Any] | Solver = "daqp"
    iterations: int = 1  # QPs per step
    dead_time: float = 0.0  # of the commands [s]
    min_force: float = 0.0  # F_min [N]
    blocks: Sequence[int] | None = None  # lengths of the blocks of samples, N in all; None: 1, 1, 2, 4, 6, 6, …
    budget: float | None = None  # time for a step [s]
    patience: float = 0.2  # [s]

    def __post_init__(self) -> None:
        """Check the settings and build what does not change."""
        self.blocks = self._check_settings(growing)
        self.dead_time = checks.not_negative("dead_time", self.dead_time, "s")
        self.muscles = self.arm.m
        self.limits = limits = Limits.of(self.arm, self.dt, self.min_force)
        delay, predictor = round(self.dead_time / self.dt), predictor_of(self.arm, self.dt, self.N)
        self._preview: Any = ArmPreview(self.arm, self.dt, self.N, delay, limits)  # in place of a joint's
        self.rest_mode: Any = _NoRest()
        self.ladder = Ladder(limits, predictor)  # type: ignore[arg-type]  # it asks no more of a predictor
        self.problem = problem_of(self.arm, self.dt, self.weights, limits, self.blocks)
        self._solve = solver_of(self.solver)
        inverse = ArmInverseDynamics(self.arm, self.dt, self.N, self.min_force)
        self._qp_step, made = factory(self.arm, self.dt, self.problem, predictor, inverse)
        self._feed_forward: Any = made
        self._rehearse()
        self.reset()

    @property
    def implementation(self) -> str:
        """The implementation of a step is "compiled", or "readable", some ten times as slowly."""
        return self._qp_step.implementation

    def step(self, x: Any, q_ref: Any, K_ref: Any, d: Any = 0.0) -> Plan:
        """Return the plan from the measured state `x` (2n + m,) for references and torques as the class says.

        What is NaN in `x`, or beyond what the arm can do, is replaced by what the last plan predicted. Numbers never
        make it raise: where they cannot be meant the status says so. Raises `InvalidInput` for wrong shapes and kinds.
        """
        return super().step(x, q_ref, K_ref, d)

    def _forget(self) -> None:
        self._qp_step.reset()

    def _rehearse(self) -> None:
        """Step once from the middle of all ranges: what the first use loads is loaded now."""
        self.reset()
        budget, self.budget = self.budget, None
        (left, right), P = self.limits.theta, np.full(self.arm.m, np.mean(self.limits.pressure))
        x = np.concatenate([self.arm.middle, np.zeros(self.arm.n), P])
        q = np.clip(self.arm.middle + 0.1 * (right - left), left, right)
        self.step(x, q, np.diag(np.abs(np.diag(self.arm.tracked_stiffness(x)))))
        self.budget = budget

    def _plan(self, situation: Any, status: PlanStatus, rung: Rung, motion: Motion, side: float, times: Times) -> Plan:
        """Return what is sent for `motion`, and what is said of it."""
        task, feed = situation.task, situation.feed
        return Plan(
            self._preview.sent(motion.u, motion.x, side),
            motion.x,
            self.arm.matrix(motion.K),
            status_of(status, rung, task.measured),
            rung,
            self.limits.excursion(motion.x[:, : self.arm.n]),
            times,
            self.limits.slackening(motion.F[1:]),
            None if task.refused else feed.moved,
        )


def growing(N: int) -> tuple[int, ...]:
    """Return the lengths 1, 1, 2, 4, 6, 6, … of blocks, `N` in all, the last one shortened."""
    ends = accumulate(chain(_BLOCKS, repeat(_BLOCKS[-1])))
    starts = [0]
    while (end := next(ends)) < N:
        starts.append(end)
    return tuple(np.diff([*starts, N]).tolist())
