"""A whole sample of a loop, with observer and compensation, against the bare step of IPOPT on the same problem.

The plant is the standard real one, with identifiable effects in the controller's model; the figure is the delay of a
control loop from the readings to the command.
"""

from collections.abc import Iterator
from math import nan
from time import thread_time
from typing import Any

import numpy as np

from allocator.calculus import Array
from benchmarks.speed.clock import MISSED, Measurement
from benchmarks.speed.steps.loop import DT, closed_loop, reference
from benchmarks.speed.truth import BenchmarkFailure
from mpc import KalmanObserver, RealPlant, TrackingMPC, simulate
from mpc.tracking.plan import Plan
from mpc.trials.simulation import Run
from mpc.yardsticks.nonlinear import NonlinearMPC

PART, N = "sample", 20
DURATION = 3.0  # [s]
WANTED, TAIL = 120.0, 3.5  # required times faster than IPOPT's bare step; 99 % of the samples within so many medians
FLOOR = 20.0
ROUNDS = 3


class TimedObserver:
    """Observer with estimates timed by the thread's clock; `readable` ones are not compiled."""

    def __init__(self, observer: KalmanObserver, readable: bool = False) -> None:
        self._observer = observer
        if readable:
            observer.compiled = None

    def reset(self) -> None:
        """Forget the past, and the times."""
        self._observer.reset()
        self.seconds: list[float] = []

    def estimate(self, y: Array, u: Array) -> tuple[Array, float]:
        """The observer's."""
        began = thread_time()
        found = self._observer.estimate(y, u)
        self.seconds.append(thread_time() - began)
        return found


class TimedController:
    """Controller with steps timed by the thread's clock; `staged` ones go stage by stage."""

    def __init__(self, controller: TrackingMPC, staged: bool = False) -> None:
        self._controller, self._staged = controller, staged
        self.dt, self.ahead = controller.dt, controller.ahead
        if staged:
            controller._whole = None

    def reset(self) -> None:
        """Forget the past, and the times."""
        self._controller.reset()
        self.seconds: list[float] = []

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """The controller's."""
        began = thread_time()
        plan = self._controller.step(x, theta_ref, K_ref, d)
        self.seconds.append(thread_time() - began)
        return plan


def run(staged: bool) -> tuple[Run, Array, Array]:
    """Return a run, compiled whole or `staged` and readable, and the times (M,) of observer and controller [s]."""
    plant = RealPlant.standard()
    model, known = plant.nominal, plant.known()
    observer = TimedObserver(KalmanObserver(model, DT, compensation=known), staged)
    controller = TimedController(TrackingMPC(model, DT, N, compensation=known), staged)
    found = simulate(plant, controller, reference(DURATION), observer=observer)
    return found, np.array(observer.seconds), np.array(controller.seconds)


def measure(light: bool) -> Iterator[Measurement]:
    """Measure the sample and its two halves; IPOPT's steps lie between the runs."""
    (first, *one), (other, *_) = run(staged=False), run(staged=True)
    if not np.allclose(first.u, other.u, rtol=1e-9) or (first.status != other.status).any():
        raise BenchmarkFailure("the compiled sample and its readable stages do not command the same")
    rival = closed_loop(lambda plant: NonlinearMPC(plant, DT, N, solver="ipopt"), 1.0 if light else DURATION).seconds
    times = [one, *([*run(staged=False)[1:]] for _ in range(1 if light else ROUNDS - 1))]
    observer, controller = (np.min([pair[i] for pair in times], axis=0) for i in (0, 1))
    for what, mine in (("whole sample", observer + controller), ("its observer", observer), ("its step", controller)):
        low, ratio, high = np.quantile(np.median(rival) / mine, (0.25, 0.5, 0.75))
        tail = np.quantile(mine, 0.99) / np.median(mine)
        note, whole = f"99th percentile {tail:.2g} medians", what == "whole sample"
        if whole:
            note += f", at most {TAIL:g} asked{'' if tail <= TAIL else f': {MISSED}'}"
        yield Measurement(
            *(PART, f"{what}, N = {N}", float(np.median(mine)), "sample", "IPOPT's bare step"),
            *(float(np.median(rival)), ratio, low, high, *((WANTED, FLOOR) if whole else (nan, nan)), note),
        )  # fmt: skip
