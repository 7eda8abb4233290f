"""Compiled loop of a controller, its observer and a compiled plant, if all three can be compiled.

The controller has to be the `TrackingMPC` of a joint with a compiled step, or a baseline of a joint; the observer a
`KalmanObserver` of the same plant and `Compensation`, or a `Differentiator`. The readable parts make the first samples
of a run, and the flat values are then copied from them.
`simulate` makes runs with samples that are not ordinary (`mpc.trials.many.driven`).
"""

from pathlib import Path
from types import ModuleType
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.modules import imported, with_formulas
from mpc.model.arm.model import Arm
from mpc.model.plant import NU
from mpc.observer.base import Differentiator, Observer
from mpc.observer.compiled.differences import CompiledDifferences
from mpc.observer.compiled.factory import CompiledEstimate
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.base import BaseController
from mpc.tracking.compiled.sample.whole import WholeStep
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.qp.solvers import Riccati
from mpc.trials.many.plant import CompiledExperiment
from mpc.trials.simulation import ClosedLoop, Controller
from mpc.yardsticks.baselines import Baseline
from mpc.yardsticks.closed_step import ClosedStep, closed_step


class Plant(NamedTuple):
    """Plant under test, see `mpc.trials.many.process`."""

    c: Array
    durations: Array
    steps: NDArray[np.int64]
    sensors: Array
    full: Array
    waiting: Array
    angles: Array  # (a, n)
    noise: Array  # (M, n + m)
    torques: Array  # (M, n)


class Answers(NamedTuple):
    """Record of M samples, see `mpc.trials.simulation.Run`."""

    x: Array  # (M+1, 4)
    estimate: Array  # (M, 5)
    u: Array  # (M, 2)
    rung: NDArray[np.int64]
    status: NDArray[np.int64]
    slack: Array
    slack_force: Array
    moved: Array  # (M, 3)


READABLE = 2  # first samples, by the readable parts, which then have the complete state

Whole: TypeAlias = WholeStep | ClosedStep
Estimate: TypeAlias = CompiledEstimate | CompiledDifferences

_TEMPLATE = Path(__file__).parent / "driven.py"


class Driving:
    """Compiled loop of a controller and its observer with plants, and the arrays of its step."""

    def __init__(self, controller: Controller, whole: Whole, estimate: Estimate) -> None:
        self._controller, self._whole, self._estimate = controller, whole, estimate
        self._arrays = whole.arrays()
        self._modules = {"observer": estimate.module, "joint": whole.module}

    def _loop(self, process: ModuleType) -> ModuleType:
        """Return the loop for plants under test of the kind `process`."""
        modules = self._modules | {"process": process}
        loads = "".join(f"import {module.__name__} as {name}\n" for name, module in modules.items())
        return imported(with_formulas(_TEMPLATE, f"\n{loads}\n"))

    def drive(self, loop: ClosedLoop) -> bool:
        """Make the samples of `loop`, which has this plant, controller and observer, by the compiled loop; return
        whether all of them were ordinary.
        """
        controller, experiment = self._controller, loop.experiment
        if loop.steps <= READABLE:
            return False
        for k in range(READABLE):
            loop.sample(k)
        observed = self._estimate.copied()
        if observed is None:
            return False
        assert isinstance(experiment, CompiledExperiment)  # of a `CompiledPlant`
        plant, left = experiment.plant, loop.steps - READABLE
        under_way = Plant(
            plant.c, plant.durations, plant.steps, plant.sensors, experiment.full, experiment.waiting,
            experiment.angles,
            np.vstack([np.empty((READABLE, 1 + NU)), experiment.noise(left)]),
            np.vstack([np.empty((READABLE, 1)), experiment.torques(left)]),
        )  # fmt: skip
        answers = Answers(
            loop.x, loop.estimate, loop.u, loop.rung, loop.status, loop.slack, loop.slack_force, loop.moved
        )
        previews = map(np.array, loop.wanted.preview(0, loop.steps + controller.ahead))  # writable copies
        last = self._whole.remembered()
        known = observed.address, self._arrays.address, np.stack([last, last])
        done = self._loop(plant.module).driven(READABLE, under_way, *known, *previews, answers)
        loop.took[:] = np.nan
        return bool(done == loop.steps)


def driving(controller: Controller, observer: Observer | None) -> Driving | None:
    """Return a compiled driver equal to controller and observer, if they can be compiled."""
    if not isinstance(controller, BaseController) or (whole := _whole(controller)) is None:
        return None
    if type(observer) is Differentiator:
        return Driving(controller, whole, CompiledDifferences(observer))
    if type(observer) is not KalmanObserver or observer.compiled is None:
        return None
    told, other = ((part.plant, part.compensation, part.dt) for part in (controller, observer))
    return Driving(controller, whole, observer.compiled) if told == other else None


def _whole(controller: BaseController) -> Whole | None:
    """Return the compiled step of a joint's controller whose results do not depend on the speed of the machine."""
    if isinstance(controller, Baseline):
        return closed_step(controller)
    if type(controller) is not TrackingMPC or isinstance(controller.plant, Arm):
        return None
    able = isinstance(controller._solve, Riccati) and controller.iterations == 1 and controller.budget is None
    return controller._whole if able else None
