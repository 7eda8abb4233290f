"""The same problem as in `mpc.tracking.controller`, not linearised: the yardstick of `TrackingMPC`.

At every sample the nonlinear programme of `mpc.yardsticks.shooting` is solved to the end by IPOPT or by fatrop, begun
at the previous plan moved on by one sample. It has what `TrackingMPC` has besides: the same look ahead by the dead
time, the same feed-forward, and the fallback ladder (`mpc.tracking.ladder`) without its second rung. A solution is one
if it satisfies the conditions of Karush, Kuhn and Tucker, computed here; of a problem that is not convex these tell a
local minimum from no minimum, not from a better one elsewhere. `Rung.QP` is the rung of such a solution.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.ladder import Ladder, honest
from mpc.tracking.limits import LONGEST_HORIZON, Limits
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times
from mpc.tracking.preview import Foresight
from mpc.tracking.terminal import terminal_factor
from mpc.tracking.weights import Weights
from mpc.yardsticks.nlp_solvers import NLPSolver
from mpc.yardsticks.shooting import Shooting

_TOLERANCE = 1e-6  # of the conditions, in the units of `mpc.yardsticks.shooting`


@dataclass
class NonlinearMPC:
    """Tracks references of angle and stiffness with `plant` as its model; the words are those of `TrackingMPC`."""

    plant: Plant
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str = "ipopt"  # or "fatrop"
    compensation: Compensation = field(default_factory=Compensation)  # what is known beyond the plant
    min_force: float = 0.0  # F_min [N]
    patience: float = 0.2  # for how long the angle may be missing [s]

    def __post_init__(self) -> None:
        """Check the settings and build what does not change."""
        self.dt = float(checks.real("dt", self.dt, "s"))
        self.N = checks.count("N", self.N, least=3, most=LONGEST_HORIZON)
        self.limits = Limits.of(self.plant, self.dt, self.min_force)
        L = terminal_factor(self.plant, self.dt, self.weights)
        self.problem = Shooting(self.plant, self.dt, self.N, self.weights, self.limits, L)
        self._solve = NLPSolver(self.solver, self.problem)
        self._predictor = Predictor(self.plant, self.dt, self.N)
        self._feed_forward = InverseDynamics(self.plant, self.dt, self.N, self.limits.min_force).ready()
        self._foresight = Foresight(self.plant, self.dt, self.N, self.compensation, self.limits)
        self.ladder = Ladder(self.limits, self._predictor)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next step begins from the pressures it measures."""
        self._foresight.reset()
        self.ladder.reset()
        self._u_star: Array | None = None  # the feed-forward of the last sample (2,)

    @property
    def ahead(self) -> int:
        """Samples of preview that `step` takes after the present one."""
        return self._foresight.ahead

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """The plan from the measured state `x` (4,) for references θ [rad] and K [N·m/rad], as `TrackingMPC.step`."""
        clock = [perf_counter()]
        task = self._foresight.task(x, theta_ref, K_ref, d)
        x, torques = task.x, task.d[:-1]
        feed = self._feed_forward(task.theta, task.K, task.d)
        u_last = self.ladder.u_last(x)
        clock.append(perf_counter())
        halted = task.halted(self.patience)
        found, status = (None, halted) if halted else self._optimise(x, feed, u_last, torques)
        clock.append(perf_counter())
        rung, motion = self.ladder.descend(x, found, halted is not None, feed.u, u_last, torques)
        self.ladder.stand(rung, motion)
        if not task.refused and np.isfinite(feed.u[0]).all():
            self._u_star = feed.u[0]
        return Plan(
            self._foresight.spoken(motion.u, motion.x),
            motion.x,
            motion.K,
            honest(status, rung, task.measured),
            rung,
            self.limits.excursion(motion.x[:, 0]),
            Times(clock[1] - clock[0], 0.0, 0.0, clock[2] - clock[1], perf_counter() - clock[0]),
            self.limits.slackening(motion.F[1:]),
            None if task.refused else feed.moved,
        )

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _optimise(
        self, x: Array, feed: FeedForward, u_last: Array, d: Array
    ) -> tuple[tuple[Rung, Array] | None, PlanStatus]:
        """The commands of the first start that leads to a solution, or why none did."""
        u_star_last = feed.u[0] if self._u_star is None else self._u_star
        given = self.problem.given(x, feed, d, u_last, u_star_last)
        if not np.isfinite(given.p).all():
            return None, PlanStatus.NOT_FINITE
        status = PlanStatus.NOT_FINITE
        for begun in self._starts(x, feed, u_last, d):
            z, multipliers, success = self._solve(begun, given)
            if self.problem.certify(z, multipliers, given).within(_TOLERANCE):
                return (Rung.QP, self.limits.limited(u_last, self.problem.commands(z))), PlanStatus.OPTIMAL
            status = PlanStatus.REFUSED if success else PlanStatus.UNSOLVED
        return None, status

    def _starts(self, x: Array, feed: FeedForward, u_last: Array, d: Array) -> Iterator[Array]:
        """Where to begin: the previous plan moved on, the feed-forward, standing commands."""
        for u in (
            self.limits.limited(u_last, self.ladder.onward(feed.u)),
            self.limits.limited(u_last, feed.u),
            np.tile(u_last, (self.N, 1)),
        ):
            motion = self._predictor.motion(x, u, d)
            if motion.finite:
                yield self.problem.point(motion, u_last)


__all__ = ["NonlinearMPC"]
