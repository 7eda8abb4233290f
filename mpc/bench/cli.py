"""Commands about hardware: `antagonist devices`, `run` and `sweep`; in degrees and bar."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from allocator.lazy import Console
from allocator.presentation.progress import waiting
from allocator.shell.options import finite, grouped, within
from allocator.shell.outputs import IMAGES, Force, check_ending, claim, say
from allocator.units import BAR, PERCENT
from mpc.arm.options import HandOptions, asked_of_arm, described, refuse_options_of_one_joint
from mpc.bench.options import BenchOptions
from mpc.plant_cli import LoopOptions, PlantOptions
from mpc.repetition.options import RepeatOptions, progress, report

if TYPE_CHECKING:
    from allocator.mechanism.endpoint import Endpoint
    from mpc.bench.cycle import Cycle
    from mpc.bench.dashboard import Dashboard
    from mpc.bench.device import Device
    from mpc.bench.logs import Record
    from mpc.bench.record import Lateness
    from mpc.bench.safety import Ending
    from mpc.trials.motions.reference import Reference

_EXITS = {"finished": 0, "interrupted": 130, "terminated": 143}
_OBSERVING = ("mpc", "predictive-pid", "lqr")  # controllers
_STOPPED = 4  # exit code of a loop that ended for safety
_SUFFIXES = (*IMAGES, ".csv", ".npz", ".mcap")


def devices_command() -> None:
    """List the devices that --device takes, including those of installed packages."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from mpc.bench.devices.registry import kinds

    table = Table("name", "description", "from")
    for name, kind in sorted(kinds().items()):
        table.add_row(name, Text(kind.summary), kind.brought_by)
    table.add_row("MODULE:FUNCTION", "your own: a function without arguments that returns a device", "")
    Console().print(table)


@grouped
def run_command(
    options: PlantOptions,
    at: LoopOptions,
    more: HandOptions,
    bench: BenchOptions,
    repeated: RepeatOptions,
    trajectory: Annotated[
        str | None, typer.Argument(help="a standard trajectory or a CSV, as of `antagonist track`, for an arm as well")
    ] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            help="a .csv, .npz, .mcap or .png to write; may be repeated. The .csv is written sample by sample"
        ),
    ] = None,
    controller: Annotated[str, typer.Option(help="mpc, pid, pi, predictive-pid, lqr or feedforward")] = "mpc",
    settle: Annotated[float, typer.Option(help="time under control at the first point of the trajectory [s]")] = 1.0,
    force: Force = False,
) -> None:
    """Drive a joint or an arm on a device along a trajectory of angle and stiffness.

    The run begins with a soft start from the present pressures. It ends with the safe stop of --stop after the
    trajectory, Ctrl-C (twice: vent at once), SIGTERM, a closed terminal, or a failure of the device or the log. The
    exit code is 0 after the trajectory, 130 after Ctrl-C, 143 after SIGTERM or a closed terminal, and 4 if the loop
    ended itself. If --out names no .csv, the samples are written to one during the run, and removed after success.
    """
    from rich.console import Console

    from mpc.bench.loop import RealTimeLoop
    from mpc.bench.repeating import compared, finished, read, repeat
    from mpc.repetition.learner import Course
    from mpc.repetition.response import responses
    from mpc.trials.files import check_recordable, reference_called
    from mpc.trials.loops import Settings as LoopSettings
    from mpc.trials.loops import loop, margins_in_words, robust
    from mpc.trials.metrics import out_of_reach
    from mpc.trials.motions.corrections import Owner
    from mpc.trials.pictures.report import reach_in_words

    console = Console()
    finite("--settle", settle, "s")
    files = out or []
    for path in files:
        check_ending("--out", path, _SUFFIXES)
    journal = _journal(files)
    learned = repeated.written(trajectory)
    inputs = (trajectory, repeated.learned, *options.files)
    claim(*files, None if journal in files else journal, *learned, inputs=inputs, force=force)
    if several := options.of_several:
        _refuse_for_several(at, controller, repeated)
    elif more != HandOptions():
        raise InvalidInput("--stiffness-of and --hand go with a --machine of several joints")
    given = described(options, more) if several else None
    hand = None if given is None else given.hand
    opened = bench.opened(options, None if given is None else given.arm)
    settings = bench.settings(options, settle, opened.plant.m)
    plant, known = opened.plant, opened.known
    check_recordable(files, plant)
    if several:
        reference, begun = asked_of_arm(trajectory, plant, hand), None
    else:
        reference = repeated.reference(trajectory, lambda: reference_called(trajectory, at.stiffness, plant))
        owner = Owner.of(plant, known, controller, repeated.load or "")
        begun = repeated.begun(reference, owner, at.dt)
    say(console, f"plant: {plant.summary}" + f"; {known.summary}" * bool(known.summary))
    for note in [] if given is None else given.notes:
        say(console, note)
    if not several and (assumed := opened.assumed(options)):
        say(console, f"not in --machine, simulated as on a usual bench and told to the controller: {assumed}")
    say(console, f"trajectory: {reference.summary(plant.stiffness_unit)}")
    even = reference.resampled(at.dt)
    if beyond := out_of_reach(plant, even.theta, even.K, at.dt):
        say(console, reach_in_words(beyond))
    once = "for each new arm: some 40 seconds" if several else "after an installation: some 20 seconds"
    with waiting(f"building the controller (compiled once {once})"):
        told = LoopSettings(plant, at.dt, at.horizon, known)
        told, tuned = options.tuned(told.calm if several else told, controller)
        told = told if tuned or several else robust(controller, told, reference)
        driver, observer = loop(controller, told, True if controller in _OBSERVING else None)
        sentences = margins_in_words(controller, told, reference, driver)
        answers = partial(responses, controller, told, reference, options.spreads())
        limits = plant.angle_limits
        learner = repeated.learner(reference, answers, at.dt, begun, limits, controller) if learned else None

    def drive(asked: "Reference") -> "Record":
        dashboard = bench.dashboard(plant)
        driven = RealTimeLoop(
            opened.device, driver, observer, asked, plant=plant, start=settings.start, stop=settings.stop,
            watchdog=settings.watchdog, overrun=settings.overrun, zero=settings.zero, log=journal,
            replace=force or learner is not None, clock=opened.clock, watch=dashboard,
        )  # fmt: skip
        if dashboard is not None:
            dashboard.health = lambda: "" if driven.tracking.health.well else str(driven.tracking.health)
        _run(driven.cycle, dashboard, console)
        return driven.record

    for sentence in (*filter(None, [tuned]), *sentences):
        say(console, sentence)
    if learner is None:
        record = drive(reference if begun is None else begun.reference)
        best = record if begun is None else compared(record, Course.of(reference, at.dt))
    else:
        done = repeat(drive, learner, age=known.reading_age, progress=progress(console))
        record, best = done.last, done.best or done.last
    with _exiting(record.ending):
        _report(best if finished(record) else record, console)
        if learner is not None and done.first is not None and done.best is not None:
            first, after = (read(one, learner.course, known.reading_age) for one in (done.first, done.best))
            report(learner, owner, first, after, learned, console)
        if best.controlled:
            _write(best, files, journal, hand)
        if record.controlled and files:
            say(console, f"written: {', '.join(map(str, files))}")


