"""A controller and its observer that drive a compiled plant are compiled with it, where all three can be.

That is a `TrackingMPC` whose whole step is compiled, with the `KalmanObserver` of the same plant and `Compensation`.
The first samples of a run are made by the readable parts, and the flat values are then taken from these; a run in which
anything is out of the ordinary (`mpc.trials.many.driven`) is left to `simulate`.
"""

from pathlib import Path
from types import ModuleType

import numpy as np

from allocator.calculus import Array
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import filling
from mpc.model.compiled_friction import friction_numbers
from mpc.model.plant import NU, NX
from mpc.model.plant import Plant as Model
from mpc.observer.base import Observer
from mpc.observer.compiled.whole import CompiledEstimate
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.compiled.sample.arrays import Beyond, StepArrays
from mpc.tracking.compiled.sample.whole import WholeStep
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.qp.solvers import Riccati
from mpc.tracking.rest import RestMode
from mpc.trials.many import rest
from mpc.trials.many.plant import CompiledExperiment
from mpc.trials.many.records import Answers, Plant, Resting
from mpc.trials.simulation import ClosedLoop, Controller

READABLE = 2  # samples that the readable parts begin with: these then remember what later ones do

_TEMPLATE = Path(__file__).parent / "driven.py"


class Driving:
    """Driving is the compiled loop of a controller and its observer with plants, and the arrays of its step."""

    def __init__(self, controller: TrackingMPC, whole: WholeStep, mode: RestMode, estimate: CompiledEstimate) -> None:
        """Write the formulas. Raises `Untranslatable` for those that are too long."""
        self._controller, self._whole, self._mode, self._estimate = controller, whole, mode, estimate
        known, preview, qp_step = controller.compensation, controller._preview, whole.qp_step
        friction = friction_numbers(known.friction)
        assert friction is not None  # there is a whole step
        self._arrays = StepArrays(
            qp_step.plant, controller.N, qp_step.structured, whole.feed_forward.readable,
            (preview.lower, preview.upper), Beyond(friction, preview.delay, known.dead_band, rests=False),
        )  # fmt: skip
        text, self._c = _turning(mode.plant)
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
            plant.c, plant.durations, plant.substeps, plant.sensors, experiment.full, experiment.waiting,
            experiment.angles,
            np.vstack([np.empty((READABLE, 1 + NU)), experiment.noise(left)]),
            np.concatenate([np.empty(READABLE), experiment.torques(left)]),
        )  # fmt: skip
        answers = Answers(
            loop.x, loop.estimate, loop.u, loop.rung, loop.status, loop.slack, loop.slack_force, loop.moved
        )
        previews = map(np.array, loop.wanted.preview(0, loop.steps + controller.ahead))  # that may be written
        last, rest = self._whole.remembered(), resting(self._mode, controller.rest, self._c)
        known = observed.address, self._arrays.address, rest, np.stack([last, last])
        done = self._loop(plant.module).driven(READABLE, under_way, *known, *previews, answers)
        loop.took[:] = np.nan
        return bool(done == loop.steps)


def driving(controller: Controller, observer: Observer | None) -> Driving | None:
    """Return what drives plants as controller and observer do, if these are such that they are compiled.

    Raises `Untranslatable` for formulas that are too long.
    """
    if not (type(controller) is TrackingMPC and type(observer) is KalmanObserver):
        return None
    whole, mode, estimate = controller._whole, controller.rest_mode, observer.compiled
    if whole is None or estimate is None or not isinstance(mode, RestMode):
        return None
    able = (
        isinstance(controller._solve, Riccati)
        and controller.iterations == 1
        and controller.budget is None  # nobody waits for a command here: what takes too long would depend on the day
        and (controller.plant, controller.compensation, controller.dt)
        == (observer.plant, observer.compensation, observer.dt)
    )
    return Driving(controller, whole, mode, estimate) if able else None


def _turning(plant: Model) -> tuple[str, Array]:
    """Return a module of the formula `turning`, and its numbers."""
    import casadi as ca

    x = ca.SX.sym("x", NX)
    gains = [side.torque_gain(x[2 + i]) for i, side in enumerate(plant.joint.sides(x[0]))]
    turning = ca.Function("turning", [x], [ca.cse(ca.densify(ca.vertcat(plant.isobaric(x), *gains)))])
    source = filling("turning", turning, 0)
    head = "import math\n\nimport numpy as np\n\nfrom mpc.codegen.jit import inlined\n\n\n"
    return f"{head}@inlined\n{source.text}\n", source.c


def resting(mode: RestMode, allowed: bool, c: Array) -> Resting:
    """Return copies of the settings and memory of the rest `mode`; `c` are the numbers of the formulas."""
    mode.catch_up()
    known, s = np.zeros(8), np.zeros(14)
    known[rest.INERTIA], known[rest.DT] = mode.plant.inertia, mode.dt
    known[rest.SETTLING], known[rest.DWELL] = mode.settling, mode.dwell
    known[rest.SHORTEST], known[rest.LONGEST] = mode.quarter_range
    known[rest.DEAD_BAND], known[rest.HIGHEST] = mode.compensation.dead_band, mode.limits.pressure[1]
    s[rest.SINCE], s[rest.TORQUE], s[rest.ERROR], s[rest.FREE] = mode._since, mode._torque, mode._error, mode._free
    s[rest.SIDE], s[rest.RINGS], s[rest.QUARTER], s[rest.RESTS] = mode.side, mode.ringing, mode._quarter, mode.resting
    s[rest.SAMPLES], s[rest.COUNTED], s[rest.SWUNG] = mode._samples, mode._counted, mode._swings
    s[rest.IN_SUM], s[rest.LEAST], s[rest.MOST] = mode._in_sum, mode._low, mode._high
    arrays = (np.array(array, float) for array in (mode.reference, mode._p, mode._began, mode._quarters, mode._sum))
    return Resting(allowed and mode.worthwhile, c, known, s, *arrays)
