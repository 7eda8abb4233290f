"""The tracking controller: a linear time-varying MPC. This is the problem it solves at every sample:

    minimise  ½ Σ_{k=1…N-1} [w_θ (θ_k - θ*_k)² + w_ω (ω_k - θ*'_k)² + w_K (K_k - K*_k)²]
            + ½ Σ_{k=0…N-1} [w_u |e_k|² + w_r |e_k - e_{k-1}|²/dt²]  +  ρ s + ½ ρ₂ s²              e_k = u_k - u*_k
            + ½ |L ξ|²,                                                      ξ = (x_N - x*_N, e_{N-1})
    over      u_0 … u_{N-1},  s ≥ 0
    subject to  x_{k+1} = f_d(x_k, u_k, d),  K_k = K(x_k),  x_0 = the measured state
                P_min ≤ u_k ≤ P_max,   |u_k - u_{k-1}| ≤ slew · dt                             (hard)
                θ_min - s ≤ θ_k ≤ θ_max + s                                                    (soft)

θ* and K* are the references, u* and the pressures in x* = (θ*, θ*', P1*, P2*) what follows them by the closed-form
allocation (`mpc.feedforward`); L is the terminal cost (`mpc.terminal`). f_d and K are linearised along the previous plan, moved on by one sample (`mpc.linearise`),
which makes the problem a QP in the changes of the commands (`mpc.condense`); one such QP is solved per sample, or
`iterations` of them, which converges to the solution of the nonlinear problem.

No step is without an answer. If the QP's answer does not pass the check of its optimality conditions the previous
plan goes on, at most to its end; else the feed-forward is commanded. Whatever is sent keeps the hard limits exactly.
"""

from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.condense import Limits, Targets, condense, increments
from mpc.feedforward import FeedForward, FeedForwardLaw
from mpc.linearise import Linearisation, Predictor
from mpc.plan import Plan, PlanStatus, Rung, Times
from mpc.plant import NU, NX, Plant
from mpc.qp import QP
from mpc.solvers import solver as solver_by_name
from mpc.terminal import terminal_factor
from mpc.weights import Weights

_PRIMAL_TOLERANCE = 1e-4  # [bar], [rad] by which a solver's answer may break a limit; what is sent is clipped
_DUAL_TOLERANCE = 1e-3  # [-] of `Residuals`
_LAZY_TOLERANCE = 1e-9  # [bar], [rad] below which a row that was left out counts as kept


