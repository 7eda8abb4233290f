"""acados: one real-time iteration (RTI) per sample on the problem in `mpc.tracking.controller`, its QP by HPIPM.

The C compiler compiles its generated code. States are (θ, ω, P1, P2, u_{k-1}) and inputs the changes of the commands,
pressures in bar. The residuals of the cost and their linearisation (Gauss-Newton) are ours; the soft limits have
separate slacks at every sample. Only acados's C function is timed, linearisation and QP, without the transfer from
Python.
"""

import ctypes
import os
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.speed.acados.library import MOST, TOLERANCE
from mpc import PlanStatus, Plant, Rung, Weights
from mpc.model.compensation import Compensation
from mpc.tracking.base import BaseController, Optimised, Situation
from mpc.tracking.cost import diagonal
from mpc.tracking.feedforward import FeedForward, InverseDynamics
from mpc.tracking.terminal import terminal_factor

NX, NV = 6, 2
CONDENSED = 4  # stages to one of the QP; at N = 20 the fastest of 1, 2, 4 and all, in a run each
UNITS = np.array([1.0, 1.0, BAR, BAR])
FORCE = 100.0  # [N], the unit of forces
LIBRARIES = ("libblasfeo.so", "libhpipm.so", "libqpOASES_e.so.3.1")  # before libacados.so, which has no path to them


def available() -> bool:
    """Return whether acados is available."""
    root = os.environ.get("ACADOS_SOURCE_DIR")
    return root is not None and Path(root, "lib", "libacados.so").exists() and find_spec("acados_template") is not None


