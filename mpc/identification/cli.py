"""Command `antagonist fit-motion`: lags, hysteresis and a plant from the log of a moving joint."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.console import Console
from rich.table import Table

from allocator.errors import InvalidInput
from allocator.files import toml
from allocator.identification.motion.fit import STEPS, fit_motion
from allocator.identification.motion.plotting import plot_motion_fit
from allocator.identification.motion.result import LABELS, MotionFit
from allocator.identification.motion.samples import read_motion_log
from allocator.identification.options import LogOptions, clock
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.machine_file import encoder_zero_in, encoder_zero_known_in, joint_from, scale_known_in
from allocator.presentation.plotting import save_figure
from allocator.shell.options import grouped, within
from allocator.shell.outputs import AsJSON, Force, claim_result, print_json, say, write
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from mpc.identification.plant import IdentifiedPlant

_WORSE = 2.0  # times the error of the fit: error of a plant's file that deserves a warning


@grouped
def fit_motion_command(
    log: Annotated[
        list[Path],
        typer.Argument(
            help="CSV files or bags; with time [s], theta [deg], pressure1 [bar] and pressure2 [bar], see above"
        ),
    ],
    machine: Annotated[
        Path | None, typer.Option(help="TOML file of the same joint, from fit-joint; needed for --out")
    ] = None,
    *,
    source: LogOptions,
    zero: Annotated[
        float | None,
        typer.Option(help="known encoder reading at θ = 0 [degrees]; by default that of --machine, fitted unless held"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="TOML file to write the plant to, for --machine")] = None,
    gas: Annotated[
        bool | None,
        typer.Option(help="include the gas in the muscles of --machine; by default if the log fits better with it"),
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="picture of free run, residuals and hysteresis")] = None,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Fit lags, dead time, dead band, hysteresis, inertia and damping to the log of a moving joint without load.

    Columns are found by name and unit: time [s], theta [deg], pressure1 [bar] and pressure2 [bar] (agonist and
    antagonist, gauge, commanded or measured), also in other units and words (P1_kPa, phi [rad]). The parameters
    minimise the error of the angle that is predicted from the pressures alone. The best log is a minute or more of
    random steps of both pressures; slow sweeps determine the width of the hysteresis instead. Begin the log at rest,
    as the prediction does. Several logs, and stretches between gaps of more than a second, are fitted together, each
    with a new memory of the hysteresis. Rows with spikes, drop-outs and missing readings are left out and listed.

    A log of commands determines the sum of dead time and reading age. Columns measured1 and measured2 [bar] beside
    them separate the two.

    In the tables, taut rows have no pressure below 1.5 bar. The gain is the slope of the static angle over that of
    --machine (1: they agree). Inertia and damping are divided by the joint's stiffness, but not in the file of --out.
    """
    within("--zero", zero, "degrees", -360, 360)
    claim_result(out, plot, inputs=(*log, machine), force=force)
    if out is not None and machine is None:
        raise InvalidInput("--out writes a plant with muscles: give its joint with --machine, a file of fit-joint")
    console = Console(stderr=as_json)
    data = source.read(read_motion_log, log)
    say(console, *data.notes)
    content = None if machine is None else toml.Table.read(machine)
    given = None if content is None else joint_from(content, scale_needed=False)
    held, known = (None, False) if content is None else (encoder_zero_in(content), encoder_zero_known_in(content))
    with clock(console) as bar:
        task = bar.add_task("fitting", total=STEPS)
        fit = fit_motion(
            data.t,
            data.theta,
            data.P1,
            data.P2,
            joint=given,
            zero=zero * DEG if zero is not None else held or 0.0,
            hold_zero=known or zero is not None,
            gravity=NO_GRAVITY if content is None else Gravity.of_file(content),
            measured=data.measured,
            scale_known=content is None or scale_known_in(content),
            gas=gas,
            progress=lambda step: bar.update(task, advance=1, description=step),
        )
    plant = None if machine is None else _plant(fit, machine)
    if as_json:
        print_json(_values(fit, plant))
    else:
        _describe(fit, plant, console)
    if plant is not None:
        write(out, plant.save, console)
    write(plot, lambda path: save_figure(plot_motion_fit(fit), path, dpi=120), console)


def _plant(fit: MotionFit, joint: Path) -> "IdentifiedPlant":
    from mpc.identification.plant import IdentifiedPlant
    from mpc.model.plant import NUMBERS
    from mpc.model.storage import numbers_in

    return IdentifiedPlant.of(fit, numbers_in(toml.Table.read(joint), NUMBERS))


