"""Command `antagonist track` for several joints, on MuJoCo."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple

import typer

from allocator.errors import InvalidInput, MissingBackend
from allocator.presentation.progress import waiting
from allocator.shell.options import within
from allocator.shell.outputs import say
from allocator.units import BAR, DEG
from mpc.repetition.options import RepeatOptions, progress, report

if TYPE_CHECKING:
    from allocator.mechanism.endpoint import Endpoint
    from mpc.arm.mujoco_plant import MujocoPlant
    from mpc.model.arm.model import Arm
    from mpc.model.arm.reading import Read
    from mpc.model.compensation import Compensation
    from mpc.plant_cli import PlantOptions
    from mpc.repetition.response import Response
    from mpc.trials.loops import Settings
    from mpc.trials.motions.reference import Reference

_NOMINAL, _REAL = "nominal", "real"
_SENSORS = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}  # of a real plant
_JOINTS, _HAND = _TRACKED = "joints", "hand"
_MPC, _CIRCLE = "mpc", "circle"
_OFF = 0.05  # [-] error of the muscles' forces, on a real plant


@dataclass(frozen=True)
class HandOptions:
    """Options of the stiffness that several joints track."""

    PANEL: ClassVar[str] = "Several joints"

    stiffness_of: Annotated[str, typer.Option(help="stiffness to track: that of the joints, or of the hand")] = _JOINTS
    hand: Annotated[
        str | None,
        typer.Option(help="hand of a MuJoCo model: a site or a body; with some of its coordinates, such as tip:xy"),
    ] = None

    def __post_init__(self) -> None:
        if self.stiffness_of not in _TRACKED:
            raise MissingBackend("stiffness to follow", self.stiffness_of, _TRACKED)


@dataclass(frozen=True)
class ArmOptions(HandOptions):
    """Options of several joints on MuJoCo."""

    catch: Annotated[float, typer.Option(help="unmodelled mass at rest that the hand catches half-way [kg]")] = 0.0
    view: Annotated[bool, typer.Option("--view", help="show the arm in MuJoCo's window, in real time")] = False

    def __post_init__(self) -> None:
        super().__post_init__()
        within("--catch", self.catch, "kg", 0.0, 100.0)


class Described(NamedTuple):
    """Arm of the options, with the place of its hand and remarks about it."""

    arm: "Arm"
    hand: "Endpoint | None"
    notes: list[str]
    read: "Read | None"  # the MuJoCo model


def described(options: "PlantOptions", more: HandOptions) -> Described:
    """Return the arm of the options, which tracks the stiffness that they name. Raises `InvalidInput`."""
    arm, hand, notes, read = _from_mujoco(options, more) if options.is_mujoco else _with_bodies(options, more)
    if more.stiffness_of == _HAND:
        if hand is None:
            raise InvalidInput(f"--stiffness-of hand: {options.machine} has no hand; name a site or body with --hand")
        arm = replace(arm, endpoint=hand)
    return Described(arm, hand, notes, read)


def refuse_options_of_one_joint(**given: object) -> None:
    """Refuse options that only one joint has. Raises `InvalidInput` for any that is not None."""
    if option := next((name for name, value in given.items() if value is not None), None):
        raise InvalidInput(
            f"--{option} is for one joint; several joints track their usual stiffness with mpc and its observer"
        )


def track_arm(
    options: "PlantOptions",
    more: ArmOptions,
    trajectory: str | None,
    files: list[Path],
    *,
    plant: str,
    payload: float,
    dt: float,
    horizon: int,
    seed: int,
    repeated: RepeatOptions,
    learned: tuple[Path, Path] | tuple[()],
    margins: Path | None,
    wait: bool,
) -> None:
    """Track angles and a stiffness matrix with an arm of pneumatic muscles on MuJoCo, film it, report the errors."""
    import numpy as np
    from rich.console import Console

    from mpc.arm.experiments import arriving
    from mpc.arm.film import SIZES, Film
    from mpc.model.arm.bodies import Bodies
    from mpc.repetition.practice import practise
    from mpc.trials.files import check_recordable
    from mpc.trials.loops import margins_in_words, sliding_margins
    from mpc.trials.metrics import metrics
    from mpc.trials.motions.corrections import Owner, compared, digest_of
    from mpc.trials.pictures.animation import ENDINGS, check_film
    from mpc.trials.pictures.report import limits_of_reference, plot_margins, table_of, write_run
    from mpc.trials.simulation import in_motion, simulate

    console = Console()
    within("--dt", dt, "s", 1e-4, 0.5)
    for path in files:
        if path.suffix.lower() in ENDINGS:
            check_film(path)
    arm, tested, point, notes = _machine(options, more, plant, seed)
    check_recordable(files, arm)
    asked = repeated.reference(trajectory, lambda: asked_of_arm(trajectory, arm, point))
    half_way = asked.duration / 2
    if more.catch and (learned or not isinstance(arm.bodies, Bodies)):
        raise InvalidInput("--catch is for one run of a --machine in the plane, such as arm26, without --repeat")
    with waiting("building the controller"):
        controller, observer, settings, tuned = _loop(options, arm, plant, dt, horizon, wait)

    load = repeated.load or (f"payload {payload:g} N·m" if payload else "")
    owner = Owner(arm.summary, digest_of(_text_of(options), more.stiffness_of, more.hand), _MPC, load)
    begun = repeated.begun(asked, owner, dt)

    def push(t: float) -> list[float]:
        return [payload * (t >= half_way)] + [0.0] * (arm.n - 1)

    endings = {path.suffix.lower() for path in files} & SIZES.keys()
    size = max((SIZES[ending] for ending in endings), default=SIZES[".gif"])
    film = Film(tested, arm, size, point) if endings else None
    with _Window(tested, more.view) as window:
        tip = (arm.bodies.length[-1], 0.0, 0.0) if more.catch else None
        catch = None if tip is None else arriving(tested, half_way, more.catch, tip, np.zeros(3))

        def watch() -> None:
            if catch is not None:
                catch()
            if film is not None:
                film.watch()
            window.watch()

        x0 = in_motion(arm, asked)
        given, practice = begun.reference if begun is not None else asked, None
        if learned:
            learner = repeated.learner(
                asked, lambda: _responses(options, more, plant, controller, observer, asked), dt, begun,
                arm.angle_limits, _MPC,
            )  # fmt: skip
            practice = practise(
                tested, controller, learner, observer=observer, x0=x0, load=push, seed=seed, progress=progress(console)
            )
            given = learner.reference  # the best one is played again for display
        done = simulate(
            tested, controller, given, x0=x0, observer=observer, load=push, seed=seed, watch=watch, progress=True
        )
        done = compared(done, asked)
    say(console, f"arm: {arm.summary}")
    for note in [*notes, *_dry_friction(tested.model.dof_frictionloss, settings.compensation)]:
        say(console, note)
    say(console, f"trajectory: {asked.name}, {asked.duration:g} s")
    console.print(table_of(done, figures := metrics(done)))
    for sentence in limits_of_reference(figures, arm.slew):
        say(console, sentence)
    if tuned:
        say(console, tuned)
    if learned and practice is not None:
        report(practice.learner, owner, practice.first.theta, practice.best.theta, learned, console)
    elif begun is not None:
        say(console, f"played: {begun.summary}")
    if plant == _REAL:
        for sentence in margins_in_words(_MPC, settings, asked, controller):
            say(console, sentence)
    for path in files:  # last, since a film takes the longest
        write_run(done, path, None if film is None else film.save, hand=point)
    if film is not None:
        say(console, f"filmed by {film.by}")
    if margins is not None:
        plot_margins(sliding_margins(_MPC, settings), margins, f"mpc, {arm.summary}")
        files = [*files, margins]
    say(console, f"written: {', '.join(map(str, files))}")


def asked_of_arm(trajectory: str | None, arm: "Arm", hand: "Endpoint | None") -> "Reference":
    """Return the reference of a name, or that of a user's file; by default the circle."""
    from mpc.trials.files import is_recording, recorded
    from mpc.trials.motions.arm_trajectories import REFERENCES, reference
    from mpc.trials.motions.motion_files import load_motion

    trajectory = trajectory or _CIRCLE
    if is_recording(trajectory):
        return recorded(trajectory, arm)
    if trajectory not in REFERENCES and (Path(trajectory).suffix or Path(trajectory).exists()):
        return load_motion(trajectory, arm, hand)
    return reference(trajectory, arm)


