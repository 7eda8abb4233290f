"""Command `antagonist track`, and the list of all commands about motion.

Options are in degrees and bar, the library is in SI units. Heavy libraries are imported when a command runs.
"""

import os
import sys
import warnings
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator import checks
from allocator.cli import app
from allocator.errors import InvalidInput, MissingBackend
from allocator.lazy import Console
from allocator.presentation.progress import waiting
from allocator.shell import failures
from allocator.shell.options import Command, finite, grouped, within
from allocator.shell.outputs import IMAGES, Force, check_ending, claim, files_of_run, say
from allocator.units import DEG
from mpc.arm.cli import ArmOptions, refuse_options_of_one_joint, track_arm
from mpc.bench.cli import devices_command, run_command, sweep_command
from mpc.bench.measure_cli import measure_command
from mpc.explorer.cli import explore
from mpc.export.cli import export_app
from mpc.export.serial.cli import bench_check_command
from mpc.identification.cli import fit_motion_command
from mpc.plant_cli import LoopOptions, PlantOptions, init_command
from mpc.repetition.options import RepeatOptions, progress, report
from mpc.trials.motions.trajectories import TRAJECTORIES
from mpc.tuning_cli import tune_command

if TYPE_CHECKING:
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant
    from mpc.trials.loops import Settings
    from mpc.trials.motions.reference import Reference
    from mpc.trials.simulation import Process, Run

_OTHER, _REAL, _NOMINAL = "other", "real", "nominal"  # plants
_PLANTS = {
    _OTHER: "driving a plant of another structure",
    _REAL: "driving the plant with the effects of a real one",
    _NOMINAL: "driving its own model",
}
_REAL_LAG = 0.12  # [s] default of a real plant
_SUFFIXES = (*IMAGES, ".csv", ".npz", ".mcap", ".gif", ".mp4")
_OWN_NAMES = ("tracking.png", "tracking.csv")
_OWN_FILM = "tracking.gif"  # for several joints
_MPC = "mpc"
_ANGLES = 61  # at which a joint's strength is computed
_PUSH = 2.0  # [±°] whose felt stiffness is reported


_EPILOG = "\n\n".join(
    [
        "Standard trajectories, which are smaller on a joint that has less room:",
        *(f"{name}: {t.summary}" for name, t in TRAJECTORIES.items()),
    ]
)


