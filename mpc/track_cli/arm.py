"""Trial of the MPC on several joints: the plant on MuJoCo, caught masses, the film and the window."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.mechanism.bodies import Bodies
from allocator.presentation.progress import waiting
from allocator.shell.options import within
from allocator.units import BAR, DEG, PERCENT
from mpc.arm.experiments import arriving
from mpc.arm.film import SIZES, Film
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.arm.options import Described, asked_of_arm, described, owner_of_arm, refuse_options_of_one_joint
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.observer.base import Observer
from mpc.plant_cli import PlantOptions
from mpc.repetition.response import Response, doubted, postures, response
from mpc.track_cli.options import MPC, NOMINAL, OTHER, PLANTS, Request
from mpc.track_cli.trial import Tested, Trial
from mpc.trials.files import check_recordable
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.reference import Reference
from mpc.trials.other_plant import LONGER_LAG, refitted, sensor_errors
from mpc.trials.simulation import Controller, Run, in_motion

_SENSORS = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}  # of a real plant
_OFF = 0.05  # [-] error of the muscles' forces, on a real plant
_HYSTERESIS, _KNOWN = 5 * DEG, 0.75  # of a joint on a plant of another structure, and the known share of it
_POSTURES = 100  # at which muscles' contractions are computed


def arm_trial(request: Request, opened: ExitStack) -> Trial:
    """Return the trial of an arm that a command line asks for; `opened` closes its window. Raises `InvalidInput`."""
    machine, at, kind = request.machine, request.loop, request.trial.plant
    _check(request)
    given = described(machine, request.arm)
    arm, (tested, told, unknown) = given.arm, _tested(given, machine, kind, request.trial.seed)
    check_recordable(request.files, arm)
    asked = request.repeated.reference(request.trajectory, lambda: asked_of_arm(request.trajectory, arm, given.hand))
    catch = _caught(request, tested, arm, asked.duration / 2)
    settings = Settings(arm, at.dt, at.horizon, wait=request.trial.wait)
    if kind != NOMINAL:
        settings = settings._replace(compensation=told).calm
    settings, tuned = machine.tuned(settings, MPC)
    with waiting("building the controller"):
        controller, observer = loop(MPC, settings)
    film = _filmed(request.files, tested, given)
    window = [_window(tested, opened)] if request.arm.view else []
    return Trial(
        MPC, settings, tested, controller, observer, asked,
        owner_of_arm(machine, request.arm, arm, request.load),
        lambda: _responses(_tested(given, machine, NOMINAL, 0).plant, settings, controller, observer, asked),
        about=[
            f"arm: {arm.summary}",
            *given.notes,
            *_dry_friction(tested.model.dof_frictionloss, settings.compensation),
            f"trajectory: {asked.name}, {asked.duration:g} s",
        ],
        load=request.trial.load(asked, arm.n),
        x0=in_motion(arm, asked),
        remarks=lambda run: [f"not known to the controller: {unknown}" if unknown else "", tuned],
        with_margins=kind != NOMINAL,
        title=f"mpc with a model of {arm.n} joints and {arm.m} muscles, {PLANTS[kind]}",
        hand=given.hand,
        watches=[*catch, *([] if film is None else [film.watch]), *window],
        film=None if film is None else partial(_film, film),
    )  # fmt: skip


def _check(request: Request) -> None:
    """Refuse options of one joint."""
    trial = request.trial
    refuse_options_of_one_joint(
        stiffness=request.loop.stiffness,
        solver=trial.solver,
        observer=trial.observer,
        controller=None if trial.controller == MPC else trial.controller,
        amplitude=trial.amplitude,
    )
    within("--dt", request.loop.dt, "s", 1e-4, 0.5)


def _tested(given: Described, machine: PlantOptions, kind: str, seed: int) -> Tested[MujocoPlant]:
    """Return the plant under test of an arm. It has the friction and the regulators of the file, which are known."""
    arm, source = given.arm, None if given.read is None else given.read.model
    if kind == NOMINAL:
        return Tested(MujocoPlant.of(arm, source, gas=arm.gas), Compensation())
    told = known = _known(machine)
    driven, rubbing, unknown = arm, known.of_joints(arm.n), []
    if kind == OTHER:
        driven, laws = _other(arm)
        unknown = [laws, "lags 20 % longer"]
        if not machine.is_mujoco and all(one.absent for one in rubbing):
            rubbing, told = _slips(arm), replace(known, frictions=_slips(arm, _KNOWN))
            unknown += ["a quarter of the friction"]
    unknown += [f"muscles {_OFF / PERCENT:.2g} % stronger or weaker", *sensor_errors(**_SENSORS)]
    effects: dict[str, Any] = {"dead_time": known.dead_time, "dead_band": known.dead_band, **_SENSORS}
    effects |= {} if machine.is_mujoco else {"friction": rubbing}  # a MuJoCo model has its own
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], arm.m)
    plant = MujocoPlant.of(driven, source, gas=arm.gas, nominal=arm, force_gains=1 + _OFF * signs, **effects)
    return Tested(plant, told, ", ".join(unknown))


def _other(arm: Arm) -> tuple[Arm, str]:
    """Return the arm with longer lags and muscles of other force laws, and the names of these laws in words."""
    postures = np.random.default_rng(0).uniform(*arm.angle_limits, (_POSTURES, arm.n))
    contractions = np.array([arm.mechanism.contractions(q) for q in postures])
    fitted = refitted(arm.mechanism.muscles, contractions, arm.pressure_limits[1])
    mechanism = arm.mechanism.with_muscles(fitted.muscles)
    return replace(arm, mechanism=mechanism, lag=tuple(LONGER_LAG * arm.lags)), fitted.unknown


def _slips(arm: Arm, share: float = 1.0) -> tuple[MaxwellSlip, ...]:
    """Return a `share` of the usual hysteresis of every joint."""
    return tuple(MaxwellSlip.of_width(arm, share * _HYSTERESIS, joint=i) for i in range(arm.n))


def _responses(
    model: MujocoPlant, settings: Settings, controller: Controller, observer: Observer, asked: Reference
) -> tuple[Response, ...]:
    """Return the response of the loop on its model in the middle of a reference, and possible variations."""
    model.supply.dead_time = settings.compensation.dead_time
    return doubted([response(model, controller, observer, *postures(asked)[1])])


def _known(machine: PlantOptions) -> Compensation:
    """Return the known friction and regulators of the machine. The plant's sensors read without a delay."""
    return replace(machine.compensation_of_arm(), reading_age=0.0)