def _machine(
    options: "PlantOptions", more: ArmOptions, kind: str, seed: int
) -> "tuple[Arm, MujocoPlant, Endpoint | None, list[str]]":
    """Return the arm of the options, its plant, its hand, and remarks about it."""
    import numpy as np

    from mpc.arm.mujoco_plant import MujocoPlant

    if kind not in (_NOMINAL, _REAL):
        raise MissingBackend("plant", kind, [_NOMINAL, _REAL])
    arm, hand, notes, read = described(options, more)
    effects: dict[str, Any] = {"gas": arm.gas}
    if kind == _REAL:
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], arm.m)
        known = _known(options)
        effects |= {"dead_time": known.dead_time, "dead_band": known.dead_band}
        effects |= {} if options.is_mujoco else {"friction": known.of_joints(arm.n)}  # a MuJoCo model has its own
        effects |= {"force_gains": 1 + _OFF * signs, **_SENSORS}
    return arm, MujocoPlant.of(arm, None if read is None else read.model, **effects), hand, notes


def _with_bodies(options: "PlantOptions", more: HandOptions) -> Described:
    if more.hand is not None:
        raise InvalidInput(f"--hand is of a MuJoCo model: --machine FILE.xml; {options.machine} has its own")
    arm = options.arm()
    return Described(arm, arm.bodies.endpoint, [], None)


