"""Circle on a plant equal to the model: errors, limits, stiffness by pushing, times, comparison with IPOPT."""

from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from benchmarks.arm.cases import plant
from benchmarks.arm.ipopt import IPOPTStep, nonlinear, weighted
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.plan import Rung
from mpc.trials.motions.arm_trajectories import circle
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Run, in_motion, simulate

SETTLING = 50  # samples that do not count


@dataclass(frozen=True)
class Tracking:
    """Tracking errors of a run over all samples after the first half second, at the worst joint or entry."""

    angle: float  # RMS [°]
    angle_worst: float  # [°]
    stiffness: float  # RMS of an entry of K [N·m/rad]
    limits_kept: bool
    on_qp: float  # share of the steps


def tracking(run: Run) -> Tracking:
    error, K = (run.theta - run.theta_ref)[SETTLING:] / DEG, (run.K - run.K_ref)[SETTLING:]
    (low, high), (left, right) = run.plant.pressure_limits, run.plant.angle_limits
    step = np.abs(np.diff(run.u, axis=0)).max()
    kept = (low <= run.u).all() and (run.u <= high).all() and step <= run.plant.slew * run.dt * (1 + 1e-12)
    kept = kept and (left <= run.theta).all() and (run.theta <= right).all() and (run.forces > 0).all()
    return Tracking(
        float(np.sqrt(np.mean(error**2, axis=0)).max()),
        float(np.abs(error).max()),
        float(np.sqrt(np.mean(K**2, axis=0)).max()),
        bool(kept),
        float(np.mean(run.rung == Rung.QP)),
    )


@dataclass(frozen=True)
class Times:
    """Times of a step [µs]: for every sample the least of some runs of the same circle."""

    median: float
    p99: float
    worst: float


def times(arm: Arm, controller: TrackingMPC, turns: float = 1.0, rounds: int = 3) -> Times:
    asked, tested = circle(arm, turns=turns), plant(arm)
    x0 = in_motion(arm, asked)
    runs = [simulate(tested, controller, asked, x0=x0).step_time for _ in range(rounds)]
    least = 1e6 * np.min(runs, axis=0)
    return Times(float(np.median(least)), float(np.percentile(least, 99)), float(least.max()))


def pushed(arm: Arm, controller: TrackingMPC, rests: int = 5) -> tuple[float, float]:
    """Return the worst differences of the stiffness measured by pushing at rests from (M2), and from the request.

    The stiffness by gravity, if any, is subtracted.
    """
    rng, tested, off, missed = np.random.default_rng(3), plant(arm), 0.0, 0.0
    about = circle(arm)
    for _ in range(rests):
        k = int(rng.uniform(0, about.duration / (about.t[1] - about.t[0])))
        q, K = about.theta[k], about.K[k]
        simulate(tested, controller, Reference([0.0, 1.0], [q, q], [K, K]))
        rest = tested.settle()
        measured = tested.pushed_stiffness() - arm.bodies.gravity_stiffness(rest)
        off = max(off, np.abs(measured - arm.mechanism.stiffness(rest, tested.P)).max())
        missed = max(missed, np.abs(measured - K).max())
    return float(off), float(missed)


class Beside:
    """Two controllers with the same inputs; the plant follows the first, and their times alternate."""

    def __init__(self, obeyed: TrackingMPC, other: TrackingMPC) -> None:
        self.dt, self.ahead, self._both = obeyed.dt, obeyed.ahead, (obeyed, other)
        self.times: tuple[list[float], list[float]] = [], []

    def reset(self) -> None:
        """Reset both."""
        for controller in self._both:
            controller.reset()

    def step(self, *given: Any) -> Any:
        """Return the plan of the first; the other one's is made just after it."""
        plans = []
        for controller, took in zip(self._both, self.times, strict=True):
            began = perf_counter()
            plans.append(controller.step(*given))
            took.append(perf_counter() - began)
        return plans[0]


@dataclass(frozen=True)
class Rival:
    """Results of IPOPT on the same problems."""

    ratio: float  # of the median times of a step
    milliseconds: float  # median of IPOPT's
    cost: float  # closed-loop cost of ours, in fractions of IPOPT's, less 1
    apart: float  # greatest difference of the first commands [Pa]
    failures: int


def rival(arm: Arm, turns: float = 0.5, **settings: Any) -> Rival:
    asked, tested = circle(arm, turns=turns), plant(arm)
    ours, theirs = TrackingMPC(arm, **settings), nonlinear(arm, **settings)
    step: Any = theirs._qp_step
    assert isinstance(step, IPOPTStep)
    both = Beside(ours, theirs)
    run = simulate(tested, both, asked)
    step.failures = 0
    other = simulate(tested, theirs, asked)
    own, rivals = (np.median(took) for took in both.times)
    costs = [closed_loop_cost(done, ours) for done in (run, other)]
    apart = float(np.abs(run.u - other.u).max())
    return Rival(float(rivals / own), float(1e3 * rivals), costs[0] / costs[1] - 1, apart, step.failures)


def closed_loop_cost(run: Run, controller: TrackingMPC) -> float:
    """Return the controller's cost of the actual motion, sample by sample."""
    arm, rows, N = run.plant, controller.problem.rows, controller.N
    inverse = InverseDynamics(arm, run.dt, N, controller.min_force)
    asked = controller_reference(run)
    total, e_before = 0.0, None
    for k in range(len(run.u)):
        q, K = asked(k, N)
        feed = inverse(q, K, np.zeros((N + 1, arm.n)))
        e = run.u[k] - feed.u[0]
        rate = (e - (run.P[0] - feed.u[0] if e_before is None else e_before)) / run.dt
        y = np.concatenate([arm.svec(run.K[k + 1]), np.zeros(arm.m)])
        parts = (rows.x, run.x[k + 1] - feed.x[1]), (rows.y, y - feed.y[1]), (rows.e, e), (rows.rate, rate)
        total += float(sum(weighted(weight, residual) for weight, residual in parts))
        e_before = e
    return total


def controller_reference(run: Run) -> Any:
    """Return the controller's previews; the circle continues beyond the run's end."""
    swing = circle(run.plant).resampled(run.dt)

    def at(k: int, N: int) -> tuple[Array, Array]:
        return swing.preview(k, N)

    return at