def _dry_friction(simulated: Sequence[float], known: Compensation) -> Iterator[str]:
    """Yield a remark if the loop does not know all of the `simulated` dry friction [N·m] of the joints."""
    joints = known.of_joints(len(simulated))
    whole, told = sum(simulated), sum(one.coulomb for one in joints if isinstance(one, Friction))
    if told < whole:
        knows = f"{told / whole:.0%} of it" if told else "nothing of it"
        most = f"up to {max(simulated):.3g} N·m per joint"
        yield f"the simulated joints have dry friction, {most}; controller and observer know {knows}"


def _caught(request: Request, tested: MujocoPlant, arm: Arm, time: float) -> list[Callable[[], None]]:
    """Return a watch that lets the hand catch the mass of --catch at a `time` [s], if there is one."""
    mass = request.arm.catch
    if not mass:
        return []
    if request.repeated.repeat is not None or not isinstance(arm.bodies, Bodies):
        raise InvalidInput("--catch is for one run of a --machine in the plane, such as arm26, without --repeat")
    return [arriving(tested, time, mass, (arm.bodies.length[-1], 0.0, 0.0), np.zeros(3))]


def _filmed(files: Sequence[Path], tested: MujocoPlant, given: Described) -> Film | None:
    """Return a film of the size of the largest of `files`, or None if there is no film among them."""
    endings = {path.suffix.lower() for path in files} & SIZES.keys()
    return Film(tested, given.arm, max(SIZES[ending] for ending in endings), given.hand) if endings else None


def _film(film: Film, run: Run, path: Path) -> str:
    """Write the film, and return a sentence on its pictures."""
    film.save(path)
    return f"filmed by {film.by}"


def _window(plant: MujocoPlant, opened: ExitStack) -> Callable[[], None]:
    """Open MuJoCo's viewer, which `opened` closes; return a watch that shows the plant in real time."""
    import mujoco.viewer

    viewer = opened.enter_context(mujoco.viewer.launch_passive(plant.model, plant.data))
    began: list[float] = []

    def watch() -> None:
        began[:] = began or [perf_counter() - plant.time]
        sleep(max(0.0, plant.time - (perf_counter() - began[0])))
        viewer.sync()

    return watch
