"""Command `antagonist fit-joint`: a joint from a log of its rests."""

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.files.text import short
from allocator.files.toml import Table
from allocator.identification.joint.filing import Said
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.plotting import plot_joint_fit
from allocator.identification.joint.reading import JointLog, joined_logs, read_joint_log
from allocator.identification.joint.relative import RelativeJoint, describe_reference
from allocator.identification.joint.result import JointFit
from allocator.identification.options import LogOptions, assigned, clock, print_lines
from allocator.joint.geometry import Geometry, Lever, Pulley
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.machine_file import load_joint
from allocator.presentation.plotting import save_figure
from allocator.shell.options import grouped, numbers, read_gravity, row, within
from allocator.shell.outputs import AsJSON, Force, claim_result, print_json, say, write
from allocator.units import BAR, DEG, MM


@grouped
def fit_joint_command(
    log: Annotated[
        list[Path],
        typer.Argument(help="CSV files or bags; with theta [deg], pressure1 [bar] and pressure2 [bar], see above"),
    ],
    lever: Annotated[
        str | None,
        typer.Option(
            help="dimensions of a lever, R,r or R,r,offset [mm]; the distance from axis to anchor, the lever, and "
            "an offset. The muscle is √(R² + r² ∓ 2 R r sin θ) + offset long; the offset of a cable in "
            "between is negative"
        ),
    ] = None,
    pulley: Annotated[
        str | None, typer.Option(help="dimensions of a pulley, R,ε0: radius [mm] and contraction ratio at θ = 0")
    ] = None,
    machine: Annotated[
        Path | None, typer.Option(help="TOML file of a joint with the same mechanism, such as a measured Table")
    ] = None,
    rest_length: Annotated[
        float | None,
        typer.Option(help="rest length of the muscles [mm]; needed unless the file has a column of it, or --machine"),
    ] = None,
    *,
    source: LogOptions,
    model: Annotated[str, typer.Option(help="muscle model")] = "Sarosi2012",
    average: Annotated[bool, typer.Option("--average", help="fit the mean of both directions")] = False,
    friction: Annotated[bool, typer.Option(help="fit the friction μ; needs directions in the log")] = True,
    dead_band: Annotated[float, typer.Option(help="leave out samples with a pressure below this [bar]")] = 0.5,
    sweep: Annotated[
        list[str] | None, typer.Option(help="direction of a number in the column sweep, such as 1=-1; may be repeated")
    ] = None,
    zero: Annotated[
        float | None, typer.Option(help="known encoder reading at θ = 0 [degrees]; by default it is fitted")
    ] = None,
    gravity: Annotated[
        str | None,
        typer.Option(
            help="known gravity of the link, G or G,θh: m g l [N·m] and the angle at which it hangs [degrees], 0 by "
            "default; or fit. By default that in [plant] of --machine; 0 leaves it in the muscles"
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="TOML file to write the joint to")] = None,
    stops: Annotated[
        str | None,
        typer.Option(
            help="end stops LOW:HIGH of --out [degrees]; by default those of --machine, or the angles visited"
        ),
    ] = None,
    supply: Annotated[
        float | None,
        typer.Option(help="greatest pressure of --out [bar]; by default that of --machine, or the greatest read"),
    ] = None,
    group: Annotated[
        str | None, typer.Option(help="rest length [mm] of the joint that --out writes; needed if there are several")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="picture of angles, residuals and stiffness")] = None,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Fit a joint to angles measured at known pressures: muscles, friction and, with a weight, the force scale.

    Columns are found by name and unit: theta [deg]; pressure1 [bar] and pressure2 [bar] (agonist and antagonist,
    gauge); torque [Nm] of a weight, positive if it pulls θ down; direction (+1 after rising, -1 after falling θ) or
    sweep; rest_length [mm] if there are several; slack, in the rows of a sag test (1, 2 or 3: agonist, antagonist or
    both just went slack, else 0; `antagonist plan-joint` proposes one). Other units and words are recognised (P1_kPa,
    phi [rad]). A file with a column time [s] is a raw log: rests of a second or more are used, without rows with
    spikes, drop-outs or missing readings. Several files are fitted together, and each is also predicted from the rest.
    """
    within("--rest-length", rest_length, "mm", 1, 100_000)
    within("--dead-band", dead_band, "bar", 0, 100)
    within("--zero", zero, "degrees", -360, 360)
    if group is not None and out is None:
        raise InvalidInput("--group chooses the joint that --out writes: pass --out as well")
    claim_result(out, plot, inputs=(*log, machine), force=force)
    console = Console(stderr=as_json)
    ways = _sweeps(sweep or [])
    data = joined_logs({name: source.read(read_joint_log, one, ways) for name, one in short(log).items()})
    _describe_log(data, console)
    geometry, groups = _geometry(lever, pulley, machine, rest_length, data.rest_length)
    file = None if machine is None else Table.read(machine)
    said, pulled = _said(file, stops, supply), _gravity(gravity, file)
    fitted = partial(
        fit_joint, data.theta, data.P1, data.P2, torque=data.torque, direction=data.direction, slack=data.slack,
        geometry=geometry, group=groups or list(data.files) or None, average=average, friction=friction,
        dead_band=dead_band * BAR, zero=None if zero is None else zero * DEG, gravity=pulled,
    )  # fmt: skip
    with clock(console) as bar:
        bar.add_task(f"fitting {model}", total=None)  # the number of steps is unknown
        fit = fitted(model=model)
    if as_json:
        print_json(_values(fit))
    else:
        _describe(fit, _better_laws(fit, fitted), console)
    if out is not None:
        write(out, lambda path: fit.save(path, group, said), console)
        _describe_limits(fit, group, said, console)
    write(plot, lambda path: save_figure(plot_joint_fit(fit), path, dpi=120), console)


def _sweeps(settings: list[str]) -> dict[float, float]:
    ways = assigned("--sweep", settings, "NUMBER=DIRECTION, such as 1=-1")
    if wrong := [f"{name}={way:g}" for name, way in ways.items() if abs(way) != 1]:
        raise InvalidInput(f"--sweep {wrong[0]}: the direction is +1 (θ rises) or -1 (θ falls)")
    try:
        return {float(name): way for name, way in ways.items()}
    except ValueError:
        raise InvalidInput(f"--sweep {settings[0]}: expected NUMBER=DIRECTION, such as 1=-1") from None


def _geometry(
    lever: str | None, pulley: str | None, machine: Path | None, rest_length: float | None, column: Array | None
) -> tuple[Geometry | dict[str, Geometry], list[str] | None]:
    """Return the mechanism, or one for each rest length in the file with the label of each sample."""
    if sum(given is not None for given in (lever, pulley, machine)) != 1:
        raise InvalidInput("give the mechanism once: --lever R,r,offset [mm] or --pulley R,ε0, or --machine FILE")
    if machine is not None:
        if rest_length is not None or column is not None:
            raise InvalidInput(f"{machine} has the rest length: leave out --rest-length and columns of it")
        return load_joint(machine, scale_needed=False).geometry, None
    if (rest_length is None) == (column is None):
        raise InvalidInput("give the rest length once: --rest-length [mm], or a column rest_length_mm in the file")

    def make(l0: float) -> Geometry:
        if lever is not None:
            R, r, *offset = row("--lever", lever, "mm", {2: "R,r", 3: "R,r,offset"})
            return Lever(l0, _length("--lever", R), _length("--lever", r), *(end * MM for end in offset))
        radius, contraction = row("--pulley", pulley or "", "mm and a ratio", {2: "R,ε0"})
        return Pulley(l0, _length("--pulley", radius), contraction)

    if rest_length is not None:
        return make(rest_length * MM), None
    labels = [f"{length / MM:g}" for length in column] if column is not None else []
    return {label: make(float(label) * MM) for label in dict.fromkeys(labels)}, labels


def _said(file: Table | None, stops: str | None, supply: float | None) -> Said:
    within("--supply", supply, "bar", 0.05, 100)
    ends = None
    if stops is not None:
        low, high = numbers("--stops", stops, 2, 2, "-45:45")
        within("--stops", low, "degrees", -360, 360)
        within("--stops", high, "degrees, from low to high", low + 0.1, 360)
        ends = low * DEG, high * DEG
    return Said.of(file, ends, None if supply is None else (0.0, supply * BAR))


def _gravity(option: str | None, file: Table | None) -> Gravity | None:
    """Return the known gravity of the link; None if it is to be fitted."""
    if option == "fit":
        return None
    if option is None:
        return NO_GRAVITY if file is None else Gravity.of_file(file)
    return Gravity(*read_gravity(option, "; or fit"))


def _describe_limits(fit: JointFit, group: str | None, said: Said, console: Console) -> None:
    chosen = fit.joint if group is None else fit.joint_of(group)
    joint = chosen.shape if isinstance(chosen, RelativeJoint) else chosen
    if visited := said.visited(joint):
        say(console, f"{visited}; set them by --stops and --supply, or in the file of --machine")
        return
    (low, high), (left, right) = (tuple(end / DEG for end in one.angle_range) for one in (joint, said.about(joint)))
    if left < low or high < right:
        say(
            console,
            f"the joint's range is {left:.3g}° to {right:.3g}°, as said; beyond the rests, {low:.3g}° to {high:.3g}°, "
            "its torque and stiffness are extrapolated",
        )


def _length(option: str, length: float) -> float:
    """Return a length [mm] in metres. Raises `InvalidInput` for one of no joint."""
    within(option, length, "mm", 1, 10_000)
    return length * MM


def _describe_log(log: JointLog, console: Console) -> None:
    say(console, *log.notes)
    if log.used < log.rows:
        console.print(
            f"{log.theta.size} equilibria, the last seconds of rests in {log.rows} rows of a raw log; the other "
            f"{log.dropped_share:.0%} of the rows were left out",
            markup=False,
        )


def _better_laws(fit: JointFit, fitted: Callable[..., JointFit]) -> list[str]:
    """Return the laws that predict the angles better than `fit` if the joint is `fitted` with them, as by --model."""
    most = 0.8 * fit.rms  # of a law worth trying
    better = []
    for name in (choice.name for choice in fit.doubt.choices if choice.kind == "law" and choice.rms < most):
        try:
            other = fitted(model=name, leave_one_out=False, choices=False)
        except InvalidInput:
            continue
        if other.rms < most:
            better.append(name)
    return better


def _describe(fit: JointFit, better: list[str], console: Console) -> None:
    """Print the fit, its uncertainties, the `better` laws, and the quantities that the data leave open."""
    s, std, found = fit.samples, fit.standard_deviations, fit.doubt.discrepancy
    means = f", means of {s.measured} over cells of {s.cell / BAR:.2g} bar" if s.measured else ""
    lines = [
        f"{fit.model}, {s.n} equilibria{means}: {fit.rms / DEG:.2f}° RMS",
        f"  encoder zero {fit.zero / DEG:+.2f}{_plus_minus(std.get('zero', 0.0) / DEG)}°, antagonist "
        f"{fit.ratio:.3f}{_plus_minus(fit.ratio_std)} times as strong as the agonist, "
        f"friction μ = {fit.friction:.3f}{_plus_minus(std.get('friction', 0.0))}",
        *_gravity_lines(fit),
        f"  ± is one standard deviation. It allows for a smooth error of the force law ({found.law:.1%} of the mean "
        f"force) and reading noise of {found.noise / DEG:.2f}°, both estimated from the residuals",
        *_choice_lines(fit),
        *([f"  {' and '.join(better)} predict(s) these angles better: try --model"] if better else []),
    ]
    if not np.isnan(fit.hysteresis_share):
        lines.append(f"  {fit.hysteresis_share:.0%} of the squared error without friction is hysteresis")
    if len(fit.groups) > 1:
        lines += [
            f"  group {g.label}: {g.samples} samples, {g.rms / DEG:.2f}°, left out {g.left_out / DEG:.2f}°"
            for g in fit.groups
        ]
        lines.append(f"  groups left out in turn are predicted to {fit.left_out / DEG:.2f}° RMS")
    lines += [f"  {n} samples left out: {reason}" for reason, n in s.dropped.items()]
    lines.append(_stiffness_line(fit))
    lines += [f"  not seen by these data: {direction}" for direction in fit.unseen]
    lines += [f"  beware: {warning}" for warning in fit.warnings]
    print_lines(console, lines)


def _gravity_lines(fit: JointFit) -> list[str]:
    if not fit.gravity.torque:
        return []
    (G, h), found = (fit.gravity.torque, fit.gravity.hanging / DEG), any(fit.gravity_std)
    torque, angle = (_plus_minus(std) for std in (fit.gravity_std[0], fit.gravity_std[1] / DEG))
    return [
        f"  gravity {G:.3g}{torque} N·m of a link that hangs at {h:.3g}{angle}°, {'fitted' if found else 'as given'}; "
        "stiffness is that of the muscles, without it"
    ]


def _stiffness_line(fit: JointFit) -> str:
    if fit.scale is None:
        where = describe_reference(RelativeJoint(next(iter(fit.shapes.values()))))
        return (
            f"  stiffness: relative only, K/K_ref to ± {np.median(fit.stiffness_ratio_std()):.2g} (K_ref at {where}); "
            "absolute after a known weight was hung"
        )
    return f"  stiffness: known to {fit.scale_std:.1%} (one standard deviation)"


def _plus_minus(std: float) -> str:
    return f" ± {std:.2g}" if std else ""


def _choice_lines(fit: JointFit) -> list[str]:
    """Return a line on each alternative choice."""
    K = "K/K_ref" if fit.scale is None else "K"
    return [
        f"  with {c.name} instead: {c.rms / DEG:.2f}°, zero {c.zero / DEG:+.2f}°, ratio {c.ratio:.3f}, "
        f"μ = {c.friction:.3f}, {K} other by {c.stiffness:.1%}"
        for c in fit.doubt.choices
    ]


def _values(fit: JointFit) -> dict[str, object]:
    """Return the values printed by `--json`."""
    return {
        **fit.to_dict(),
        "samples_left_out": fit.samples.dropped,
        "law_error": fit.doubt.discrepancy.law,
        "noise_deg": fit.doubt.discrepancy.noise / DEG,
        "choices": [
            {
                "choice": choice.name,
                "kind": choice.kind,
                "rms_error_deg": choice.rms / DEG,
                "encoder_zero_deg": choice.zero / DEG,
                "antagonist_ratio": choice.ratio,
                "friction": choice.friction,
                "stiffness_change": choice.stiffness,
            }
            for choice in fit.doubt.choices
        ],
        "unseen": fit.unseen,
        "warnings": fit.warnings,
    }
