"""Closed loop of timed steps: limits bind for part of the time, and an unmodelled load acts."""

from collections.abc import Callable
from dataclasses import dataclass
from time import thread_time
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from benchmarks.objective import closed_loop_cost
from mpc import KalmanObserver, Plan, Plant, RealPlant, Reference, Weights, simulate
from mpc.tracking.limits import Limits
from mpc.trials.simulation import Controller, Run

DT = 0.01  # [s]
LOAD = ((0.6, 1.0),)  # (from [s], N·m)


def reference(duration: float) -> Reference:
    """Return a sine of ±20° at 0.5 Hz, with a step of 10° at 1.2 s, and one of K from 7.6 to 8 at 1.8 s."""
    t = DT * np.arange(round(duration / DT) + 1)
    theta = 20 * DEG * np.sin(np.pi * t) * np.minimum(t, 1.0) + 10 * DEG * (t >= 1.2)
    return Reference(t, theta, np.where(t >= 1.8, 8.0, 7.6))


class Timed:
    """Controller with steps timed by the thread's clock, which excludes other processes.

    It also excludes BLAS threads of NumPy that keep spinning after other work.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller, self.dt, self.ahead = controller, controller.dt, controller.ahead

    def reset(self) -> None:
        """Reset the controller and the times."""
        self.controller.reset()
        self.seconds: list[float] = []
        self.plans: list[Plan] = []

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """Return the controller's step."""
        began = thread_time()
        plan = self.controller.step(x, theta_ref, K_ref, d)
        self.seconds.append(thread_time() - began)
        self.plans.append(plan)
        return plan


@dataclass(frozen=True)
class Loop:
    """Result of a run."""

    run: Run
    seconds: Array  # (M,) of each step
    plans: list[Plan]

    @property
    def saturated(self) -> float:
        """Share of the steps with a binding slew limit in the plan."""
        limits = Limits.of(self.run.plant, self.run.dt)
        steps = [np.abs(np.diff(plan.u, axis=0)).max() >= limits.step * (1 - 1e-6) for plan in self.plans]
        return float(np.mean(steps))

    def cost(self, N: int) -> float:
        """Cost by the controllers' objective."""
        return closed_loop_cost(self.run, Weights(), N).total

    @property
    def outside(self) -> float:
        """Median share of a step's time outside the solution of its QP and the proof."""
        return float(np.median([1 - plan.times.solve / plan.times.total for plan in self.plans]))


def closed_loop(make: Callable[[Plant], Controller], duration: float) -> Loop:
    """Return one run of a controller with its observer."""
    plant = Plant()
    controller = Timed(make(plant))
    run = simulate(
        RealPlant(plant, torque_profile=LOAD), controller, reference(duration), observer=KalmanObserver(plant, DT)
    )
    return Loop(run, np.array(controller.seconds), controller.plans)
