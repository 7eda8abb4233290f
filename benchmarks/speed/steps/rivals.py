"""Rivals for the same command: do-mpc on the same problem, and cvxpy with OSQP on the same QP."""

import warnings
from math import inf
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.speed.truth import BenchmarkFailure
from mpc import Plan, PlanStatus, Plant, Rung, Weights
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.limits import Limits
from mpc.tracking.plan import Times
from mpc.tracking.qp.programme import QP
from mpc.tracking.terminal import terminal_factor

_NAMES = ("theta", "omega", "K", "u1", "u2", "before1", "before2", "d")  # time-varying parameters
_COST = 1e2  # [cost] per unit of do-mpc's objective: with more, IPOPT stops before small errors matter


class DoMPC:
    """The problem of `mpc.tracking.controller` in do-mpc, in discrete time, with separate slacks at each stage.

    The states are (θ, ω, P1, P2, u_{k-1}) and the inputs the changes of the commands, both pressures in bar, so slew
    and supply are bounds of inputs and states.
    """

    ahead: int

    def __init__(self, plant: Plant, dt: float, N: int) -> None:
        self.dt, self.ahead, self.weights = dt, N, Weights()
        self.limits, self.law = Limits.of(plant, dt), InverseDynamics(plant, dt, N)
        self._mpc = self._build(plant, N)
        self.reset()

    def reset(self) -> None:
        """Reset the controller."""
        self._u: Array | None = None
        self._u_star: Array | None = None
        self._mpc.reset_history()

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """Return the command, as `TrackingMPC.step`."""
        feed = self.law(theta_ref, K_ref, d)
        u_last = np.asarray(x[2:]) if self._u is None else self._u
        self._fill(feed, feed.u[0] if self._u_star is None else self._u_star, d)
        chi = np.concatenate([x[:2], np.asarray(x[2:]) / BAR, u_last / BAR])
        if self._u is None:
            self._mpc.x0 = chi
            self._mpc.set_initial_guess()
        change = np.ravel(self._mpc.make_step(chi))
        if not self._mpc.solver_stats["success"]:
            raise BenchmarkFailure(f"do-mpc: {self._mpc.solver_stats['return_status']}")
        self._u, self._u_star = u_last + BAR * change, feed.u[0]
        times = Times(0.0, 0.0, 0.0, 0.0, 0.0)
        return Plan(np.array([self._u]), np.array([x, x]), feed.y[:, 0], PlanStatus.OPTIMAL, Rung.QP, 0.0, times)

    def _fill(self, feed: FeedForward, u_star_last: Array, d: float) -> None:
        u = np.vstack([u_star_last, feed.u, feed.u[-1:]]) / BAR
        columns = np.column_stack([feed.x[:, :2], feed.y[:, 0], u[1:], u[:-1], np.full(len(feed.x), d)])
        for k, row in enumerate(columns):
            for name, value in zip(_NAMES, row, strict=True):
                self._tvp["_tvp", k, name] = value
        self._P_end[...] = feed.x[-1, 2:] / BAR
        self._p["_p", 0, "P_end"] = self._P_end

    def _build(self, plant: Plant, N: int) -> Any:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about unused features of do-mpc
            import do_mpc

            model = do_mpc.model.Model("discrete", "SX")
            chi, v = model.set_variable("_x", "chi", (6, 1)), model.set_variable("_u", "v", (2, 1))
            given = {name: model.set_variable("_tvp", name) for name in _NAMES}
            P_end = model.set_variable("_p", "P_end", (2, 1))
            self._state(model, plant, chi, v, given["d"])
            model.setup()
            mpc = do_mpc.controller.MPC(model)
            mpc.settings.n_horizon, mpc.settings.t_step, mpc.settings.n_robust = N, self.dt, 0
            mpc.settings.store_full_solution = False
            mpc.settings.supress_ipopt_output()
            mpc.set_objective(*self._costs(plant, chi, v, given, P_end))
            mpc.set_rterm(v=0.0)
            self._bound(mpc, plant, chi)
            self._tvp, self._p, self._P_end = mpc.get_tvp_template(), mpc.get_p_template(1), np.zeros(2)
            mpc.set_tvp_fun(lambda t: self._tvp)
            mpc.set_p_fun(lambda t: self._p)
            mpc.setup()
        return mpc

    def _state(self, model: Any, plant: Plant, chi: Any, v: Any, d: Any) -> None:
        import casadi as ca

        x, u = _plant_state(chi), chi[4:] + v
        after = plant.discrete(self.dt)(x, BAR * u, d)
        model.set_rhs("chi", ca.vertcat(after[:2], after[2:] / BAR, u))

    def _costs(self, plant: Plant, chi: Any, v: Any, given: Any, P_end: Any) -> tuple[Any, Any]:
        """Return terminal and stage cost; that of the first state is a constant."""
        import casadi as ca

        w, x = self.weights, _plant_state(chi)
        u_star, before = (ca.vertcat(given[f"{name}1"], given[f"{name}2"]) for name in ("u", "before"))
        e, e_last = BAR * (chi[4:] + v - u_star), BAR * (chi[4:] - before)
        stage = w.theta * (x[0] - given["theta"]) ** 2 + w.omega * (x[1] - given["omega"]) ** 2
        stage += w.K * (plant.stiffness(x) - given["K"]) ** 2
        stage += w.u * ca.sumsqr(e) + w.rate * ca.sumsqr(e - e_last) / self.dt**2
        L = ca.DM(terminal_factor(plant, self.dt, w))
        x_star = ca.vertcat(given["theta"], given["omega"], BAR * P_end)
        end = ca.sumsqr(L @ ca.vertcat(x - x_star, e_last))
        return end / 2 / _COST, stage / 2 / _COST

    def _bound(self, mpc: Any, plant: Plant, chi: Any) -> None:
        import casadi as ca

        (low, high), (left, right), step = self.limits.pressure, self.limits.theta, self.limits.step / BAR
        mpc.bounds["lower", "_u", "v"], mpc.bounds["upper", "_u", "v"] = -step, step
        mpc.bounds["lower", "_x", "chi"] = np.array([-inf, -inf, -inf, -inf, low / BAR, low / BAR])
        mpc.bounds["upper", "_x", "chi"] = np.array([inf, inf, inf, inf, high / BAR, high / BAR])
        F = ca.vertcat(*plant.forces(_plant_state(chi))) / 100
        w = self.weights
        soft = {"soft_constraint": True}
        mpc.set_nl_cons("right", chi[0], ub=right, penalty_term_cons=w.slack / _COST, **soft)
        mpc.set_nl_cons("left", -chi[0], ub=-left, penalty_term_cons=w.slack / _COST, **soft)
        mpc.set_nl_cons(
            "taut", -F, ub=-self.limits.min_force / 100, penalty_term_cons=100 * w.slack_force / _COST, **soft
        )