@dataclass
class AcadosRTI(BaseController):
    """Controller with one or several real-time iterations per sample."""

    plant: Plant
    dt: float
    N: int
    iterations: int = 1
    weights: Weights = field(default_factory=Weights)
    compensation: Compensation = field(default_factory=Compensation)
    patience: float = 0.2

    def __post_init__(self) -> None:
        """Generate the solver, and compile it."""
        self._build(self.N)
        self._feed_forward = InverseDynamics(self.plant, self.dt, self.N).ready()
        self._unit = (self.dt / BAR) ** 2 / self.weights.rate  # of the cost: a unit of the rate's curvature
        self._solver = self._generated()
        self._solve = getattr(self._solver.shared_lib, f"{self._solver.model_name}_acados_solve")
        self._solve.argtypes, self._solve.restype = [ctypes.c_void_p], ctypes.c_int
        self.reset()

    def _forget(self) -> None:
        self.seconds: list[float] = []  # of acados's own function

    def _optimise(self, situation: Situation) -> Optimised:
        """Return the commands of the last iteration, begun at the previous plan shifted."""
        task, feed, u_last = situation.task, situation.feed, situation.previous.u
        self._hand_over(task.x, task.d, feed, u_last, situation.previous.u_star)
        self._begin(task.x, task.d, self.limits.limited(u_last, self.ladder.shift(feed.u)), u_last)
        began = thread_time()
        for _ in range(self.iterations):
            status = self._solve(self._solver.capsule)
        self.seconds.append(thread_time() - began)
        v = np.array([self._solver.get(k, "u") for k in range(self.N)])
        if status not in (0, 2) or not np.isfinite(v).all():
            return Optimised(PlanStatus.UNSOLVED)
        u = self.limits.limited(u_last, u_last + BAR * np.cumsum(v, axis=0))
        return Optimised(PlanStatus.OPTIMAL, (Rung.QP, u))

    def _hand_over(self, x: Array, d: Array, feed: FeedForward, u_last: Array, u_star_last: Array) -> None:
        """Give acados the state, the torques and the references."""
        s, start = self._solver, np.concatenate([x / UNITS, u_last / BAR])
        s.set(0, "lbx", start)
        s.set(0, "ubx", start)
        changes = np.diff(feed.u, axis=0, prepend=u_star_last[None]) / BAR
        for k in range(self.N):
            s.set(k, "p", d[k : k + 1])
            s.set(k, "yref", np.concatenate([feed.x[k, :2], feed.y[k, :1], feed.u[k] / BAR, changes[k]]))
        s.set(self.N, "yref", np.concatenate([feed.x[-1] / UNITS, feed.u[-1] / BAR]))

    def _begin(self, x: Array, d: Array, u: Array, u_last: Array) -> None:
        """Set the start of the iteration: the motion under the commands `u` (N, 2)."""
        motion = self._predictor.motion(x, u, d[: self.N])
        before = np.vstack([u_last, u]) / BAR
        for k in range(self.N + 1):
            self._solver.set(k, "x", np.concatenate([motion.x[k] / UNITS, before[k]]))
        for k, change in enumerate(np.diff(before, axis=0)):
            self._solver.set(k, "u", change)

    # --- the problem ------------------------------------------------------------------------------------------------

    def _generated(self) -> Any:
        import acados_template

        ocp = acados_template.AcadosOcp()
        self._model(ocp)
        self._cost(ocp)
        self._constraints(ocp)
        options = ocp.solver_options
        options.tf, options.integrator_type, options.nlp_solver_type = self.N * self.dt, "DISCRETE", "SQP_RTI"
        options.qp_solver, options.hpipm_mode = "PARTIAL_CONDENSING_HPIPM", "SPEED"
        options.qp_solver_cond_N = max(self.N // CONDENSED, 1)
        options.qp_solver_iter_max, options.qp_tol, options.print_level = MOST, TOLERANCE, 0
        options.ext_fun_compile_flags = "-O3 -march=native"
        os.environ.setdefault("ACADOS_PYTHON_INTERFACE_PATH", str(Path(acados_template.__file__).parent))
        lib = Path(os.environ["ACADOS_SOURCE_DIR"], "lib")
        for name in LIBRARIES:
            ctypes.CDLL(str(lib / name))
        self._folder = TemporaryDirectory(prefix="acados-")  # lives as long as the solver
        ocp.code_export_directory = f"{self._folder.name}/code"
        with redirect_stdout(None):  # suppresses its note on the CasADi version
            return acados_template.AcadosOcpSolver(ocp, json_file=f"{self._folder.name}/ocp.json", verbose=False)

    def _model(self, ocp: Any) -> None:
        import casadi as ca

        x, v, d = ca.SX.sym("x", NX), ca.SX.sym("v", NV), ca.SX.sym("d")
        state, u = x[:4] * UNITS, x[4:] + v
        model = ocp.model
        model.name, model.x, model.u, model.p = f"joint{self.N}", x, v, d
        model.disc_dyn_expr = ca.vertcat(self.plant.discrete(self.dt)(state, BAR * u, d) / UNITS, u)
        model.cost_y_expr = ca.vertcat(x[:2], self.plant.stiffness(state), u, v)
        model.cost_y_expr_e = x
        model.con_h_expr = model.con_h_expr_e = ca.vertcat(*self.plant.forces(state)) / FORCE
        ocp.dims.N, ocp.parameter_values = self.N, np.zeros(1)

    def _cost(self, ocp: Any) -> None:
        rows, w, cost = diagonal(self.weights), self.weights, ocp.cost
        cost.cost_type, cost.cost_type_e = "NONLINEAR_LS", "NONLINEAR_LS"
        weights = [*rows.x[:2], rows.y[0], *rows.e * BAR**2, *rows.rate * (BAR / self.dt) ** 2]
        L = terminal_factor(self.plant, self.dt, w) * np.append(UNITS, [BAR, BAR])
        # acados treats the sum of the stages as an integral
        cost.W, cost.W_e = self._unit * np.diag(weights) / self.dt, self._unit * L.T @ L
        cost.yref, cost.yref_e = np.zeros(len(weights)), np.zeros(NX)
        charges = {"z": (w.slack, FORCE * w.slack_force), "Z": (w.slack_square, FORCE**2 * w.slack_force_square)}
        for name, (angle, force) in charges.items():
            charge = self._unit * np.array([angle, force, force])
            for side in "lu":
                setattr(cost, f"{name}{side}", charge / self.dt)
                setattr(cost, f"{name}{side}_e", charge)

    def _constraints(self, ocp: Any) -> None:
        (low, high), (left, right), step = self.limits.pressure, self.limits.theta, self.limits.step / BAR
        c, low, high = ocp.constraints, low / BAR, high / BAR
        c.x0 = np.zeros(NX)
        c.idxbu, c.lbu, c.ubu = np.arange(NV), np.full(NV, -step), np.full(NV, step)
        force, never = np.full(2, self.limits.min_force / FORCE), np.full(2, 1e5)
        for end in ("", "_e"):
            found = {"idxbx": [0, 4, 5], "lbx": [left, low, low], "ubx": [right, high, high], "idxsbx": [0]}
            found |= {"lh": force, "uh": never, "idxsh": [0, 1]}
            for name, value in found.items():
                setattr(c, f"{name}{end}", np.array(value))
