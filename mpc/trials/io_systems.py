"""Plants and controllers as discrete-time I/O systems of python-control.

    loop = closed_loop(plant, controller, reference)
    control.input_output_response(loop, T, U=0, X0=...)      equals `simulate`, to rounding

python-control cannot connect continuous with discrete systems. A plant is therefore sampled: its command is held over a
sample, and it is integrated in fine steps. Signals connect by name, so that `control.interconnect` needs no list.

A plant's memory is its state vector. A controller's memory is not: it is in the controller, which python-control
evaluates several times per sample, at first with undefined inputs. Each evaluation begins with a copy of the state
before the sample, and the last one counts. Samples therefore have to be consecutive, from t = 0 on, and linearisation
and operating points are available for plants only. The reference belongs to the controller, since a preview is not a
signal.
"""

from copy import deepcopy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.codegen.buffered import Buffered
from mpc.model.experiment import FINE
from mpc.model.machine import sample_time
from mpc.model.plant import INPUTS, NU, NX, STATES, Plant
from mpc.model.real import RealPlant
from mpc.model.real_experiment import RealExperiment
from mpc.observer.base import Differentiator, Observer, check_observer
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller

if TYPE_CHECKING:
    from control import InputOutputSystem

_MEASURED = ("theta", "P1", "P2")  # of a real plant


def sampled_plant(plant: Plant, dt: float) -> "InputOutputSystem":
    """Return `plant` every `dt` [s] as a system: inputs (P1_command, P2_command, d), outputs (the states, K)."""
    import control

    checks.instance("plant", plant, Plant, "a Plant; sampled_real_plant takes a RealPlant")
    dt = sample_time(dt)
    step = Buffered(plant.discrete(dt, FINE))
    return control.nlsys(
        lambda t, x, u, params: step(x, u[:NU], u[NU])[0][0],
        lambda t, x, u, params: np.array([*x, plant.stiffness(x)]),
        states=list(STATES),
        inputs=[*INPUTS, "d"],
        outputs=[*STATES, "K"],
        name="plant",
        dt=dt,
    )


def sampled_real_plant(real: RealPlant, dt: float, seed: int = 0) -> "InputOutputSystem":
    """Return `real` every `dt` [s] as a system: inputs (P1_command, P2_command, d), outputs (θ, P1, P2 as measured; the
    true states, K).

    Its states are the true ones, the friction's memory and the delayed commands, oldest first; `at_rest` returns one.
    The noise of a sample depends only on `seed` and time. Faults have more memory and are not supported.
    """
    import control

    checks.instance("real", real, RealPlant, "a RealPlant")
    dt = sample_time(dt)
    if real.faults:
        raise InvalidInput("a plant with faults is no I/O system, since the memory of faults is no state; use simulate")
    experiment, noise = RealExperiment(real, dt, np.zeros(NX), seed), _Noise(seed)
    waiting = experiment.memory.size - NX - real.friction.size

    def next_memory(t: float, x: Array, u: Array, params: object) -> Array:
        experiment.recall(x, round(t / dt))
        experiment.advance(u[:NU], float(u[NU]))
        return experiment.memory

    def outputs(t: float, x: Array, u: Array, params: object) -> Array:
        experiment.recall(x, round(t / dt))
        read = experiment.read(noise.at(round(t / dt)))
        return np.array([read[0], *read[2:], *x[:NX], real.stiffness(x[:NX])])

    return control.nlsys(
        next_memory,
        outputs,
        states=[
            *STATES,
            *(f"friction_{i}" for i in range(real.friction.size)),
            *(f"waiting_{i}" for i in range(waiting)),
        ],
        inputs=[*INPUTS, "d"],
        outputs=[*_MEASURED, *(f"true_{name}" for name in STATES), "K"],
        name="plant",
        dt=dt,
    )


def at_rest(plant: Plant | RealPlant, dt: float, reference: Reference) -> Array:
    """Return the initial state of the sampled `plant` in `simulate`: at rest on the reference's first point."""
    x = plant.at_rest(float(reference.theta[0]), float(reference.K[0]))
    return x if isinstance(plant, Plant) else RealExperiment(plant, dt, x, 0).memory


