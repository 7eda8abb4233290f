"""Trial of a controller on a joint: the plants under test, and the stiffness that a hand would feel."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from allocator.errors import InvalidInput
from allocator.feasibility.intervals import torque_interval
from allocator.presentation.progress import counted, waiting
from allocator.units import DEG
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.model.real import RealPlant
from mpc.repetition.response import responses
from mpc.track_cli.options import NOMINAL, PLANTS, REAL, Request
from mpc.track_cli.trial import Tested, Trial
from mpc.trials.files import reference_called
from mpc.trials.loops import Settings, loop, robust
from mpc.trials.motions.corrections import Owner
from mpc.trials.other_plant import other_plant, unknown_errors
from mpc.trials.pictures.animation import save_animation
from mpc.trials.simulation import Process, Run

_REAL_LAG = 0.12  # [s] default of a real plant
_ANGLES = 61  # at which a joint's strength is computed
_PUSH = 2.0  # [±°] whose felt stiffness is reported


def joint_trial(request: Request) -> Trial:
    """Return the trial of a joint that a command line asks for. Raises `InvalidInput`."""
    machine, at, trial = request.machine, request.loop, request.trial
    kind, name = trial.plant, trial.controller
    plant = machine.plant(**({"lag": _REAL_LAG} if kind == REAL else {}))
    asked = request.repeated.reference(
        request.trajectory, lambda: reference_called(request.trajectory, at.stiffness, plant)
    )
    asked.samples(at.dt)  # before anything is built
    if trial.payload:
        _check_payload(trial.payload, plant)
    known = machine.compensation()
    tested, told, unknown = _tested(kind, plant, known, exact=not trial.payload)
    settings = Settings(plant, at.dt, at.horizon, told, solver=trial.solver, wait=trial.wait)
    settings, tuned = machine.tuned(settings, name)
    observer = False if tested is plant and trial.observer is None else trial.observer  # its whole state is measured
    with waiting("building the controller"):
        if tested is not plant and not tuned:
            settings = robust(name, settings, asked)
        controller, estimator = loop(name, settings, observer)
    title = f"{name} with a model of {_muscles(plant)}, {PLANTS[kind]}"

    def remarks(run: Run) -> Iterator[str]:
        yield f"not known to the controller: {unknown}" if unknown else ""
        yield _felt(run, tested, trial.amplitude)
        yield tuned

    return Trial(
        name, settings, tested, controller, estimator, asked,
        Owner.of(plant, known, name, request.load),
        lambda: responses(name, settings, asked, machine.spreads(), observer=observer),
        about=[*_about(plant, known), f"trajectory: {asked.summary()}"],
        load=trial.load(asked),
        remarks=remarks,
        with_margins=observer is not False,
        title=title,
        film=partial(_film, title=title),
    )  # fmt: skip


def _tested(kind: str, model: Plant, known: Compensation, exact: bool) -> Tested[Process]:
    """Return the plant under test. It has the friction and the regulators of the file, which the controller knows.

    If `exact`, the nominal plant without such effects is the model itself.
    """
    if kind == NOMINAL:
        return Tested(model if exact and known == Compensation() else RealPlant.of(model, known), known)
    if kind == REAL:
        real = RealPlant.standard(nominal=model)
        unknown = unknown_errors(real, "friction" in known.told)
    else:
        real, unknown = other_plant(model, known=known)
    return Tested(replace(real, **known.told), replace(real.known(), **known.told), unknown)


def _check_payload(payload: float, plant: Plant) -> None:
    """Refuse a payload [N·m] that the joint cannot hold at any angle."""
    with warnings.catch_warnings(action="ignore"):  # the answers themselves report what is assumed
        low, high = torque_interval(np.linspace(*plant.joint.angle_range, _ANGLES), joint=plant.joint)
    strength = float(np.nanmax(np.abs([low, high])))
    if abs(payload) > strength:
        raise InvalidInput(f"--payload {payload:g}: the joint holds {strength:.3g} N·m at most")


def _about(plant: Plant, known: Compensation) -> Iterator[str]:
    """Yield sentences on the model and on what is simulated."""
    yield f"plant: {plant.summary}"
    if known.summary:
        yield f"known to the controller: {known.summary}"
    if untold := known.untold(plant):
        yield f"simulated, but not known to the controller: {untold}"


def _felt(run: Run, tested: Process, amplitude: float | None) -> str:
    """Return a sentence on the stiffness against pushes by ±`amplitude` [°], or "" if it is that without hysteresis."""
    if isinstance(tested, RealPlant) and not tested.friction.loop.absent:
        push = _PUSH if amplitude is None else amplitude
        K = run.felt(push * DEG, tested.friction.loop)
        return f"felt stiffness, with hysteresis: pushes of ±{push:g}° meet {K.min():.3g} … {K.max():.3g} N·m/rad"
    if amplitude is not None:
        return "--amplitude: this plant has no hysteresis; pushes of every size meet the same stiffness"
    return ""


def _film(run: Run, path: Path, title: str) -> str:
    save_animation(run, path, title, progress=partial(counted, title="drawing"))
    return ""


def _muscles(plant: Plant) -> str:
    """Return the force laws of both muscles, in words."""
    names = [type(muscle).__name__ for muscle in (plant.joint.agonist, plant.joint.antagonist)]
    return f"two {names[0]} muscles" if names[0] == names[1] else " and ".join(names)