@grouped
def sweep_command(
    options: PlantOptions,
    bench: BenchOptions,
    out: Annotated[Path, typer.Option(help="directory for joint_log.csv, motion_log.csv and sweep.csv")],
    accuracy: Annotated[float, typer.Option(help="wanted standard deviation of K [%]")] = 5.0,
    weight: Annotated[
        list[float] | None, typer.Option(help="torque of an available weight [N·m]; may be repeated")
    ] = None,
    weights: Annotated[
        bool, typer.Option(help="request weights; without them fit-joint cannot determine forces")
    ] = True,
    motion: Annotated[
        float, typer.Option(help="duration of random steps for fit-motion [s]; 0 leaves them out")
    ] = 90.0,
    rate: Annotated[float, typer.Option(help="rate of the pressures between setpoints [bar/s]")] = 1.0,
    dt: Annotated[float, typer.Option(help="sample time [s]")] = 0.02,
    seed: Annotated[int, typer.Option(help="seed of the random steps")] = 0,
    force: Force = False,
) -> None:
    """Run the experiment that identifies a joint: random steps, then equilibria with and without a weight.

    Describe the joint with the options below, from a data sheet or a first fit. Random steps come first, then the
    setpoints of `antagonist plan-joint`, each approached from both sides. The pressures are held while a weight is
    hung, until Enter is pressed. `fit-joint` reads joint_log.csv and `fit-motion` motion_log.csv; sweep.csv has all
    samples. The experiment begins and ends as `antagonist run` does.
    """
    from rich.console import Console

    from allocator.identification.joint.planning.plan import plan_joint_experiment
    from mpc.bench.cycle import Cycle
    from mpc.bench.sweep import Pace, Sweep, random_steps, visits_of
    from mpc.bench.sweep import within as inside

    console = Console()
    within("--accuracy", accuracy, "%", 0.01, 99)
    within("--motion", motion, "s", 0, 86_400)
    within("--rate", rate, "bar/s", 1e-3, 100)
    within("--dt", dt, "s", 1e-4, 0.1)
    checks.count("--seed", seed, least=0)
    files = [out / name for name in ("joint_log.csv", "motion_log.csv", "sweep.csv")]
    claim(*files, inputs=options.files, force=force)
    settings = bench.settings(options)
    opened = bench.opened(options)
    joint, pace = opened.plant.joint, Pace(rate=rate * BAR, motion=motion)
    plan = plan_joint_experiment(inside(joint), accuracy=accuracy * PERCENT, weights=weight)
    steps = random_steps(joint, round(motion / pace.every), seed)
    source = Sweep(
        visits_of(plan, joint, weights), steps, dt, hanger(opened.device, console), out, pace, settings.about
    )
    say(
        console,
        f"{len(source.visits)} visits of setpoints, {motion:g} s of random steps: {source.duration / 60:.1f} min",
    )
    dashboard = bench.dashboard(opened.plant)
    cycle = Cycle(
        opened.device, source, opened.plant, settings, log=files[-1], replace=force, clock=opened.clock, watch=dashboard
    )
    ending = _run(cycle, dashboard, console)
    with _exiting(ending):
        say_ending(ending, cycle.lateness, console)
        if source.restless:
            over = f"the angle did not come to rest within {pace.longest:g} s"
            say(console, f"{source.restless} visits were left out: {over}")
        written = [*source.written, *[files[-1]] * (cycle.recorder.columns["t"].size > 0)]
        say(console, f"written: {', '.join(map(str, written)) or 'nothing'}")


