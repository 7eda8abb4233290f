"""The commands about statics are `antagonist allocate` and `muscles`, in degrees and bar; behind them all is SI."""

from importlib import metadata
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allocator.errors import InvalidInput
from allocator.feasibility.cli import map_command
from allocator.identification.joint.cli import fit_joint_command
from allocator.identification.joint.plan_cli import plan_joint_command
from allocator.identification.motion.cli import fit_motion_command
from allocator.identification.muscle.cli import fit_command
from allocator.presentation.tables import number
from allocator.shell.joint_options import JointOptions
from allocator.shell.options import Command, finite, grouped
from allocator.shell.printing import AsJSON, print_json, say
from allocator.shell.stiffness_options import StiffnessOptions

if TYPE_CHECKING:
    from rich.table import Table

    from allocator.allocation import Allocation

_NOT_MET = 3  # exit code

app = typer.Typer(
    name="antagonist",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # it takes units in brackets for styles
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"antagonist {metadata.version('antagonist')}")
        raise typer.Exit


@app.callback()
def _group(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Torque and stiffness of pneumatic-muscle joints.

    A first tour: `antagonist track` moves a joint, `antagonist map` shows what it can do, `antagonist fit` makes a
    muscle of your measurements, `antagonist init joint.toml` writes a joint to edit.
    """


@app.command(cls=Command, short_help="two pressures for a torque and a stiffness")
@grouped
def allocate(
    theta: Annotated[float, typer.Option(help="joint angle [degrees]")],
    stiffness: Annotated[
        float, typer.Option(help="stiffness wanted [N·m/rad]: isobaric, or as --valves or --frequency say")
    ],
    options: JointOptions,
    stiffness_options: StiffnessOptions,
    torque: Annotated[float, typer.Option(help="torque wanted [N·m]")] = 0.0,
    priority: Annotated[str, typer.Option(help="what is met first: torque or stiffness")] = "torque",
    method: Annotated[str, typer.Option(help="exact, qp, nlp, convex, or analytic: no limits")] = "exact",
    solver: Annotated[str | None, typer.Option(help="solver of the methods qp, nlp and convex")] = None,
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    as_json: AsJSON = False,
) -> None:
    """Find the two pressures for a torque and a stiffness, and say what is in the way.

    The exit code is 3 where torque and stiffness are not both met.
    """
    from allocator.allocation import allocate as solve
    from allocator.units import DEG

    finite("--theta", theta, "degrees")
    if abs(theta) > 360:
        raise InvalidInput(f"theta = {theta:g}° is over a turn")
    answer = solve(
        theta * DEG,
        stiffness,
        torque,
        joint=options.build(),
        method=method,  # type: ignore[arg-type]  # checked there
        priority=priority,  # type: ignore[arg-type]  # checked there
        min_force=min_force,
        solver=solver,
        valves=stiffness_options.kind,  # type: ignore[arg-type]  # checked there
    )
    if as_json:
        print_json(_values(answer))
    else:
        _print(answer)
    if not answer.success:
        raise typer.Exit(_NOT_MET)


def _values(a: "Allocation") -> dict[str, Any]:
    """Return what `--json` prints."""
    return a.to_dict() | {
        "limits": a.active,
        "stiffness": a.stiffness_name,
        "met": bool(a.success),
        "stiffness_std_Nm_per_rad": a.K_std,
        "F1_N": a.forces[0],
        "F2_N": a.forces[1],
        "torque_reachable_Nm": a.torque_interval,
        "stiffness_reachable_Nm_per_rad": a.stiffness_interval,
        "slack_assumed": a.joint.slack_assumed,
        "message": a.message,
    }


def _print(answer: "Allocation") -> None:
    from rich.console import Console

    console = Console()
    console.print(_table(answer))
    say(console, answer.message)


def _table(a: "Allocation") -> "Table":
    from rich.table import Table
    from rich.text import Text

    from allocator.units import BAR, DEG

    table = Table("", "asked", "given", "reachable", title=f"{number(a.theta / DEG)}° · {a.status.name}")
    (T_min, T_max), (K_min, K_max) = (map(number, ends) for ends in (a.torque_interval, a.stiffness_interval))
    table.add_row("torque [N·m]", number(a.T_target), number(a.T), f"{T_min} … {T_max}")
    table.add_row(f"{a.stiffness_name} [N·m/rad]", number(a.K_target), number(a.K), f"{K_min} … {K_max} at this torque")
    if a.K_std is not None:
        table.add_row("  its standard deviation", "", number(a.K_std, 2), "from the fit, not from the choice of model")
    if not a.kind.isobaric:
        table.add_row("  isobaric [N·m/rad]", "", number(a.isobaric_stiffness), "with the pressures held")
    for name, pressure, force in zip(("agonist", "antagonist"), (a.P1, a.P2), a.forces, strict=True):
        table.add_row(Text(f"{name} pressure [bar]"), "", f"{pressure / BAR:.4f}", f"pulls {number(force)} N")
    table.add_row("binding limits", "", ", ".join(a.active) or "none", "")
    if a.assumed:
        table.add_row("slack limits", "", "assumed", "not seen in the fit of the joint")
    return table


@app.command(cls=Command, short_help="list muscles and models")
def muscles() -> None:
    """List the muscles that --muscle takes by name, and the models that `antagonist fit` fits."""
    from rich.console import Console
    from rich.table import Table

    from allocator.muscles import MODELS
    from allocator.muscles.catalogue import MUSCLES, SOURCES
    from allocator.units import BAR

    named = Table("--muscle", "model", "source of its numbers", title="Muscles")
    named.add_column("N at 5 bar", justify="right")
    for name, muscle in MUSCLES.items():
        force = muscle.force(5 * BAR, 0.0)
        named.add_row(name, type(muscle).__name__, SOURCES[name], f"{force:.0f}")
    models = Table("model", "published", title="Models")
    for name, model in MODELS.items():
        models.add_row(name, model.citation)
    console = Console()
    console.print(named, models, sep="\n")
    say(console, "Forces are those at rest length. A file that `antagonist fit` wrote goes to --muscle as well.")


app.command("fit", cls=Command, short_help="a muscle from measured forces (CSV)")(fit_command)
app.command("fit-joint", cls=Command, short_help="a joint from angles at pressures (CSV)")(fit_joint_command)
app.command("plan-joint", cls=Command, short_help="what to measure for fit-joint")(plan_joint_command)
app.command("fit-motion", cls=Command, short_help="lags and hysteresis from a log of a moving joint (CSV)")(
    fit_motion_command
)
app.command("map", cls=Command, short_help="which angles, stiffnesses and torques exist")(map_command)

__all__ = ["app"]