def _describe(fit: MotionFit, plant: "IdentifiedPlant | None", console: Console) -> None:
    """Print the parameters, their uncertainties, and the questions that the log leaves open."""
    errors = {
        "all rows": fit.error,
        "last 40 %, predicted from the rest": fit.held_out,
        "five blocks, each predicted from the others": fit.left_out,
    }
    if plant is not None:
        errors |= {
            "the plant's file, all rows": plant.errors,
            "the plant's file, last 40 % from the rest": plant.held_out,
        }
    table = Table("rows", "free run [°]", "taut rows [°]", title="error of the free run, RMS")
    for name, error in errors.items():
        table.add_row(name, f"{error.every / DEG:.2f}", f"{error.taut / DEG:.2f}")
    console.print(table)
    bands = fit.bands
    say(
        console,
        f"95 % band of predicted angles: ± {bands.taut / DEG:.2f}° in taut rows, ± {bands.other / DEG:.2f}° in others, "
        f"coverage of left-out blocks {bands.coverage:.1%}",
    )
    _describe_drift(fit, console)
    table = Table("", "value", "95 % interval", "unit", title="parameters of the motion")
    for name, e in fit.parameters.items():
        label = LABELS[name]
        low, high = (f"{end / label.unit:.3g}" for end in (e.low, e.high))
        table.add_row(label.quantity, f"{e.value / label.unit:.3g}", f"{low} … {high}", label.symbol)
    console.print(table)
    if plant is not None:
        _describe_plant(fit, plant, console)
    else:
        say(console, "no joint was given: the static angle is a polynomial of the pressures, and there is no plant")
    say(console, *(f"beware: {warning}" for warning in fit.warnings))
    say(console, *(f"not seen by this log: {sentence}" for sentence in fit.unseen))


def _describe_plant(fit: MotionFit, plant: "IdentifiedPlant", console: Console) -> None:
    """Print the numbers of the plant that the log does not show, and a file that is worse than the fit."""
    if not fit.scale_known:
        say(console, "the joint's force scale is unknown: inertia, damping and stiffness are known up to it")
    if plant.seen_slew:
        fast = f"slew {plant.seen_slew / BAR:.3g} bar/s: the fastest commands of this log, over a lag"
        say(console, f"{fast} (set it with --slew of later commands, or in [plant])")
    if plant.assumed:
        told = " (set it with --slew of later commands, or in [plant])" if "slew" in plant.assumed else ""
        say(console, f"assumed, since this log does not show it: {' and '.join(plant.assumed)} of the plant{told}")
    if widened := _widened(fit):
        say(console, f"beware: the log goes beyond the limits of --machine; the plant's file widens {widened}")
    if plant.errors.every > _WORSE * fit.error.every:
        say(
            console,
            f"beware: the plant's file errs by {plant.errors.every / DEG:.2g}° over the log, the fit by only "
            f"{fit.error.every / DEG:.2g}°: its muscles cannot hold all angles of the log; measure rests near the ends",
        )


def _widened(fit: MotionFit) -> str:
    """Return the limits of the given joint that the plant's file widens to those of the log, in words."""
    given, made, words = fit.given, fit.moving.joint, []
    if given is not None and given.angle_limits != made.angle_limits:
        stops, wider = (" to ".join(f"{end / DEG:.3g}°" for end in one.angle_range) for one in (given, made))
        words.append(f"the range of {stops} to {wider}")
    if given is not None and given.pressure_limits != made.pressure_limits:
        supply, more = (one.pressure_limits[1] / BAR for one in (given, made))
        words.append(f"the supply of {supply:.3g} bar to {more:.3g} bar")
    return " and ".join(words)


def _describe_drift(fit: MotionFit, console: Console) -> None:
    """Print the errors of the stretches, and how the strength changes over them."""
    drift = fit.drift
    if (count := len(fit.log.parts)) > 1:
        errors = ", ".join(f"{error / DEG:.2f}" for error in drift.errors)
        say(console, f"{count} stretches without a gap; error over the log's pieces, in their order [°]: {errors}")
    if drift.shows:
        say(console, f"the angle's swing changes by {drift.per_hour:+.1%} ± {drift.std:.1%} an hour")


def _values(fit: MotionFit, plant: "IdentifiedPlant | None") -> dict[str, object]:
    """Return what `--json` prints."""
    H = fit.operator
    hysteresis = {"weights": H.weights, "thresholds_deg": [r / DEG for r in H.thresholds], "base": H.base}
    hysteresis |= {} if H.stiffness is None else {"stiffness": H.stiffness}
    values = {**fit.to_dict(), "hysteresis": hysteresis, "unseen": fit.unseen, "warnings": fit.warnings}
    if plant is None:
        return values
    of_file = {"rms": plant.errors, "rms_last_40_percent": plant.last, "held_out": plant.held_out}
    told = {f"plant_{name}_deg": errors.every / DEG for name, errors in of_file.items()}
    return {**values, **told, "plant_assumed": plant.assumed}