@app.command(cls=Command, short_help="simulate a controller on a joint or an arm", epilog=_EPILOG)
@grouped
def track(
    options: PlantOptions,
    at: LoopOptions,
    more: ArmOptions,
    repeated: RepeatOptions,
    trajectory: Annotated[
        str | None,
        typer.Argument(
            help="sine (the default), min-jerk, chirp, steps, stiffness-step, stiffness-ramps, together, jumps, "
            "or a file; a CSV has the columns t,theta_deg,stiffness. Standard trajectories are smaller on a "
            "joint with less room. For several joints: circle (the default), reach, hold, draw (arm26), or a "
            "CSV of angles or of the hand's path and of stiffness. An .npz of a run repeats its trajectory"
        ),
    ] = None,
    reference: Annotated[str | None, typer.Option(help="file of the trajectory; instead of the argument")] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            help="a .png, .gif, .mp4, .csv, .npz or .mcap to write, or a directory; may be repeated. A directory "
            "gets tracking.png and tracking.csv, and for several joints tracking.gif"
        ),
    ] = None,
    solver: Annotated[
        str | None,
        typer.Option(
            help="QP or NLP solver; for mpc riccati (default), daqp or a solver of qpsolvers, e.g. osqp; for nmpc "
            "ipopt or fatrop"
        ),
    ] = None,
    plant: Annotated[
        str | None,
        typer.Option(
            help="plant to drive: other (the default), real or nominal; other: muscles of another force law and "
            "the effects of real. real: wrong muscle strengths, hysteresis, dead time, dead band, sensors "
            "with steps and noise. nominal: the controller's model. For several joints nominal (the default), "
            "or real: 5 % force error, noisy sensors, 20 ms dead time"
        ),
    ] = None,
    controller: Annotated[
        str, typer.Option(help="mpc, nmpc (slow), pid, pi, predictive-pid, lqr or feedforward")
    ] = _MPC,
    observer: Annotated[
        bool | None,
        typer.Option(
            help="estimate state and disturbance torque; by default mpc, nmpc and lqr do unless the plant is nominal"
        ),
    ] = None,
    payload: Annotated[
        float, typer.Option(help="unmodelled load from half-way on [N·m]; with several joints on the first one")
    ] = 0.0,
    seed: Annotated[int, typer.Option(help="seed of the sensor noise")] = 0,
    amplitude: Annotated[
        float | None,
        typer.Option(
            help="amplitude of pushes whose felt stiffness is reported [±°]; for plants with hysteresis; 2 by default"
        ),
    ] = None,
    margins: Annotated[Path | None, typer.Option(help="picture of the loop's margins at three postures")] = None,
    show: Annotated[bool, typer.Option("--show", help="open the picture when it is written")] = False,
    wait: Annotated[
        bool,
        typer.Option(
            "--wait",
            envvar="ANTAGONIST_WAIT",
            help="wait for compilation of the mpc step; needed once after an installation, and once for each arm. "
            "Otherwise it is compiled in a second process, and this run takes the uncompiled step",
        ),
    ] = False,
    force: Force = False,
) -> None:
    """Simulate a controller that tracks angle and stiffness, and report its errors.

    By default the controller drives a joint that its model does not describe: muscles of another force law, 10 %
    stronger and weaker than modelled, with hysteresis, dead time and noise.

    With several joints (--machine arm26, arm48, leg37, a file with [bodies], or a MuJoCo model (.xml) on hinges with
    tendons as muscles) the controller tracks angles and a stiffness matrix on MuJoCo, and the motion is filmed.
    """
    from rich.console import Console

    from allocator.presentation.progress import counted
    from mpc.model.plant import Plant
    from mpc.model.real import RealPlant
    from mpc.repetition.practice import practise
    from mpc.repetition.response import responses
    from mpc.trials.files import reference_called
    from mpc.trials.loops import loop, margins_in_words, robust, sliding_margins
    from mpc.trials.motions.corrections import Owner, compared
    from mpc.trials.pictures.animation import save_animation
    from mpc.trials.pictures.report import plot_margins, write_run
    from mpc.trials.simulation import simulate

    console = Console()
    finite("--payload", payload, "N·m")
    within("--amplitude", amplitude, "°", 1e-3, 180)
    checks.count("--seed", seed, least=0)
    several = options.of_several
    own = (*_OWN_NAMES, _OWN_FILM) if several else _OWN_NAMES
    if None not in (trajectory, reference):
        raise InvalidInput(f"two trajectories are asked for: {trajectory} and --reference {reference}; leave one out")
    trajectory = trajectory if reference is None else reference
    files = files_of_run(out or [Path()], _SUFFIXES, own)
    check_ending("--margins", margins, IMAGES)
    learned = repeated.written(trajectory)
    claim(*files, margins, *learned, inputs=(trajectory, repeated.learned, *options.files), force=force, own=own)
    if several:
        named = None if controller == _MPC else controller
        refuse_options_of_one_joint(
            stiffness=at.stiffness, solver=solver, observer=observer, controller=named, amplitude=amplitude
        )
        track_arm(
            options,
            more,
            trajectory,
            files,
            plant=plant or _NOMINAL,
            payload=payload,
            dt=at.dt,
            horizon=at.horizon,
            seed=seed,
            repeated=repeated,
            learned=learned,
            margins=margins,
            wait=wait,
        )
        _show(files if show else [])
        return
    if more != ArmOptions():
        raise InvalidInput("--stiffness-of, --hand, --catch and --view go with a --machine of several joints")
    plant = plant or _OTHER
    nominal = options.plant(**({"lag": _REAL_LAG} if plant == _REAL else {}))
    asked = repeated.reference(trajectory, lambda: reference_called(trajectory, at.stiffness, nominal))
    asked.samples(at.dt)  # before anything is built
    if payload:
        _check_payload(payload, nominal)
    half_way = float(asked.t[-1] - asked.t[0]) / 2
    known = options.compensation()
    tested, settings, unknown = _tested(plant, nominal, known, ((half_way, payload),) if payload else ())
    settings, tuned = options.tuned(settings._replace(dt=at.dt, N=at.horizon, solver=solver, wait=wait), controller)
    if observer is None and isinstance(tested, Plant):
        observer = False  # the whole state is measured, without disturbances
    with waiting("building the controller"):
        if tested is not nominal and not tuned:
            settings = robust(controller, settings, asked)
        driver, estimator = loop(controller, settings, observer)
    owner = Owner.of(nominal, known, controller, repeated.load or (f"payload {payload:g} N·m" if payload else ""))
    begun = repeated.begun(asked, owner, at.dt)
    if learned:
        learner = repeated.learner(
            asked, lambda: responses(controller, settings, asked, options.spreads(), observer=observer),
            at.dt, begun, nominal.angle_limits, controller,
        )  # fmt: skip
        practice = practise(tested, driver, learner, observer=estimator, seed=seed, progress=progress(console))
        done = practice.best
    elif begun is not None:
        done = compared(
            simulate(tested, driver, begun.reference, observer=estimator, seed=seed, progress=True), begun.wanted
        )
        say(console, f"played: {begun.summary}")
    else:
        done = simulate(tested, driver, asked, observer=estimator, seed=seed, progress=True)

    _report(done, nominal, known, asked, console)
    if unknown:
        say(console, f"not known to the controller: {unknown}")
    if isinstance(tested, RealPlant) and not tested.friction.loop.absent:
        push = _PUSH if amplitude is None else amplitude
        K = done.felt(push * DEG, tested.friction.loop)
        felt = f"pushes of ±{push:g}° meet {K.min():.3g} … {K.max():.3g} N·m/rad"
        say(console, f"felt stiffness, with hysteresis: {felt}")
    elif amplitude is not None:
        say(console, "--amplitude: this plant has no hysteresis; pushes of every size meet the same stiffness")
    if learned:
        report(learner, owner, practice.first.theta, done.theta, learned, console)
    if tuned:
        say(console, tuned)
    if observer is not False:
        for sentence in margins_in_words(controller, settings, asked, driver):
            say(console, sentence)
    title = f"{controller} with a model of {_muscles(nominal)}, {_PLANTS[plant]}"
    bar = partial(counted, title="drawing")
    for path in files:
        if path.suffix.lower() in IMAGES:
            say(console, f"drawing {path}")
        write_run(done, path, lambda file: save_animation(done, file, title, progress=bar), title, model=nominal)
    if margins is not None:
        plot_margins(sliding_margins(controller, settings), margins, title)
        files = [*files, margins]
    say(console, f"written: {', '.join(map(str, files))}")
    _show(files if show else [])


