"""The tracking controller: a linear time-varying MPC. This is the problem it solves at every sample:

    minimise  ½ Σ_{k=1…N-1} [w_θ (θ_k - θ*_k)² + w_ω (ω_k - θ*'_k)² + w_K (K_k - K*_k)²]
            + ½ Σ_{k=0…N-1} [w_u |e_k|² + w_r |e_k - e_{k-1}|²/dt²]  +  ρ s + ½ ρ₂ s²              e_k = u_k - u*_k
            + ½ |L ξ|²,                                                      ξ = (x_N - x*_N, e_{N-1})
    over      u_0 … u_{N-1},  s ≥ 0
    subject to  x_{k+1} = f_d(x_k, u_k, d_k),  K_k = K(x_k),  x_0 = the measured state
                P_min ≤ u_k ≤ P_max,   |u_k - u_{k-1}| ≤ slew · dt                             (hard)
                θ_min - s ≤ θ_k ≤ θ_max + s                                                    (soft)

θ* and K* are the references, brought to the nearest that the joint can reach, u* and the pressures in
x* = (θ*, θ*', P1*, P2*) what follows them by the closed-form allocation (`mpc.feedforward`); L is the terminal cost
(`mpc.terminal`). f_d and K are linearised along the previous plan, moved on by one sample (`mpc.linearise`), which
makes the problem a QP in the changes of the commands (`mpc.condense`); one such QP is solved per sample, or
`iterations` of them, which converge to the nonlinear problem's solution.

What a `Compensation` knows of the real joint is taken account of: the problem begins where the commands under way will
have brought the joint at the end of the dead time, the torque d_k contains the friction of the intended motion θ*, and
the commands that are sent are those that regulators with a dead band hear as u.

No step is without an answer. If the QP's answer does not pass the check of its optimality conditions the previous
plan goes on, at most to its end; else the feed-forward is commanded. Whatever is sent keeps the hard limits exactly.
"""

from dataclasses import dataclass, field
from operator import index
from time import perf_counter
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.compensation import Compensation
from mpc.condense import Problem, condense, increments
from mpc.feedforward import FeedForward, FeedForwardLaw
from mpc.foresight import Foresight
from mpc.limits import Limits
from mpc.linearise import Predictor
from mpc.plan import Plan, PlanStatus, Rung, Times
from mpc.plant import Plant
from mpc.qp import QP
from mpc.solvers import solver as solver_by_name
from mpc.terminal import terminal_factor
from mpc.weights import Weights

_PRIMAL_TOLERANCE = 1e-4  # [bar], [rad] by which a solver's answer may break a limit; what is sent is clipped
_GAP_TOLERANCE = 1e-3  # [-] of the cost that the step gains
_LAZY_TOLERANCE = 1e-6  # [bar], [rad] below which a row that was left out counts as kept


