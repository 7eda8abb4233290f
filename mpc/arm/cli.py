"""The command `antagonist arm` is here: an arm in closed loop on MuJoCo; degrees and bar at the edge, SI behind."""

from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.shell.options import finite, within
from allocator.shell.outputs import IMAGES, Force, claim
from allocator.shell.printing import say
from allocator.units import BAR, DEG, MM

if TYPE_CHECKING:
    from rich.table import Table

    from allocator.mechanism.endpoint import Endpoint
    from mpc.arm.mujoco_plant import MujocoPlant
    from mpc.model.arm.model import Arm
    from mpc.trials.metrics import Metrics
    from mpc.trials.simulation import Run

_OWN_NAMES = ("arm.gif", "arm.png", "arm.csv")
_FILMS = (".gif", ".mp4")
_SUFFIXES = (*IMAGES, *_FILMS, ".csv")
_NOMINAL, _REAL = "nominal", "real"
_REAL_EFFECTS = {"dead_time": 0.02, "encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}
_JOINTS, _HAND = _TRACKED = "joints", "hand"
_MUSCLE, _CONTRACTION = "sarosi-dmsp-20-400n", 0.1375  # where nothing else is said of a model's muscles
_OF_TENDONS = ("rest-length", "mm"), ("contraction", "-")
_OFF = 0.05  # of the muscles' forces, on a real plant


def arm_command(
    machine: Annotated[
        str, typer.Option(help="arm26, arm48, leg37, or a MuJoCo model (.xml) on hinges whose tendons are the muscles")
    ] = "arm26",
    muscle: Annotated[
        list[str] | None,
        typer.Option(
            help="of a .xml: a name that `antagonist muscles` lists, or a TOML file; several times: one a tendon"
        ),
    ] = None,
    rest_length: Annotated[
        str | None, typer.Option(help="of a .xml: of all muscles, or one each with commas between them [mm]")
    ] = None,
    contraction: Annotated[
        str | None,
        typer.Option(help="of a .xml: contraction ratio in the model's own posture, one or one each; 0.1375"),
    ] = None,
    hand: Annotated[
        str | None, typer.Option(help="of a .xml: a site or body, or some of its coordinates, such as tip:xy")
    ] = None,
    track: Annotated[str, typer.Option(help="whose stiffness follows: joints, or hand")] = "joints",
    reference: Annotated[str, typer.Option(help="circle, reach, hold, or draw (arm26)")] = "circle",
    out: Annotated[
        list[Path] | None,
        typer.Option(
            help="a .gif, .mp4 (needs ffmpeg), .png or .csv to write, or a directory for arm.gif, arm.png and arm.csv; "
            "may be repeated"
        ),
    ] = None,
    plant: Annotated[
        str, typer.Option(help="nominal, or real: muscles 5 % off, sensors that step and rush, 20 ms of dead time")
    ] = _NOMINAL,
    load: Annotated[
        float, typer.Option(help="torque on the first joint that nobody tells of, from half-way on [N·m]")
    ] = 0.0,
    dt: Annotated[float, typer.Option(help="sample time of the controller [s]")] = 0.01,
    horizon: Annotated[int, typer.Option(help="samples that the controller looks ahead")] = 20,
    seed: Annotated[int, typer.Option(help="of the sensors' noise and of what is off")] = 0,
    view: Annotated[bool, typer.Option("--view", help="watch it in MuJoCo's window, in real time")] = False,
    force: Force = False,
) -> None:
    """Let an arm of pneumatic muscles follow angles and a stiffness matrix on MuJoCo, and film it."""
    from rich.console import Console

    from mpc.arm.film import Film
    from mpc.trials.arm_trajectories import reference as asked_for
    from mpc.trials.film_files import check_film
    from mpc.trials.metrics import metrics
    from mpc.trials.simulation import in_motion, simulate

    console = Console()
    finite("--load", load, "N·m")
    within("--dt", dt, "s", 1e-4, 0.5)
    checks.count("--seed", seed, least=0)
    files = _files(out or [Path()])
    claim(*files, inputs=(machine, *(muscle or ())), force=force, own=_OWN_NAMES)
    for path in files:
        if path.suffix.lower() in _FILMS:
            check_film(path)
    given = {"muscle": muscle, "rest-length": rest_length, "contraction": contraction, "hand": hand}
    arm, tested, point, notes = _machine(machine, given, track, plant, seed)
    asked = asked_for(reference, arm)
    half_way = asked.duration / 2
    with Console(stderr=True).status("building the controller (compiled once after an installation: some 30 seconds)"):
        controller, observer = _loop(arm, plant, dt, horizon)

    def push(t: float) -> Any:
        return [load * (t >= half_way)] + [0.0] * (arm.n - 1)

    with Film(tested, arm) as film, _Window(tested, view) as window:
        filmed = any(path.suffix.lower() in _FILMS for path in files)

        def watch() -> None:
            if filmed:
                film.watch()
            window.watch()

        x0 = in_motion(arm, asked)
        done = simulate(tested, controller, asked, x0=x0, observer=observer, load=push, seed=seed, watch=watch)
    for path in files:
        _write(done, film, path, point)
    say(console, f"arm: {arm.summary}")
    for note in notes:
        say(console, note)
    say(console, f"reference: {asked.name}, {asked.duration:g} s")
    console.print(_summary(done, metrics(done), controller.implementation))
    if filmed:
        say(console, f"filmed by {film.by}")
    say(console, f"written: {', '.join(map(str, files))}")


def _files(out: list[Path]) -> list[Path]:
    """Return the files to write."""
    files = []
    for path in out:
        if path.suffix and path.suffix.lower() not in _SUFFIXES:
            raise InvalidInput(f"--out {path}: a run is written as {', '.join(_SUFFIXES)} or into a directory")
        files += [path] if path.suffix else [path / name for name in _OWN_NAMES]
    return files


def _machine(
    name: str, given: dict[str, Any], track: str, kind: str, seed: int
) -> "tuple[Arm, MujocoPlant, Endpoint | None, list[str]]":
    """Return the arm of this name or file, its plant, its hand, and what is to be said of it."""
    import numpy as np

    from mpc.arm.mujoco_plant import MujocoPlant

    for option, value, known in (("plant", kind, [_NOMINAL, _REAL]), ("stiffness to track", track, _TRACKED)):
        if value not in known:
            raise MissingBackend(option, value, known)
    model, arm, hand, notes, of_tendons = (_from_file if name.endswith(".xml") else _ready_made)(name, given)
    if track == _HAND:
        if hand is None:
            raise InvalidInput(f"--track hand: {name} has no hand; name a site or a body with --hand")
        arm = replace(arm, endpoint=hand)
    effects: dict[str, Any] = {}
    if kind == _REAL:
        signs = np.random.default_rng(seed).choice([-1.0, 1.0], arm.m)
        effects = {"force_gains": 1 + _OFF * signs, **_REAL_EFFECTS}
    plant = MujocoPlant(model, arm.mechanism.muscles, lag=arm.lag, slew=arm.slew, nominal=arm, **of_tendons, **effects)
    return arm, plant, hand, notes


def _ready_made(name: str, given: dict[str, Any]) -> "tuple[Any, Arm, Endpoint, list[str], dict[str, Any]]":
    from mpc.arm.mjcf import to_mjcf
    from mpc.model.arm.bodies import BODIES
    from mpc.model.arm.model import Arm

    for option, value in given.items():
        if value:
            raise InvalidInput(f"--{option} is of a MuJoCo model: --machine FILE.xml; {name} has its own")
    if name not in BODIES:
        raise MissingBackend("arm", name, [*BODIES, "a file ending in .xml"])
    arm = Arm.machine(name)
    return to_mjcf(arm.mechanism, arm.bodies), arm, arm.bodies.endpoint, [], {}


def _from_file(name: str, given: dict[str, Any]) -> "tuple[Any, Arm, Endpoint | None, list[str], dict[str, Any]]":
    """Read the arm of a MuJoCo model. Raises `InvalidFile`, `InvalidInput`, `MissingBackend` and `MissingPackage`."""
    from allocator.muscles.catalogue import named_muscle
    from mpc.model.arm.model import Arm
    from mpc.model.arm.reading import read_arm

    muscles = [named_muscle(muscle) for muscle in given["muscle"] or [_MUSCLE]]
    lengths, eps = (_numbers(f"--{option}", given[option], unit) for option, unit in _OF_TENDONS)
    if lengths is not None:
        for length in lengths:
            within("--rest-length", length, "mm", 1, 10_000)
        lengths, eps = [length * MM for length in lengths], eps or [_CONTRACTION]
    one = muscles[0] if len(muscles) == 1 else muscles
    read = read_arm(name, one, _one_or_all(lengths), None, _one_or_all(eps), hand=given["hand"])
    notes = [f"muscles: {', '.join(given['muscle'] or [_MUSCLE])}"]
    if read.hand is not None:
        coordinates = getattr(read.hand.kinematics, "axes", "")
        notes.append(f"hand: {read.hand_name} ({', '.join(coordinates)})")
    if read.asked_of_mujoco:
        notes.append(f"without formulas, so that a step is slow: {read.asked_of_mujoco}")
    if read.left_out:
        notes.append(f"not in the controller's model: {read.left_out}")
    rest = {"rest_length": read.mechanism.routes.rest_length, "cable": read.cable}
    return read.model, Arm(read.mechanism, read.bodies), read.hand, notes, rest


def _numbers(option: str, text: str | None, unit: str) -> list[float] | None:
    if text is None:
        return None
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        raise InvalidInput(f"{option} {text}: expected numbers with commas between them [{unit}]") from None
    for value in found:
        finite(option, value, unit)
    return found


def _one_or_all(numbers: list[float] | None) -> float | list[float] | None:
    return numbers[0] if numbers is not None and len(numbers) == 1 else numbers


def _loop(arm: "Arm", kind: str, dt: float, horizon: int) -> tuple[Any, Any]:
    """Return a controller, and an observer where the true state is not to be had."""
    from mpc.model.compensation import Compensation
    from mpc.observer.kalman import KalmanObserver
    from mpc.tracking.controller import TrackingMPC
    from mpc.tracking.presets import CALM, CALM_NOISE

    if kind == _NOMINAL:
        return TrackingMPC(arm, dt=dt, N=horizon), KalmanObserver(arm, dt)
    delay = _REAL_EFFECTS["dead_time"]
    known = Compensation(dead_time=delay)
    observer = KalmanObserver(arm, dt, CALM_NOISE, known)
    return TrackingMPC(arm, dt=dt, N=horizon, weights=CALM, compensation=known), observer


class _Window:
    """A window of MuJoCo's viewer shows the plant in real time, if it is wanted."""

    def __init__(self, plant: "MujocoPlant", wanted: bool) -> None:
        self._plant, self._viewer, self._began = plant, None, perf_counter()
        if wanted:
            import mujoco.viewer

            self._viewer = mujoco.viewer.launch_passive(plant.model, plant.data)

    def watch(self) -> None:
        """Show the plant as it is now, when its time has come."""
        if self._viewer is None:
            return
        sleep(max(0.0, self._plant.time - (perf_counter() - self._began)))
        self._viewer.sync()

    def __enter__(self) -> "_Window":
        """Return itself."""
        return self

    def __exit__(self, *raised: object) -> None:
        """Close it."""
        if self._viewer is not None:
            self._viewer.close()


def _write(run: Any, film: Any, path: Path, hand: Any) -> None:
    from mpc.trials.files import save_run
    from mpc.trials.plotting import save_tracking_figure

    if path.suffix.lower() == ".csv":
        save_run(run, path)
    elif path.suffix.lower() in _FILMS:
        film.save(path)
    else:
        save_tracking_figure(run, path, hand=hand)


def _summary(run: "Run", m: "Metrics", implementation: str) -> "Table":
    from rich.table import Table

    arm, table = run.plant, Table("", "RMS, median", "worst, 99 %", title="arm")
    for i, name in enumerate(arm.mechanism.joint_names):
        table.add_row(f"angle error, {name} [°]", f"{m.theta_rms[i]:.3g}", f"{m.theta_worst[i]:.3g}")
    for i in range(arm.tracked):
        for j in range(i, arm.tracked):
            if abs(run.K[:, i, j]).max() > 1e-6:  # else no muscle crosses both joints
                rms, worst = f"{m.K_rms[i, j]:.3g}", f"{m.K_worst[i, j]:.3g}"
                entry = f"{arm.stiffness_name}{i + 1}{j + 1} [{arm.stiffness_unit}]"
                table.add_row(f"stiffness error, {entry}", rms, worst)
    table.add_section()
    for limit, (excess, unit) in m.violations.items():
        table.add_row(limit, "", f"exceeded by {excess:.3g} {unit}" if excess else "kept")
    table.add_section()
    table.add_row("time of a step [ms]", f"{m.step_median:.3g}", f"{m.step_p99:.3g}")
    table.add_row("implementation of the step", "", implementation)
    for rung, steps in ((rung, steps) for rung, steps in m.rungs.items() if steps):
        table.add_row(f"steps answered by {rung}", "", str(steps))
    return table