def _check_payload(payload: float, plant: "Plant") -> None:
    """Refuse a payload [N·m] that the joint cannot hold at any angle."""
    import numpy as np

    from allocator.feasibility.intervals import torque_interval

    with warnings.catch_warnings(action="ignore"):  # the answers themselves report what is assumed
        low, high = torque_interval(np.linspace(*plant.joint.angle_range, _ANGLES), joint=plant.joint)
    strength = float(np.nanmax(np.abs([low, high])))
    if abs(payload) > strength:
        raise InvalidInput(f"--payload {payload:g}: the joint holds {strength:.3g} N·m at most")


def _show(files: list[Path]) -> None:
    for path in files:
        if path.suffix.lower() not in (".csv", ".npz", ".mcap"):
            typer.launch(str(path))


def _muscles(plant: "Plant") -> str:
    """Return the force laws of both muscles, in words."""
    names = [type(muscle).__name__ for muscle in (plant.joint.agonist, plant.joint.antagonist)]
    return f"two {names[0]} muscles" if names[0] == names[1] else " and ".join(names)


def _report(run: "Run", nominal: "Plant", known: "Compensation", reference: "Reference", console: "Console") -> None:
    """Print the plant, the trajectory and the errors of the run."""
    from mpc.trials.metrics import metrics
    from mpc.trials.pictures.report import limits_of_reference, table_of

    figures = metrics(run)
    say(console, f"plant: {nominal.summary}")
    if known.summary:
        say(console, f"known to the controller: {known.summary}")
    if untold := known.untold(nominal):
        say(console, f"simulated, but not known to the controller: {untold}")
    say(console, f"trajectory: {reference.summary()}")
    console.print(table_of(run, figures))
    if run.assumed:
        say(console, run.assumed)
    for sentence in limits_of_reference(figures, nominal.slew):
        say(console, sentence)


def _tested(
    kind: str, nominal: "Plant", known: "Compensation", torque: "tuple[tuple[float, float], ...]"
) -> "tuple[Process, Settings, str]":
    """Return the plant under test with an unknown torque, its controller's settings, and a list of model errors.

    Friction and regulators of the plant's file are simulated, and the controller knows them.
    """
    from mpc.model.compensation import Compensation
    from mpc.model.real import RealPlant
    from mpc.trials.loops import Settings
    from mpc.trials.other_plant import other_plant

    if kind not in _PLANTS:
        raise MissingBackend("plant", kind, _PLANTS)
    if kind == _NOMINAL:
        if known == Compensation():
            return (RealPlant(nominal, torque_profile=torque) if torque else nominal), Settings(nominal), ""
        return RealPlant.of(nominal, known, torque_profile=torque), Settings(nominal, compensation=known), ""
    if kind == _REAL:
        real, unknown = RealPlant.standard(torque_profile=torque, nominal=nominal), ""
    else:
        real, unknown = other_plant(nominal, torque)
    compensation = replace(real.known(), **known.told)
    return replace(real, **known.told), Settings(nominal, compensation=compensation), unknown


app.command("fit-motion", cls=Command, short_help="identify lags and hysteresis from a log of a moving joint")(
    fit_motion_command
)
app.add_typer(export_app, name="export", short_help="write C code, FMUs or firmware")
app.command("devices", cls=Command, short_help="list the devices that `run` and `sweep` drive")(devices_command)
app.command("run", cls=Command, short_help="drive a joint on a device along a trajectory")(run_command)
app.command("sweep", cls=Command, short_help="run the experiment that identifies a joint")(sweep_command)
app.command("measure", cls=Command, short_help="measure the stiffness of a joint on a device")(measure_command)
app.command("explore", cls=Command, short_help="explore a joint in the browser")(explore)
app.command("bench-check", cls=Command, short_help="check a board on a serial line")(bench_check_command)
app.command("tune", cls=Command, short_help="tune a controller for a fitted plant or an arm")(tune_command)
app.command("init", cls=Command, short_help="write a plant file to edit, for --machine")(init_command)


def main() -> None:
    """Run the command `antagonist` and leave Python with its exit code."""
    os.environ["MPLBACKEND"] = "agg"  # pictures are only written; notebooks may need another back-end
    with warnings.catch_warnings():
        warnings.showwarning = _one_line
        sys.exit(failures.run(app))


def _one_line(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning without the line of code that it came from."""
    print(f"antagonist: {message}", file=sys.stderr)
