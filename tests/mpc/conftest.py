"""The controller's problem written anew from its docstring, for CasADi and IPOPT."""

import functools

import casadi as ca
import numpy as np
import pytest

from allocator import BAR
from mpc import Plant, Weights
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.terminal import terminal_factor

DEFAULT = Weights()


class IpoptMPC:
    """The nonlinear programme of one step; `solve` answers the commands (N, 2) [Pa] and the cost."""

    def __init__(self, plant, dt, N, weights):
        self.plant, self.dt, self.N, self.w = plant, dt, N, weights
        self.feed_forward = InverseDynamics(plant, dt, N)
        self.L = terminal_factor(plant, dt, weights)
        step = plant.discrete(dt)
        x0, u, s, s_F = ca.MX.sym("x0", 4), ca.MX.sym("u", 2, N), ca.MX.sym("s"), ca.MX.sym("s_F")
        u_last, u_star_last = ca.MX.sym("u_last", 2), ca.MX.sym("u_star_last", 2)
        theta, omega, K = (ca.MX.sym(name, N + 1) for name in ("theta", "omega", "K"))
        u_star, x_star = ca.MX.sym("u_star", 2, N), ca.MX.sym("x_star", 4)
        state = ca.SX.sym("x", 4)
        stiffness = ca.Function("K", [state], [plant.stiffness(state)])
        forces = ca.Function("F", [state], [ca.vertcat(*plant.forces(state))])

        w, x, cost, rows = self.w, x0, 0, []
        before, e_before = u_last, (u_last - u_star_last)
        for k in range(N):
            command = BAR * u[:, k]
            e = command - u_star[:, k]
            cost += w.u * ca.sumsqr(e) + w.rate * ca.sumsqr(e - e_before) / dt**2
            rows.append((command - before) / BAR)
            x = step(x, command, 0.0)
            rows.append(x[0] - s)
            rows.append(x[0] + s)
            rows.append((forces(x) + s_F) / 100)  # what is about 1 is solved more exactly
            if k + 1 < N:
                cost += w.theta * (x[0] - theta[k + 1]) ** 2 + w.omega * (x[1] - omega[k + 1]) ** 2
                cost += w.K * (stiffness(x) - K[k + 1]) ** 2
            before, e_before = command, e
        cost += ca.sumsqr(self.L @ ca.vertcat(x - x_star, e))
        cost = cost / 2 + w.slack * s + w.slack_square / 2 * s**2
        cost += w.slack_force * s_F + w.slack_force_square / 2 * s_F**2

        decisions = ca.vertcat(ca.vec(u), s, s_F)
        given = ca.vertcat(x0, u_last, u_star_last, theta, omega, K, ca.vec(u_star), x_star)
        quiet = {
            "ipopt.print_level": 0,
            "print_time": False,
            "ipopt.sb": "yes",
            "ipopt.tol": 1e-10,
            "ipopt.bound_relax_factor": 0.0,  # s = -1e-8 would earn 1
        }
        self.cost = ca.Function("cost", [decisions, given], [cost])
        problem = {"x": decisions, "p": given, "f": cost / 1e4, "g": ca.vertcat(*rows)}
        self._solver = ca.nlpsol("ipopt_mpc", "ipopt", problem, quiet)
        change = plant.slew * dt / BAR
        left, right = plant.joint.angle_range
        self._rows_lower = np.tile([-change, -change, -np.inf, left, 0.0, 0.0], N)
        self._rows_upper = np.tile([change, change, right, np.inf, np.inf, np.inf], N)

    def given(self, x, theta, K, u_last, u_star_last):
        feed = self.feed_forward(theta, K)
        u_star_last = feed.u[0] if u_star_last is None else u_star_last
        return np.concatenate(
            [x, u_last, u_star_last, feed.x[:, 0], feed.x[:, 1], feed.y[:, 0], feed.u.ravel(), feed.x[-1]]
        )

    def cost_of(self, plan, given):
        return float(self.cost(np.concatenate([plan.u.ravel() / BAR, [plan.slack, plan.slack_force]]), given))

    def solve(self, x, theta, K, u_last, u_star_last=None):
        given = self.given(x, theta, K, u_last, u_star_last)
        low, high = (np.append(np.full(2 * self.N, P / BAR), [end, end]) for P, end in
                     zip(self.plant.joint.pressure_limits, (0.0, np.inf), strict=True))  # fmt: skip
        start = np.append(np.tile(np.asarray(u_last) / BAR, self.N), [0.0, 0.0])
        found = self._solver(x0=start, p=given, lbx=low, ubx=high, lbg=self._rows_lower, ubg=self._rows_upper)
        assert self._solver.stats()["success"]
        z = found["x"].full()[:, 0]
        return BAR * z[:-2].reshape(self.N, 2), float(self.cost(z, given)), given


@pytest.fixture(scope="session")
def ipopt_mpc():
    """Makes the nonlinear programme of (N, weights) for the report's joint at 10 ms; each is built once."""
    return functools.cache(lambda N, weights=DEFAULT: IpoptMPC(Plant(), 0.01, N, weights))