def _plant_state(chi: Any) -> Any:
    import casadi as ca

    return ca.vertcat(chi[:2], BAR * chi[2:4])


class CvxpyOSQP:
    """QP with all of its rows, formulated once with parameters and solved by OSQP."""

    def __init__(self, qp: QP) -> None:
        import cvxpy as cp

        n, m = qp.f.size, len(qp.R)
        self._z, self._L = cp.Variable(n), cp.Parameter((n, n))
        self._f, self._R = cp.Parameter(n), cp.Parameter((m, n))
        self._sides = [cp.Parameter(size) for size in (n, n, m, m)]
        lower, upper, rows_lower, rows_upper = self._sides
        limits = [lower <= self._z, self._z <= upper, rows_lower <= self._R @ self._z, self._R @ self._z <= rows_upper]
        cost = cp.sum_squares(self._L @ self._z) / 2 + self._f @ self._z
        self._problem = cp.Problem(cp.Minimize(cost), limits)

    def __call__(self, qp: QP) -> Array:
        """Return z (n,) to OSQP's tolerance of 1e-6."""
        import cvxpy as cp

        self._L.value, self._f.value, self._R.value = np.linalg.cholesky(qp.H).T, qp.f, qp.R
        for side, values in zip(self._sides, (qp.lower, qp.upper, qp.rows_lower, qp.rows_upper), strict=True):
            side.value = np.clip(values, -1e6, 1e6)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about accuracy, checked by the caller
            self._problem.solve(cp.OSQP, eps_abs=1e-6, eps_rel=1e-6, max_iter=100_000, warm_start=True)
        return np.asarray(self._z.value)
