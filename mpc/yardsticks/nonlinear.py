"""Nonlinear MPC for the problem in `mpc.tracking.controller` without linearisation: the yardstick of `TrackingMPC`.

At every sample IPOPT or fatrop solves the nonlinear programme of `mpc.yardsticks.shooting` to convergence, from the
previous plan shifted by one sample. The prediction over the dead time and the feed-forward are those of `TrackingMPC`,
and so is the fallback ladder (`mpc.tracking.fallback`) without its second rung. A solution has to satisfy the
conditions of Karush, Kuhn and Tucker, computed in this package. For a problem that is not convex they identify a local
minimum, but there may be a better one elsewhere. `Rung.QP` is the rung of such a solution.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.cost import Weights
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import LONGEST_HORIZON
from mpc.tracking.plan import PlanStatus, Rung
from mpc.tracking.terminal import terminal_factor
from mpc.yardsticks.shooting import NLPOptions, NLPSolver, Shooting

_TOLERANCE = 1e-6  # of the conditions, in the units of `mpc.yardsticks.shooting`


@dataclass(repr=False)
class NonlinearMPC(BaseController):
    """Nonlinear MPC that tracks references of angle and stiffness with `plant` as its model.

    `BaseController` defines its step, and its settings are those of `TrackingMPC`. The optimisation solves the
    nonlinear programme from one start after the other.
    """

    plant: Plant
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str | Mapping[str, object] | NLPOptions = "ipopt"  # or "fatrop", or options, or `IPOPT(…)`, `Fatrop(…)`
    compensation: Compensation = field(default_factory=Compensation)  # of the real joint
    min_force: float = 0.0  # F_min [N]
    patience: float = 0.2  # longest time without a measured angle [s]

    def __post_init__(self) -> None:
        """Check the settings and build the constant parts."""
        self._check_model()
        if not isinstance(self.weights, Weights):
            raise InvalidInput(f"weights = {checks.brief(self.weights)} have to be Weights")
        self.dt = checks.number("dt", self.dt, "s")
        self.N = checks.count("N", self.N, least=3, most=LONGEST_HORIZON)
        self._build(self.N, self.min_force)
        L = terminal_factor(self.plant, self.dt, self.weights)
        self.problem = Shooting(self.plant, self.dt, self.N, self.weights, self.limits, L)
        self._solve = NLPSolver(self.solver, self.problem)
        self._feed_forward = InverseDynamics(self.plant, self.dt, self.N, self.limits.min_force).ready()
        self.reset()

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _optimise(self, situation: Situation) -> Optimised:
        """Return the commands of the first start that leads to a solution, or the reason why there is none."""
        began, task, feed, previous = perf_counter(), situation.task, situation.feed, situation.previous
        given = self.problem.given(task.x, feed, task.d[:-1], previous.u, previous.u_star)
        best, status = None, PlanStatus.NOT_FINITE
        for start in self._starts(situation) if np.isfinite(given.p).all() else ():
            z, multipliers, success = self._solve(start, given)
            if self.problem.certify(z, multipliers, given).within(_TOLERANCE):
                best = Rung.QP, self.limits.limited(previous.u, self.problem.commands(z))
                status = PlanStatus.OPTIMAL
                break
            status = PlanStatus.REFUSED if success else PlanStatus.UNSOLVED
        return Optimised(status, best, times=(0.0, 0.0, perf_counter() - began))

    def _starts(self, situation: Situation) -> Iterator[Array]:
        """Yield initial motions: the previous plan shifted, the feed-forward, constant commands."""
        task, feed, u_last = situation.task, situation.feed, situation.previous.u
        for u in (
            self.limits.limited(u_last, self.ladder.shift(feed.u)),
            self.limits.limited(u_last, feed.u),
            np.tile(u_last, (self.N, 1)),
        ):
            motion = self._predictor.motion(task.x, u, task.d[:-1])
            if motion.finite:
                yield self.problem.point(motion, u_last)
