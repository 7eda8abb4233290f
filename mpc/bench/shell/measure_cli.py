"""Command `antagonist measure`: the stiffness of a joint on a device, or in a log."""

from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import numpy as np
import typer

from allocator.errors import InvalidInput
from allocator.identification.options import LogOptions
from allocator.shell.options import finite, grouped, row, within
from allocator.shell.outputs import IMAGES, AsJSON, Force, check_ending, claim, print_json, say, write
from allocator.units import BAR, DEG, PERCENT
from mpc.bench.shell.cli import exit_code, hanger, say_ending
from mpc.bench.shell.options import BenchOptions
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from mpc.bench.cycle import Cycle
    from mpc.bench.measuring.log import Samples
    from mpc.bench.measuring.result import MeasuredStiffness
    from mpc.model.plant import Plant

    Method: TypeAlias = Callable[..., tuple[MeasuredStiffness, Cycle]]  # `measure` or `shake`

_NOT_MEASURED = 3  # exit code
_HARDLY_KNOWN = 20  # [%] standard deviation of an inertia that a weight replaces


@grouped
def measure_command(
    options: PlantOptions,
    bench: BenchOptions,
    log: Annotated[
        Path | None,
        typer.Argument(
            help="a log to analyse instead of a --device; of `antagonist run`, or a CSV or bag with time, theta and "
            "measured pressure1 and pressure2"
        ),
    ] = None,
    around: Annotated[
        list[str] | None,
        typer.Option(
            help="ANGLE:STIFFNESS to measure about [°, N·m/rad]; may be repeated. By default the middle of both ranges"
        ),
    ] = None,
    amplitude: Annotated[float, typer.Option(help="amplitude of compared tones [±°]")] = 3.0,
    shake: Annotated[
        float,
        typer.Option(help="shake by noise of this size [±°]; 0: tones instead"),
    ] = 0.0,
    series: Annotated[str, typer.Option(help="amplitudes of the curve K_felt(A), with commas [±°]; 0: none")] = "8",
    inertia_error: Annotated[float, typer.Option(help="standard deviation of --inertia [%]")] = 0.0,
    weight: Annotated[
        float, typer.Option(help="torque of a weight to hang at the end [N·m], positive towards falling θ; 0: none")
    ] = 0.0,
    update: Annotated[
        bool, typer.Option("--update", help="write the strengths into the file of --machine; its history is kept")
    ] = False,
    out: Annotated[Path | None, typer.Option(help="picture of K_felt against the amplitude (.png, .pdf, .svg)")] = None,
    dt: Annotated[float, typer.Option(help="sample time [s]")] = 0.01,
    *,
    source: LogOptions,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Measure the stiffness of a joint: muscle strengths, backbone stiffness and felt stiffness.

    Both pressures oscillate about a rest with equal amplitudes at a low and at a high frequency. Hysteresis cancels in
    the comparison, and the inertia sets the scale. The measurement needs an encoder, two pressure sensors and the
    inertia, including a payload: --inertia, or that of --machine if it was not fitted, or a --weight. It begins and
    ends as `antagonist run` does.

    --shake replaces the tones by noise, whose wider motions suit slow regulators and joints with friction. A log is
    analysed in the same way; it needs fast motions of both pressures. The exit code is 0 if everything was measured,
    else 3, and the message gives the reason.
    """
    from rich.console import Console

    console = Console(stderr=as_json)
    check_ending("--out", out, IMAGES)
    claim(out, inputs=(*options.files, log), force=force)
    within("--inertia-error", inertia_error, "%", 0, 50)
    finite("--weight", weight, "N·m")
    within("--dt", dt, "s", 1e-3, 0.05)
    if update:
        _check_update(options)
    if log is not None and (bench.device or around or weight or shake):
        raise InvalidInput("a log takes none of --device, --around, --weight and --shake")
    if log is None and source != LogOptions():
        raise InvalidInput("--columns, --skip-rows and --topics describe a log: name its file")
    samples = None if log is None else _read(log, source, options.encoder_zero, console)
    scaled = bench.device.partition(":")[0] == "sim" or (weight and inertia_error >= _HARDLY_KNOWN)
    if (samples is not None or bench.device) and not scaled:
        _check_inertia(options, "" if log else ", or with --inertia-error 50 a --weight [N·m]")
    if samples is not None:
        found, code = [_in_log(samples, options, inertia_error, console)], 0
    else:
        method = _by_noise(shake, weight) if shake else _by_tones(amplitude, series)
        found, code = _on_device(options, bench, around or [], method, inertia_error, weight, dt, console)
    good = [m for m in found if m.success]
    if as_json:
        print_json({"measurements": [m.to_dict() for m in found]})
    if good:
        write(out, partial(_draw, good, options, bench if log is None else None), console)
    if update:
        _updated(good if not code else [], options, inertia_error, console)
    if code or len(good) < len(found) or not found:
        raise typer.Exit(code or _NOT_MEASURED)


def _by_tones(amplitude: float, series: str) -> "Method":
    from mpc.bench.measuring.experiment import Tones
    from mpc.bench.measuring.session import measure

    within("--amplitude", amplitude, "°", 0.05, 20)
    given = [a for a in row("--series", series, "°") if a]
    for a in given:
        within("--series", a, "°", 0.05, 45)
    return partial(measure, tones=Tones(amplitude * DEG, series=tuple(a * DEG for a in given)))


def _by_noise(amplitude: float, weight: float) -> "Method":
    from mpc.bench.measuring.session import shake

    within("--shake", amplitude, "°", 1, 45)
    if weight:
        raise InvalidInput("--weight goes with tones: leave out --shake")
    return partial(shake, amplitude=amplitude * DEG)


def _on_device(
    options: PlantOptions,
    bench: BenchOptions,
    around: list[str],
    method: "Method",
    inertia_error: float,
    weight: float,
    dt: float,
    console: "Console",
) -> "tuple[list[MeasuredStiffness], int]":
    """Measure about every rest, and stop after a failure.

    Return the measurements and the exit code. All rests are checked before the first motion.
    """
    from mpc.bench.measuring.session import Told
    from mpc.bench.measuring.weighing import Weight

    settings, found = bench.settings(options), []
    opened = bench.opened(options)
    rests = [_rest(text, opened.plant) for text in around] or [_middle(opened.plant)]
    for theta, K in rests:
        opened = bench.opened(options)
        say(console, f"about {theta / DEG:.3g}° and {K:.3g} N·m/rad, with the inertia {opened.plant.inertia:g} kg·m²")
        hung = {"weight": Weight(weight, hanger(opened.device, console))} if weight else {}
        dashboard = bench.dashboard(opened.plant)
        told = Told(opened.plant, opened.known, inertia_error * PERCENT)
        with dashboard or nullcontext():
            m, cycle = method(
                opened.device, told, theta, K, dt=dt, settings=settings, clock=opened.clock, watch=dashboard, **hung
            )
        found.append(_shown(m, console))
        assert cycle.ending is not None
        if code := exit_code(cycle.ending):
            say_ending(cycle.ending, cycle.lateness, console)
            return found, code
    return found, 0


def _read(log: Path, source: LogOptions, zero: float, console: "Console") -> "Samples":
    from mpc.bench.measuring.log import read_log_of_motion

    samples = source.read(partial(read_log_of_motion, zero=zero), log)
    say(console, *samples.notes)
    return samples


def _in_log(samples: "Samples", options: PlantOptions, inertia_error: float, console: "Console") -> "MeasuredStiffness":
    from mpc.bench.measuring.log import from_log
    from mpc.bench.measuring.session import Told

    told = Told(options.plant(), options.compensation(), inertia_error * PERCENT)
    return _shown(from_log(told.plant, told.known.friction.loop, samples, told.prior), console)


def _check_inertia(options: PlantOptions, otherwise: str) -> None:
    """Insist on a known inertia: the default is nobody's, and a fitted one is proportional to the model's stiffness."""
    from allocator.files.toml import Table

    if options.inertia is not None:
        return
    wanted = f"give --inertia [kg·m²]{otherwise}"
    file = None if options.file is None else Table.read(options.file)
    given, fitted = (None if file is None else file.table(name) for name in ("plant", "intervals"))
    if given is None or "inertia" not in given.entries:
        raise InvalidInput(f"the inertia sets the scale of the measurement, and is not in --machine: {wanted}")
    if fitted is not None and "inertia" in fitted.entries:
        raise InvalidInput(
            f"{options.file}: the inertia was fitted in proportion to the model's stiffness, which is to be measured: "
            f"{wanted}"
        )


def _check_update(options: PlantOptions) -> None:
    """Insist before any motion that strengths can be written into the joint's file."""
    from allocator.files.atomic import check_writable
    from mpc.bench.measuring.update import strengthened

    if options.file is None:
        raise InvalidInput("--update writes into the joint's file: name it with --machine")
    check_writable(Path(options.file))
    strengthened(options.joint(), np.ones(2), np.zeros((2, 2)))


def _shown(m: "MeasuredStiffness", console: "Console") -> "MeasuredStiffness":
    """Print a measurement and return it."""
    console.print(_table(m)) if m.success else say(console, m.sentence)
    return m


def _rest(text: str, plant: "Plant") -> tuple[float, float]:
    """Return angle [rad] and stiffness [N·m/rad] of --around, which the joint has. Raises `InvalidInput`."""
    from mpc.bench.measuring.driving import resting

    try:
        theta, K = map(float, text.split(":"))
    except ValueError:
        raise InvalidInput(f"--around {text}: expected ANGLE:STIFFNESS in ° and N·m/rad, such as 10:6") from None
    left, right = (end / DEG for end in plant.angle_limits)
    within("--around", theta, "°, the joint's range", left, right)
    within("--around", K, "N·m/rad", 1e-3, 1e6)
    resting(plant, theta * DEG, K)
    return theta * DEG, K


def _middle(plant: "Plant") -> tuple[float, float]:
    """Return the middles of the joint's range [rad] and of the stiffnesses [N·m/rad] there."""
    from allocator.feasibility import stiffness_interval

    theta = float(plant.middle)
    return theta, float(sum(stiffness_interval(theta, 0.0, joint=plant.joint))) / 2


def _table(m: "MeasuredStiffness") -> "Table":
    from rich.table import Table

    title = f"{m.theta / DEG:.1f}°, {m.pressures[0] / BAR:.2f} and {m.pressures[1] / BAR:.2f} bar · {m.duration:.0f} s"
    table = Table("", "measured", "", title=title)
    for cells in m.rows:
        table.add_row(*cells)
    return table


def _draw(good: "list[MeasuredStiffness]", options: PlantOptions, bench: BenchOptions | None, out: Path) -> None:
    from allocator.presentation.plotting import save_figure
    from mpc.bench.measuring.result import plot_measured

    opened = None if bench is None else bench.opened(options)
    plant, known = (options.plant(), options.compensation()) if opened is None else (opened.plant, opened.known)
    save_figure(plot_measured(good, plant.joint, known.friction.loop), out)


def _updated(good: "list[MeasuredStiffness]", options: PlantOptions, inertia_error: float, console: "Console") -> None:
    """Write the strengths into the joint's file."""
    from mpc.bench.measuring.update import update

    if not good:
        say(console, f"{options.file} is unchanged")
        return
    path = str(options.file)
    joint = update(path, good, options.plant().inertia, inertia_error * PERCENT)
    K = float(joint.stiffness(good[0].theta, *good[0].pressures))
    say(console, f"written: {path}: backbone K {good[0].model_K:.3g} → {K:.3g} N·m/rad about the first rest")
