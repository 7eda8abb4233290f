"""The nonlinear programme behind `TrackingMPC`, by IPOPT: the same cost, limits, horizon, blocks.

Multiple shooting with the model's own sample; decisions are the changes of the blocks, the states and the slacks.
"""

from time import perf_counter
from typing import Any

import casadi as ca
import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.condense import SLACKS
from mpc.tracking.qp.step import PreviousSample, QPAnswer
from mpc.yardsticks.shooting import IPOPT

_SLACK_UNITS = 1e-3, 1.0  # [rad], [N]: of the order of their values


class IPOPTStep:
    """A QP step of `mpc.tracking.qp.step.QPStep` that solves the whole nonlinear programme instead."""

    implementation = "IPOPT"
    active_set = None

    def __init__(self, controller: TrackingMPC) -> None:
        self._arm, self._problem, self._N = controller.plant, controller.problem, controller.N
        arm = self._arm
        self._x_unit = np.concatenate([np.ones(2 * arm.n), np.full(arm.m, BAR)])
        self._build(controller.dt)
        self.times: list[float] = []
        self.failures = 0

    def reset(self) -> None:
        """Do nothing: there is no memory."""

    def _build(self, dt: float) -> None:
        arm, problem, N = self._arm, self._problem, self._N
        rows, weights, E = problem.rows, problem.weights, problem.E[:, :, :-SLACKS]
        z = ca.MX.sym("z", E.shape[2])
        X = ca.MX.sym("X", arm.size, N)  # scaled
        slack = ca.MX.sym("slack", SLACKS)
        x0, u_last, e_last = ca.MX.sym("x0", arm.size), ca.MX.sym("u_last", arm.m), ca.MX.sym("e_last", arm.m)
        U, d = ca.MX.sym("U", arm.m, N), ca.MX.sym("d", arm.n, N)
        x_ref, y_ref, u_ref = (
            ca.MX.sym("x_ref", arm.size, N + 1), ca.MX.sym("y_ref", rows.y.size, N + 1), ca.MX.sym("u_ref", arm.m, N),
        )  # fmt: skip
        self._stage = stage = arm.discrete(dt)
        s = arm.statics
        outputs = ca.Function("outputs", [s.q, s.P], [arm.outputs])
        x, u_before, e_before, cost, g = x0, u_last, e_last, 0, []
        n, size, unit = arm.n, arm.size, ca.DM(self._x_unit)
        sigma = slack * ca.DM(_SLACK_UNITS)
        for k in range(N):
            u = U[:, k] + ca.DM(E[k]) @ z
            e = u - u_ref[:, k]
            cost += weighted(rows.e, e) + weighted(rows.rate, (e - e_before) / dt)
            after = unit * X[:, k]
            g += [(stage(x, u, d[:, k]) - after) / unit, u / BAR, (u - u_before) / BAR]
            y = outputs(after[:n], after[2 * n :])
            g += [after[:n] - sigma[0], after[:n] + sigma[0], (y[-arm.m :] + sigma[1]) / 100]
            if k < N - 1:
                cost += weighted(rows.x, after - x_ref[:, k + 1]) + weighted(rows.y, y - y_ref[:, k + 1])
            x, u_before, e_before = after, u, e
        end = ca.DM(problem.L) @ ca.vertcat(x - x_ref[:, N], e_before)
        cost += ca.sumsqr(end) / 2
        for i, (price, square) in enumerate(
            ((weights.slack, weights.slack_square), (weights.slack_force, weights.slack_force_square))
        ):
            cost += price * sigma[i] + square / 2 * sigma[i] ** 2
        p = ca.veccat(x0, u_last, e_last, U, d, x_ref, y_ref, u_ref)
        programme = {"x": ca.veccat(z, X, slack), "f": cost, "g": ca.vertcat(*g), "p": p}
        self._solve = ca.nlpsol("arm", "ipopt", programme, {"print_time": False, "expand": True, **IPOPT().casadi})
        self._bounds(size, n)

    def _bounds(self, size: int, n: int) -> None:
        limits, m = self._problem.limits, self._arm.m
        (low, high), (left, right) = limits.pressure, limits.theta
        inf, one = np.inf, np.ones(m)
        step = limits.step / BAR * one
        lower = [np.zeros(size), low / BAR * one, -step, np.full(n, -inf), left, limits.min_force / 100 * one]
        upper = [np.zeros(size), high / BAR * one, step, right, np.full(n, inf), inf * one]
        self._lower, self._upper = (np.tile(np.concatenate(part), self._N) for part in (lower, upper))

    def __call__(
        self, x: Array, u: Array, d: Array, feed: Any, previous: PreviousSample, solve: Any, deadline: float
    ) -> QPAnswer:
        """Return IPOPT's solution, started at the previous plan."""
        began = perf_counter()
        u = self._problem.limits.limited(previous.u, u)
        z = self._problem.E.shape[2] - SLACKS
        motion = [x]
        for k in range(self._N):
            motion.append(self._sample(motion[-1], u[k], d[k]))
        guess = np.concatenate([np.zeros(z), (np.array(motion[1:]) / self._x_unit).ravel(), np.zeros(SLACKS)])
        e_last = previous.u - previous.u_star
        given = x, previous.u, e_last, u, d, feed.x, feed.y, feed.u
        p = np.concatenate([np.ravel(part) for part in given])
        bounds = {"lbx": np.append(np.full(guess.size - SLACKS, -np.inf), [0.0, 0.0]), "ubx": np.inf}
        found = self._solve(x0=guess, p=p, lbg=self._lower, ubg=self._upper, **bounds)
        self.times.append(perf_counter() - began)
        if not self._solve.stats()["success"]:
            self.failures += 1
            return QPAnswer(PlanStatus.UNSOLVED, u, None, None, (0.0, 0.0, self.times[-1]))
        changed = self._problem.E[:, :, :-SLACKS] @ found["x"].full().ravel()[:z]
        u = self._problem.limits.limited(previous.u, u + changed)
        return QPAnswer(PlanStatus.OPTIMAL, u, None, None, (0.0, 0.0, self.times[-1]))

    def _sample(self, x: Array, u: Array, d: Array) -> Array:
        return np.asarray(self._stage(x, u, d).full()).ravel()


def weighted(weights: Array, residual: Any) -> Any:
    """Return ½ Σ w r² over the entries with a weight."""
    return sum(w / 2 * residual[i] ** 2 for i, w in enumerate(weights.tolist()) if w)


def nonlinear(arm: Any, **settings: Any) -> TrackingMPC:
    """Return a `TrackingMPC` with steps by IPOPT."""
    made = TrackingMPC(arm, **settings)
    made._qp_step = IPOPTStep(made)
    made.reset()
    return made