@dataclass
class TrackingMPC:
    """Tracks references of angle and stiffness with `plant` as its model. It remembers its last plan."""

    plant: Plant
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str = "daqp"  # or a name of qpsolvers
    iterations: int = 1  # QPs per step
    compensation: Compensation = field(default_factory=Compensation)  # what is known beyond the plant

    def __post_init__(self) -> None:
        """Check the settings and build what does not change."""
        self.dt = float(checks.real("dt", self.dt, "s"))
        self.limits = Limits.of(self.plant, self.dt)
        self.N = _count("N", self.N, least=3)
        self.iterations = _count("iterations", self.iterations, least=1)
        self._solve = solver_by_name(self.solver)
        self._predictor = Predictor(self.plant, self.dt, self.N)
        self._feed_forward = FeedForwardLaw(self.plant, self.dt, self.N)
        L = terminal_factor(self.plant, self.dt, self.weights)
        self._foresight = Foresight(self.plant, self.dt, self.N, self.compensation, self.limits)
        self.problem = Problem(self.weights, self.limits, L, increments(self.N), self.dt)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next step begins from the pressures it measures."""
        self._foresight.reset()
        self._u: Array | None = None  # the commands of the last plan as they are to be heard (N, 2)
        self._u_star: Array | None = None  # the feed-forward of the last sample (2,)
        self._age = 0  # steps since a plan was optimised

    @property
    def ahead(self) -> int:
        """Samples of preview that `step` takes after the present one."""
        return self._foresight.ahead

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """The plan from the measured state `x` (4,) for references θ [rad] and K [N·m/rad].

        A reference is a value, held for the whole horizon, or a preview (ahead + 1,) that begins now. `d` is the
        disturbance torque [N·m] known to act. What is NaN in `x` is replaced by what the last plan predicted.
        """
        clock = [perf_counter()]
        x, theta, K, torques, measured = self._foresight.task(x, theta_ref, K_ref, d)
        feed = self._feed_forward(theta, K, torques)
        u_last = x[2:] if self._u is None else self._u[0]
        clock.append(perf_counter())

        u, status, times = self._optimise(x, feed, u_last, torques[:-1])
        u, rung = self._fallback(u, status, feed, u_last)
        motion = self._predictor.motion(x, u, torques[:-1])
        clock.append(perf_counter())
        self._u, self._u_star = u, feed.u[0]
        return Plan(
            self._foresight.spoken(u, motion.x),
            motion.x,
            motion.K,
            status if measured else PlanStatus.NO_MEASUREMENT,
            rung,
            self.limits.excursion(motion.x[:, 0]),
            Times(clock[1] - clock[0], *times, clock[2] - clock[0]),
        )

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _warm_start(self, feed: FeedForward, u_last: Array) -> Array:
        """The previous plan moved on by one sample, its new end moving as the feed-forward does."""
        if self._u is None:
            return self.limits.limited(u_last, feed.u)
        kept = self._u[1:]
        return self.limits.limited(u_last, np.vstack([kept, kept[-1] + feed.u[-1] - feed.u[-2]]))

    def _optimise(
        self, x: Array, feed: FeedForward, u_last: Array, d: Array
    ) -> tuple[Array, PlanStatus, tuple[float, float, float]]:
        """The commands after `iterations` QPs, or up to one that failed; and the times of the three stages [s]."""
        u = self._warm_start(feed, u_last)
        u_star_last = feed.u[0] if self._u_star is None else self._u_star
        linearising = condensing = solving = 0.0
        for _ in range(self.iterations):
            began = perf_counter()
            model = self._predictor.linearise(x, u, d)
            linearised = perf_counter()
            qp = condense(self.problem, model, feed, u_last, u_star_last)
            condensed = perf_counter()
            z, status = self._answer(qp)
            linearising += linearised - began
            condensing += condensed - linearised
            solving += perf_counter() - condensed
            if status is not PlanStatus.OPTIMAL:
                break
            u = self.limits.limited(u_last, u + self.problem.E @ z)
        return u, status, (linearising, condensing, solving)

    def _answer(self, qp: QP) -> tuple[Array, PlanStatus]:
        """The certified solution of `qp`, or why there is none. Rows seldom bind: they are left out until one does."""
        nothing = np.zeros_like(qp.f)
        if not (np.isfinite(qp.H).all() and np.isfinite(qp.f).all()):
            return nothing, PlanStatus.NOT_FINITE
        found = self._solve(qp.without_rows)
        if found and qp.violation(found[0]) <= _LAZY_TOLERANCE:
            z, multipliers = found
            found = z, np.append(multipliers, np.zeros(len(qp.R)))
        else:
            found = self._solve(qp)
        if found is None:
            return nothing, PlanStatus.UNSOLVED
        right = qp.certify(*found).within(_PRIMAL_TOLERANCE, _GAP_TOLERANCE)
        return found[0], PlanStatus.OPTIMAL if right else PlanStatus.REFUSED

    def _fallback(self, u: Array, status: PlanStatus, feed: FeedForward, u_last: Array) -> tuple[Array, Rung]:
        """The commands to send, and the rung of the ladder they come from."""
        if status is PlanStatus.OPTIMAL:
            self._age = 0
            return u, Rung.QP
        self._age += 1
        if self._u is not None and self._age < self.N:
            return u, Rung.PREVIOUS
        return self.limits.limited(u_last, feed.u), Rung.ALLOCATION


def _count(name: str, value: Any, least: int) -> int:
    try:
        number = index(value)
    except TypeError:
        number = -1
    if number < least:
        raise InvalidInput(f"{name} = {value!r} has to be a whole number, {least} or more")
    return number


__all__ = ["TrackingMPC"]
