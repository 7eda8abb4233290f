"""A controller and its observer that drive a compiled plant are compiled with it, where all three can be.

That is a `TrackingMPC` whose step is compiled, with the `KalmanObserver` of the same plant and `Compensation`. The
first samples of a run are made by the readable parts, and the flat values are then taken from these; a run in which
anything is out of the ordinary (`mpc.trials.many.driven`) is left to `simulate`.
"""

from pathlib import Path
from types import ModuleType

import numpy as np

from allocator.calculus import Array
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import filling
from mpc.model.compensation import Compensation
from mpc.model.contact import Contact
from mpc.model.plant import NU, NX
from mpc.model.plant import Plant as Model
from mpc.observer.base import Observer
from mpc.observer.compiled.whole import CompiledEstimate
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.compiled.qp_step import CompiledFeedForward, CompiledQPStep
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.qp.solvers import Riccati
from mpc.tracking.rest import RestMode
from mpc.trials.many.plant import CompiledExperiment
from mpc.trials.many.records import Answers, Plant
from mpc.trials.many.taken import known_of, memory_of, ordinary, step_of
from mpc.trials.reference import Reference
from mpc.trials.simulation import ClosedLoop, Controller

READABLE = 2  # samples that the readable parts begin with: these then remember what later ones do
LEAST = 1e-300  # [N·m/rad] of a stiffness, as in `mpc.tracking.preview`

_TEMPLATE = Path(__file__).parent / "driven.py"


class Driving:
    """Driving is the compiled loop of a controller and its observer with plants, and the numbers of its formulas."""

    def __init__(self, controller: TrackingMPC, estimate: CompiledEstimate) -> None:
        """Write the formulas. Raises `Untranslatable` for those that are too long."""
        self._controller, self._estimate = controller, estimate
        plant, qp_step = controller.plant, controller._qp_step
        assert isinstance(plant, Model)  # `driving` has looked
        assert isinstance(qp_step, CompiledQPStep)
        text, self.c = _told(plant, controller.compensation)
        self._modules = {"observer": estimate.module, "joint": qp_step.plant.step, "told": imported(text)}

    def _loop(self, process: ModuleType) -> ModuleType:
        """Return the loop with plants under test of the kind `process`."""
        modules = self._modules | {"process": process}
        loads = "".join(f"import {module.__name__} as {name}\n" for name, module in modules.items())
        return imported(with_formulas(_TEMPLATE, f"\n{loads}\n"))

    def drive(self, loop: ClosedLoop) -> bool:
        """Let the compiled loop do the samples of `loop`, which has this plant, controller and observer; return whether
        all of them were ordinary.
        """
        controller, experiment = self._controller, loop.experiment
        if loop.steps <= READABLE or not _meant(loop.wanted):
            return False
        for k in range(READABLE):
            loop.sample(k)
        observed = self._estimate.copied()
        if observed is None or not ordinary(controller):
            return False
        assert isinstance(experiment, CompiledExperiment)  # of a `CompiledPlant`
        plant, left = experiment.plant, loop.steps - READABLE
        under_way = Plant(
            plant.c, plant.durations, plant.substeps, plant.sensors, experiment.full, experiment.waiting,
            np.vstack([np.empty((READABLE, NU)), experiment.noise(left)]),
            np.concatenate([np.empty(READABLE), experiment.torques(left)]),
        )  # fmt: skip
        answers = Answers(
            loop.x, loop.estimate, loop.u, loop.rung, loop.status, loop.slack, loop.slack_force, loop.moved
        )
        previews = loop.wanted.preview(0, loop.steps + controller.ahead)
        known = observed.address, known_of(controller, self.c), step_of(controller)
        done = self._loop(plant.module).driven(READABLE, under_way, *known, memory_of(controller), *previews, answers)
        loop.took[:] = np.nan
        return bool(done == loop.steps)


def _meant(wanted: Reference) -> bool:
    """Return whether all of a reference can be meant, as `mpc.tracking.preview` asks."""
    return bool((np.abs(wanted.theta) <= 2 * np.pi).all() and (wanted.K >= LEAST).all())


def driving(controller: Controller, observer: Observer | None) -> Driving | None:
    """Return what drives plants as controller and observer do, if these are such that they are compiled.

    Raises `Untranslatable` for formulas that are too long.
    """
    if not (type(controller) is TrackingMPC and type(observer) is KalmanObserver):
        return None
    steps = (controller._qp_step, CompiledQPStep), (controller._feed_forward, CompiledFeedForward)
    parts = (controller.plant, Model), (controller.rest_mode, RestMode), (controller._solve, Riccati), *steps
    told = (controller.plant, controller.compensation, controller.dt)
    able = (
        all(isinstance(part, kind) for part, kind in parts)
        and controller.iterations == 1
        and controller.budget is None  # nobody waits for a command here: what takes too long would depend on the day
        and told == (observer.plant, observer.compensation, observer.dt)
    )
    return Driving(controller, observer.compiled) if able and observer.compiled is not None else None


def _told(plant: Model, known: Compensation) -> tuple[str, Array]:
    """Return a module of the formulas, and its numbers."""
    import casadi as ca

    friction = known.friction
    x, memory, motion = ca.SX.sym("x", NX), ca.SX.sym("memory", friction.size), ca.SX.sym("motion")
    contact = Contact(plant, x)
    gains = [side.torque_gain(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))]
    formulas = {
        "torque": ([x, memory], [ca.SX(friction.torque(memory, contact))]),
        "moved": ([x, memory, motion], [ca.SX(friction.moved(memory, motion, contact))]),
        "turning": ([x], [ca.vertcat(plant.isobaric(x), *gains)]),
    }
    text, c = "import math\n\nimport numpy as np\n\nfrom mpc.codegen.jit import inlined\n\n\n", np.zeros(0)
    for name, (given, found) in formulas.items():
        source = filling(name, ca.Function(name, given, ca.cse([ca.densify(one) for one in found])), c.size)
        text, c = text + f"@inlined\n{source.text}\n\n", np.concatenate([c, source.c])
    return text, c