def sampled_controller(
    controller: Controller,
    reference: Reference,
    *,
    observer: Observer | None = None,
    velocity: bool = True,
    u_before: Array | None = None,
) -> "InputOutputSystem":
    """Return `controller` (any of them) on `reference`: inputs (θ, [ω,] P1, P2), outputs (P1_command, P2_command).

    Without `velocity` there is no input ω, and the `observer` has to estimate it. `u_before` (2,) [Pa] are the commands
    before the first sample, by default the first measured pressures.
    """
    import control

    checks.instance("controller", controller, Controller, "a controller, such as a TrackingMPC")
    checks.instance("reference", reference, Reference, "a Reference")
    if observer is not None:
        check_observer(observer, controller.dt)
    names = STATES if velocity else _MEASURED
    memory = _Rewindable(
        controller, reference, Differentiator(controller.dt) if observer is None else observer, u_before
    )

    def outputs(t: float, x: Array, y: Array, params: object) -> Array:
        return memory.command(round(t / controller.dt), y if velocity else np.insert(y, 1, np.nan))

    return control.nlsys(None, outputs, inputs=list(names), outputs=list(INPUTS), name="controller", dt=controller.dt)


def closed_loop(
    plant: Plant | RealPlant,
    controller: Controller,
    reference: Reference,
    *,
    observer: Observer | None = None,
    seed: int = 0,
) -> "InputOutputSystem":
    """Connect plant and controller: input d [N·m], outputs those of the plant and the commands. `at_rest` has the
    initial state.
    """
    import control

    checks.instance("plant", plant, Plant | RealPlant, "a Plant or a RealPlant")
    checks.instance("controller", controller, Controller, "a controller, such as a TrackingMPC")
    checks.instance("reference", reference, Reference, "a Reference")
    dt = controller.dt
    process = sampled_plant(plant, dt) if isinstance(plant, Plant) else sampled_real_plant(plant, dt, seed)
    u_before = at_rest(plant, dt, reference)[2:NX]
    velocity = isinstance(plant, Plant)  # measured only there
    driver = sampled_controller(controller, reference, observer=observer, velocity=velocity, u_before=u_before)
    outputs = [*process.output_labels, *INPUTS]
    return control.interconnect([process, driver], inputs=["d"], outputs=outputs, name="closed_loop")


class _Noise:
    """Standard normal noise by sample, equal to that of a `RealExperiment` with the same seed."""

    def __init__(self, seed: int) -> None:
        self._random, self._drawn = np.random.default_rng(seed), list[Array]()

    def at(self, sample: int) -> Array:
        while len(self._drawn) <= sample:
            self._drawn.append(self._random.standard_normal(NU))
        return self._drawn[sample]


class _Moment(NamedTuple):
    """Controller and observer after a sample, and its commands (2,) [Pa]."""

    controller: Controller
    observer: Observer
    u: Array | None


class _Rewindable:
    """Controller and observer that can repeat the last sample with other inputs."""

    def __init__(
        self, controller: Controller, reference: Reference, observer: Observer, u_before: Array | None
    ) -> None:
        self._wanted = reference.resampled(controller.dt)
        self._start = self._before = self._now = _Moment(controller, observer, u_before)
        self._k = -1  # last evaluated sample
        self._answers: dict[bytes, _Moment] = {}  # of this sample, by measurement

    def command(self, k: int, y: Array) -> Array:
        """Return the commands (2,) [Pa] for the measurement `y` (4,) at sample k."""
        self._go_to(k)
        asked = y.tobytes()
        if asked not in self._answers:
            self._answers[asked] = self._answer(k, y)
        self._now = self._answers[asked]
        assert self._now.u is not None  # it has been evaluated
        return self._now.u

    def _go_to(self, k: int) -> None:
        if k == self._k:
            return
        if k == 0:
            self._before = deepcopy(self._start)
            self._before.controller.reset()
            self._before.observer.reset()
        elif k == self._k + 1:
            self._before = self._now
        else:
            raise InvalidInput(f"sample {k} does not come after sample {self._k}: a controller's time runs forward")
        self._k, self._answers = k, {}

    def _answer(self, k: int, y: Array) -> _Moment:
        controller, observer, u_last = deepcopy(self._before)
        x, d = observer.estimate(y, y[2:] if u_last is None else u_last)
        plan = controller.step(x, *self._wanted.preview(k, controller.ahead), d)
        return _Moment(controller, observer, plan.u[0])