@dataclass
class TrackingMPC:
    """Tracks references of angle and stiffness with `plant` as its model. It remembers its last plan and command."""

    plant: Plant
    dt: float = 0.01  # sample time [s]
    N: int = 20  # horizon [samples]
    weights: Weights = field(default_factory=Weights)
    solver: str = "daqp"  # or a name of qpsolvers
    iterations: int = 1  # QPs per step

    def __post_init__(self) -> None:
        """Check the settings and build what does not change."""
        if not (isinstance(self.dt, float | int) and 0 < self.dt < 1):
            raise InvalidInput(f"dt = {self.dt!r} s has to be a sample time between 0 and 1 s")
        for name, least in (("N", 3), ("iterations", 1)):
            value = getattr(self, name)
            if not isinstance(value, int) or value < least:
                raise InvalidInput(f"{name} = {value!r} has to be a whole number, {least} or more")
        self._solve = solver_by_name(self.solver)
        self._predictor = Predictor(self.plant, self.dt, self.N)
        self._feed_forward = FeedForwardLaw(self.plant, self.dt, self.N)
        self._E = increments(self.N)
        self._L = terminal_factor(self.plant, self.dt, self.weights)
        joint = self.plant.joint
        self.limits = Limits(joint.pressure_limits, self.plant.slew * self.dt, joint.angle_range)
        self.reset()

    def reset(self) -> None:
        """Forget the past: the next step begins from the pressures it measures."""
        self._plan: Plan | None = None
        self._u_star_before: Array | None = None
        self._age = 0  # steps since the plan was optimised

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """The plan from the measured state `x` (4,) for references θ [rad] and K [N·m/rad].

        A reference is a value, held for the whole horizon, or a preview (N+1,) that begins now. `d` is the
        disturbance torque [N·m] known to act. A NaN in `x` is replaced by what the last plan predicted.
        """
        began = perf_counter()
        x, measured = self._state(x)
        theta = self._preview("theta_ref", checks.angle("theta_ref", theta_ref))
        K = self._preview("K_ref", checks.stiffness("K_ref", K_ref))
        d = float(checks.real("d", d, "N·m"))

        feed = self._feed_forward(theta, K, d)
        u_last = x[2:] if self._plan is None else self._plan.u[0]
        u = self._warm_start(u_last, feed)
        fed = perf_counter()
        u, status, times = self._optimise(x, u, u_last, feed, d)
        self._age = 0 if status is PlanStatus.OPTIMAL else self._age + 1
        rung = Rung.QP
        if status is not PlanStatus.OPTIMAL:
            rung = Rung.PREVIOUS if self._plan and self._age < self.N else Rung.ALLOCATION
            u = u if rung is Rung.PREVIOUS else self.limited(u_last, feed.u)
        if not measured:
            status = PlanStatus.NO_MEASUREMENT

        motion = self._predictor.motion(x, u, d)
        left, right = self.limits.theta
        slack = max(0.0, left - motion.x[:, 0].min(), motion.x[:, 0].max() - right)
        total = perf_counter() - began
        self._plan = Plan(u, motion.x, motion.K, status, rung, slack, Times(fed - began, *times, total))
        self._u_star_before = feed.u[0]
        return self._plan

    def qp(self, x: Array, u: Array, u_last: Array, feed: FeedForward, d: float = 0.0) -> QP:
        """The QP about the commands `u` (N, 2): what `step` solves, to look at."""
        return self._condense(self._predictor.linearise(x, u, d), u_last, feed)

    def limited(self, u_last: Array, u: Array) -> Array:
        """The commands `u` (N, 2), each moved to the nearest that slew and supply allow; slew comes first."""
        low, high, step = *self.limits.pressure, self.limits.step
        kept = np.empty_like(u)
        for i in range(NU):
            before = float(u_last[i])
            for k, wanted in enumerate(u[:, i].tolist()):
                before = min(max(min(max(wanted, low), high), before - step), before + step)
                kept[k, i] = before
        return kept

    # --- the pieces of a step ---------------------------------------------------------------------------------------

    def _state(self, x: Any) -> tuple[Array, bool]:
        """The state to start from, and whether it was measured."""
        array = np.array(x, float)
        if array.shape != (NX,):
            raise InvalidInput(f"x has the shape {array.shape}, not ({NX},): (theta [rad], omega [rad/s], P1, P2 [Pa])")
        missing = ~np.isfinite(array)
        if not missing.any():
            return array, True
        if self._plan is None:
            raise InvalidInput(f"x = {array} is not finite, and there is no earlier step to predict it from")
        return np.where(missing, self._plan.x[1], array), False

    def _preview(self, name: str, reference: Array) -> Array:
        if reference.shape not in ((), (self.N + 1,)):
            raise InvalidInput(f"{name} has the shape {reference.shape}; give one value or a preview ({self.N + 1},)")
        return np.broadcast_to(reference, self.N + 1)

    def _warm_start(self, u_last: Array, feed: FeedForward) -> Array:
        """The previous plan moved on by one sample, its new end moving as the feed-forward does."""
        if self._plan is None:
            return self.limited(u_last, feed.u)
        kept = self._plan.u[1:]
        return self.limited(u_last, np.vstack([kept, kept[-1] + feed.u[-1] - feed.u[-2]]))

    def _condense(self, model: Linearisation, u_last: Array, feed: FeedForward) -> QP:
        u_before = feed.u[0] if self._u_star_before is None else self._u_star_before
        targets = Targets(feed.theta, feed.omega, feed.K, feed.P, feed.u, u_before)
        return condense(model, u_last, targets, self.limits, self.weights, self._L, self._E, self.dt)

    def _optimise(
        self, x: Array, u: Array, u_last: Array, feed: FeedForward, d: float
    ) -> tuple[Array, PlanStatus, tuple[float, float, float]]:
        """`iterations` QPs, from the commands `u`; the commands reached, and the times of the three stages."""
        spent = np.zeros(3)
        for _ in range(self.iterations):
            clock = [perf_counter()]
            model = self._predictor.linearise(x, u, d)
            clock.append(perf_counter())
            qp = self._condense(model, u_last, feed)
            clock.append(perf_counter())
            z, status = self._answer(qp)
            clock.append(perf_counter())
            spent += np.diff(clock)
            if status is not PlanStatus.OPTIMAL:
                break
            u = self.limited(u_last, u + self._E @ z)
        return u, status, tuple(spent.tolist())

    def _answer(self, qp: QP) -> tuple[Array, PlanStatus]:
        """The certified solution of `qp`, or why there is none. Rows seldom bind: they are left out until one does."""
        if not (np.isfinite(qp.H).all() and np.isfinite(qp.f).all()):
            return np.zeros_like(qp.f), PlanStatus.NOT_FINITE
        found = self._solve(qp.without_rows)
        if found is None or not qp.violation(found[0]) <= _LAZY_TOLERANCE:
            found = self._solve(qp)
        elif found:
            found = found[0], np.append(found[1], np.zeros(len(qp.R)))
        if found is None:
            return np.zeros_like(qp.f), PlanStatus.UNSOLVED
        right = qp.certify(*found).within(_PRIMAL_TOLERANCE, _DUAL_TOLERANCE)
        return found[0], PlanStatus.OPTIMAL if right else PlanStatus.REFUSED


__all__ = ["TrackingMPC"]