def _from_mujoco(options: "PlantOptions", more: HandOptions) -> Described:
    """Read the arm of a MuJoCo model. Raises the errors of `PlantOptions.mujoco`."""
    read = options.mujoco(more.hand)
    notes = [f"muscles: {', '.join(options.mujoco_muscles)}"]
    if read.hand is not None:
        coordinates = getattr(read.hand.kinematics, "axes", "")
        notes.append(f"hand: {read.hand_name} ({', '.join(coordinates)})")
    if read.asked_of_mujoco:
        notes.append(f"without formulas, so that a step is slow: {read.asked_of_mujoco}")
    if read.left_out:
        notes.append(f"not in the controller's model: {read.left_out}")
    return Described(options.mujoco_arm(read), read.hand, notes, read)


def _dry_friction(simulated: Sequence[float], known: "Compensation") -> list[str]:
    """Return a remark if the loop does not know all of the `simulated` dry friction [N·m] of the joints."""
    from mpc.model.friction.dahl import Friction

    joints = known.of_joints(len(simulated))
    whole, told = sum(simulated), sum(one.coulomb for one in joints if isinstance(one, Friction))
    if told >= whole:
        return []
    knows = f"{told / whole:.0%} of it" if told else "nothing of it"
    most = f"up to {max(simulated):.3g} N·m per joint"
    return [f"the simulated joints have dry friction, {most}; controller and observer know {knows}"]


def _known(options: "PlantOptions") -> "Compensation":
    """Return the known friction and regulators of the machine. The plant's sensors read without a delay."""
    return replace(options.compensation_of_arm(), reading_age=0.0)


def _loop(
    options: "PlantOptions", arm: "Arm", kind: str, dt: float, horizon: int, wait: bool
) -> "tuple[Any, Any, Settings, str]":
    """Return a controller and its observer, which `wait` for compilation, their settings, and a sentence on the file's
    tuning or "".
    """
    from mpc.trials.loops import Settings, loop

    settings = Settings(arm, dt, horizon, wait=wait)
    if kind == _REAL:
        settings = settings._replace(compensation=_known(options)).calm
    settings, tuned = options.tuned(settings, _MPC)
    return *loop(_MPC, settings), settings, tuned


def _responses(
    options: "PlantOptions", more: ArmOptions, kind: str, controller: Any, observer: Any, asked: "Reference"
) -> "tuple[Response, ...]":
    """Return the responses of the loop on its model in the middle of a reference, and their possible variations."""
    from mpc.repetition.response import doubted, postures, response

    _, model, _, _ = _machine(options, more, _NOMINAL, 0)
    model.supply.dead_time = controller.compensation.dead_time
    return doubted([response(model, controller, observer, *postures(asked)[1])])


def _text_of(options: "PlantOptions") -> str:
    """Return the text of the machine's file and its muscles, or their names."""
    named = [str(options.machine), *(options.muscle or [])]
    return "\0".join(Path(name).read_text(encoding="utf-8") if Path(name).is_file() else name for name in named)


class _Window:
    """Window of MuJoCo's viewer with the plant in real time, if requested."""

    def __init__(self, plant: "MujocoPlant", wanted: bool) -> None:
        self._plant, self._viewer, self._began = plant, None, perf_counter()
        if wanted:
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(plant.model, plant.data)

    def watch(self) -> None:
        """Show the present plant at the right time."""
        if self._viewer is None:
            return
        sleep(max(0.0, self._plant.time - (perf_counter() - self._began)))
        self._viewer.sync()

    def __enter__(self) -> "_Window":
        return self

    def __exit__(self, *raised: object) -> None:
        if self._viewer is not None:
            self._viewer.close()