def hanger(device: "Device", console: "Console") -> "Callable[[float], bool]":
    """Return the function that requests a weight; a simulated joint hangs it without a person."""
    from mpc.bench.devices.simulated import SimulatedDevice
    from mpc.bench.sweep import REQUEST, Asking

    if isinstance(device, SimulatedDevice):
        return device.hang
    return Asking(lambda torque: say(console, f"\n{REQUEST.format(abs(torque), 'down' if torque > 0 else 'up')}"))


def _run(cycle: "Cycle", dashboard: "Dashboard | None", console: "Console") -> "Ending":
    """Run the cycle and return its ending; an exception of the device is an ending."""
    from mpc.bench.safety import Reason

    try:
        with dashboard or nullcontext():
            return cycle.run()
    except Exception as error:
        ending = cycle.ending
        if ending is None or ending.action is None:  # nothing was commanded
            raise
        if ending.reason is not Reason.DEVICE or isinstance(error, AntagonistError):
            say_ending(ending, cycle.lateness, console)
            raise
        return ending


def _refuse_for_several(at: LoopOptions, controller: str, repeated: RepeatOptions) -> None:
    """Refuse the options of a run that only one joint has. Raises `InvalidInput`."""
    refuse_options_of_one_joint(stiffness=at.stiffness, controller=None if controller == "mpc" else controller)
    if repeated.asked:
        raise InvalidInput(
            "--repeat and --from take one joint on a device; `antagonist track` repeats a motion of an arm"
        )


@contextmanager
def _exiting(ending: "Ending") -> Iterator[None]:
    """Exit with the code of an ending after a report, also where standard output is gone with its terminal."""
    code = exit_code(ending)
    try:
        yield
    except OSError as error:
        if not code or isinstance(error, AntagonistError) or error.filename is not None:
            raise
    raise typer.Exit(code)


def _journal(files: list[Path]) -> Path | None:
    """Return the file that is written sample by sample: a requested .csv, or one next to the first other file."""
    if not files:
        return None
    return next(filter(_is_log, files), files[0].with_suffix(".partial.csv"))


def _is_log(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _write(record: "Record", files: list[Path], journal: Path | None, hand: "Endpoint | None") -> None:
    """Write the other files, and remove a journal that --out does not name."""
    from mpc.bench.cycle import Phase
    from mpc.trials.files import is_recording
    from mpc.trials.pictures.report import write_run

    settling = record.dt * len(record.where("t", phases=(Phase.SETTLE,))[0])
    for path in files:
        if is_recording(path):
            record.save(path)
        elif not _is_log(path):
            write_run(record.run(), path, None, f"as measured, with {settling:.3g} s of settling", hand)
    if journal is not None and journal not in files:
        journal.unlink()


def _report(record: "Record", console: "Console") -> None:
    """Print the ending, the errors, and whether the strengths need a check."""
    from mpc.bench.measuring.due import check_due
    from mpc.model.plant import Plant
    from mpc.trials.pictures.report import table_of_errors

    say_ending(record.ending, record.lateness, console)
    if not (record.tracked and record.controlled):
        return
    console.print(table_of_errors(record.run(), record.errors, "tracking, as measured, without settling"))
    if isinstance(record.plant, Plant) and (due := check_due(record.run())):
        say(console, due)


def say_ending(ending: "Ending", lateness: "Lateness", console: "Console") -> None:
    """Print the ending of a loop, the final pressures, and the lateness of its samples."""
    say(console, f"ended: {ending}")
    if ending.treatment:
        say(console, f"pressures: {ending.treatment}" + ("" if ending.delivered else ", which the device did not take"))
    say(console, str(lateness))


def exit_code(ending: "Ending") -> int:
    """Return the exit code of an ending."""
    return _EXITS.get(str(ending.reason), _STOPPED)
