"""Commands about hardware: `antagonist devices`, `run` and `sweep`; in degrees and bar."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, Self

import typer

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from allocator.lazy import Console
from allocator.presentation.progress import waiting
from allocator.shell.options import grouped, within
from allocator.shell.outputs import IMAGES, Force, check_ending, claim, say
from allocator.units import BAR, PERCENT
from mpc.arm.options import Described, HandOptions, asked_of_arm, described, owner_of_arm, refuse_options_of_one_joint
from mpc.bench.shell.options import BenchOptions, Opened
from mpc.plant_cli import LoopOptions, PlantOptions
from mpc.repetition.options import RepeatOptions, progress, report

if TYPE_CHECKING:
    from allocator.mechanism.endpoint import Endpoint
    from mpc.bench.cycle import Cycle
    from mpc.bench.device import Device
    from mpc.bench.logs import Record
    from mpc.bench.record import Lateness
    from mpc.bench.repeating import Repeated
    from mpc.bench.safety import Ending
    from mpc.bench.shell.dashboard import Dashboard
    from mpc.observer.base import Observer
    from mpc.repetition.learner import Learner
    from mpc.trials.motions.corrections import Correction, Owner
    from mpc.trials.motions.reference import Reference
    from mpc.trials.simulation import Controller

_EXITS = {"finished": 0, "interrupted": 130, "terminated": 143}
_OBSERVING = ("mpc", "predictive-pid", "lqr")  # controllers
_STOPPED = 4  # exit code of a loop that ended for safety
_ONCE, _ONCE_AN_ARM = "after an installation: some 20 seconds", "for each new arm: some 40 seconds"
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
    from mpc.bench.repeating import finished, once, read, repeat
    from mpc.trials.files import check_recordable

    console = Console()
    files, learned = _Files.of(out or []), repeated.written(trajectory)
    claim(*files.out, files.beside, *learned, inputs=(trajectory, repeated.learned, *options.files), force=force)
    arm = _arm(options, at, more, controller)
    opened = bench.opened(options, None if arm is None else arm.arm)
    settings, plant = bench.settings(options, settle, opened.plant.m), opened.plant
    check_recordable(files.out, plant)
    reference, owner = _asked(trajectory, options, at, more, repeated, opened, controller, arm)
    begun = repeated.begun(reference, owner, at.dt)
    say(console, *_introduction(opened, options, arm, reference, at.dt))
    with waiting(f"building the controller (compiled once {_ONCE if arm is None else _ONCE_AN_ARM})"):
        driver, observer, learner, sentences = _built(controller, opened, options, at, repeated, reference, begun)
    say(console, *sentences)

    def drive(path: "Reference") -> "Record":
        dashboard = bench.dashboard(plant)
        driven = RealTimeLoop(
            opened.device, driver, observer, path, plant=plant, **settings._asdict(), log=files.log,
            replace=force or learner is not None, clock=opened.clock, watch=dashboard,
        )  # fmt: skip
        if dashboard is not None:
            dashboard.health = lambda: "" if driven.tracking.health.well else str(driven.tracking.health)
        _run(driven.cycle, dashboard, console)
        return driven.record

    age = opened.known.reading_age
    done = repeat(drive, learner, age=age, progress=progress(console)) if learner else once(drive, reference, begun)
    with _exiting(done.last.ending):
        _report(done.best if finished(done.last) else done.last, console)
        if learner is not None and done.first is not None:
            first, best = (read(one, learner.course, age) for one in (done.first, done.best))
            report(learner, owner, first, best, learned, console)
        say(console, files.write(done, None if arm is None else arm.hand))


class _Files(NamedTuple):
    """Files of --out; without a .csv among them also a log beside the first, since samples are written one by one."""

    out: list[Path]
    beside: Path | None = None

    @classmethod
    def of(cls, out: list[Path]) -> Self:
        """Return the files of a run. Raises `InvalidInput` for an unknown ending."""
        for path in out:
            check_ending("--out", path, _SUFFIXES)
        return cls(out, out[0].with_suffix(".partial.csv") if out and not any(map(_is_log, out)) else None)

    @property
    def log(self) -> Path | None:
        """The file that is written sample by sample."""
        return self.beside or next(filter(_is_log, self.out), None)

    def write(self, done: "Repeated", hand: "Endpoint | None") -> str:
        """Write the other files, remove a log that --out does not name, and return a sentence about the files."""
        from mpc.bench.cycle import Phase
        from mpc.trials.files import is_recording
        from mpc.trials.pictures.report import write_run

        record = done.best
        if not record.controlled:
            return ""
        settling = record.dt * len(record.where("t", phases=(Phase.SETTLE,))[0])
        for path in self.out:
            if is_recording(path):
                record.save(path)
            elif not _is_log(path):
                write_run(record.run(), path, None, f"as measured, with {settling:.3g} s of settling", hand)
        if self.beside is not None:
            self.beside.unlink()
        return f"written: {', '.join(map(str, self.out))}" if self.out and done.last.controlled else ""


def _is_log(path: Path) -> bool:
    return path.suffix.lower() == ".csv"


def _arm(options: PlantOptions, at: LoopOptions, more: HandOptions, controller: str) -> Described | None:
    """Return the arm of the options, None for one joint. Raises `InvalidInput` for options of the other kind."""
    if not options.of_several:
        if more != HandOptions():
            raise InvalidInput("--stiffness-of and --hand go with a --machine of several joints")
        return None
    refuse_options_of_one_joint(stiffness=at.stiffness, controller=None if controller == "mpc" else controller)
    return described(options, more)


def _asked(
    trajectory: str | None, options: PlantOptions, at: LoopOptions, more: HandOptions, repeated: RepeatOptions,
    opened: Opened, controller: str, arm: Described | None,
) -> "tuple[Reference, Owner]":  # fmt: skip
    """Return the desired motion, and the owner of its correction."""
    from mpc.trials.files import reference_called
    from mpc.trials.motions.corrections import Owner

    plant, load = opened.plant, repeated.load or ""
    if arm is not None:
        reference = repeated.reference(trajectory, lambda: asked_of_arm(trajectory, plant, arm.hand))
        return reference, owner_of_arm(options, more, plant, load)
    reference = repeated.reference(trajectory, lambda: reference_called(trajectory, at.stiffness, plant))
    return reference, Owner.of(plant, opened.known, controller, load)


def _introduction(
    opened: Opened, options: PlantOptions, arm: Described | None, reference: "Reference", dt: float
) -> Iterator[str]:
    """Yield sentences on the machine, its assumed effects, and a reference every `dt` [s]."""
    from mpc.trials.metrics import out_of_reach
    from mpc.trials.pictures.report import reach_in_words

    plant, known = opened.plant, opened.known
    yield f"plant: {plant.summary}" + f"; {known.summary}" * bool(known.summary)
    yield opened.note
    if arm is not None:
        yield from arm.notes
    elif assumed := opened.assumed(options):
        yield f"not in --machine, simulated as on a usual bench and told to the controller: {assumed}"
    yield f"trajectory: {reference.summary(plant.stiffness_unit)}"
    even = reference.resampled(dt)
    if beyond := out_of_reach(plant, even.theta, even.K, dt):
        yield reach_in_words(beyond)


def _built(
    controller: str, opened: Opened, options: PlantOptions, at: LoopOptions, repeated: RepeatOptions,
    reference: "Reference", begun: "Correction | None",
) -> "tuple[Controller, Observer, Learner | None, list[str]]":  # fmt: skip
    """Return controller and observer, the learner of --repeat, and sentences on tuning and margins."""
    from mpc.model.plant import Plant
    from mpc.repetition.response import responses
    from mpc.trials.loops import Settings, loop, margins_in_words, robust

    plant, one = opened.plant, isinstance(opened.plant, Plant)
    told = Settings(plant, at.dt, at.horizon, opened.known)
    told, tuned = options.tuned(told if one else told.calm, controller)
    told = robust(controller, told, reference) if one and not tuned else told
    driver, observer = loop(controller, told, True if controller in _OBSERVING else None)
    sentences, learner = [tuned, *margins_in_words(controller, told, reference, driver)], None
    if repeated.repeat is not None:
        answers = partial(responses, controller, told, reference, options.spreads())
        learner = repeated.learner(reference, answers, at.dt, begun, plant.angle_limits, controller)
    return driver, observer, learner, sentences


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
    except BaseException as error:  # a driver may even leave the program
        ending = cycle.ending
        if ending is None or ending.action is None:  # nothing was commanded
            raise
        if ending.reason is not Reason.DEVICE or isinstance(error, AntagonistError):
            say_ending(ending, cycle.lateness, console)
            raise
        return ending


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


def _report(record: "Record", console: "Console") -> None:
    """Print the ending, suspected faults, the errors, and whether the strengths need a check."""
    from mpc.bench.measuring.due import check_due
    from mpc.bench.safety import Reason
    from mpc.model.plant import Plant
    from mpc.trials.pictures.report import table_of_errors

    say_ending(record.ending, record.lateness, console)
    if not record.health.well and record.ending.reason is not Reason.UNHEALTHY:  # whose message it is
        say(console, f"health at the end: {record.health}")
    if not (record.tracked and record.controlled):
        return
    console.print(table_of_errors(record.run(), record.errors, "tracking, as measured, without settling"))
    sound = record.health.well and isinstance(record.plant, Plant)  # a faulty joint has no rest that tells of strengths
    say(console, check_due(record.run()) if sound else "")


def say_ending(ending: "Ending", lateness: "Lateness", console: "Console") -> None:
    """Print the ending of a loop, the final pressures, and the lateness of its samples."""
    taken = "" if ending.delivered else ", which the device did not take"
    say(console, f"ended: {ending}", ending.treatment and f"pressures: {ending.treatment}{taken}", str(lateness))


def exit_code(ending: "Ending") -> int:
    """Return the exit code of an ending."""
    return _EXITS.get(str(ending.reason), _STOPPED)
