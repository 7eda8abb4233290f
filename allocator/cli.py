"""The commands about statics are `antagonist allocate` and `muscles`, in degrees and bar; behind them all is SI."""

from importlib import metadata
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allocator.errors import InvalidInput
from allocator.feasibility.cli import map_command
from allocator.identification.joint.cli import fit_joint_command
from allocator.identification.joint.planning.cli import plan_joint_command
from allocator.identification.muscle.cli import fit_command
from allocator.mechanism.cli import answer
from allocator.presentation.tables import number
from allocator.shell.joint_options import JointOptions
from allocator.shell.mechanism_options import MechanismOptions
from allocator.shell.options import Command, finite, grouped
from allocator.shell.printing import AsJSON, print_json, say
from allocator.shell.stiffness_options import StiffnessOptions

if TYPE_CHECKING:
    from rich.table import Table

    from allocator.allocation.pair import PairAllocation

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

    A joint of your own: `plan-joint` says what to measure, `fit-joint` makes a joint of it, `fit-motion` a plant of it
    and a log of its motion, and `allocate`, `map`, `track` and `export` take the file with --joint.
    """


@app.command(cls=Command, short_help="pressures for a torque and a stiffness")
@grouped
def allocate(
    stiffness: Annotated[
        str,
        typer.Option(
            help="stiffness wanted [N·m/rad]: isobaric, or as --valves or --frequency say; of a mechanism K11,K12,K22, "
            "with --links that of its hand [N/m]"
        ),
    ],
    options: JointOptions,
    stiffness_options: StiffnessOptions,
    mechanism_options: MechanismOptions,
    theta: Annotated[float | None, typer.Option(help="joint angle [degrees]")] = None,
    torque: Annotated[str, typer.Option(help="torque wanted [N·m]; of a mechanism one a joint, with commas")] = "0",
    at_least: Annotated[
        bool, typer.Option("--at-least", help="of a mechanism: at least this stiffness, with the least pressures")
    ] = False,
    priority: Annotated[str, typer.Option(help="what is met first: torque or stiffness")] = "torque",
    method: Annotated[str, typer.Option(help="exact, qp, nlp, convex, or analytic: no limits")] = "exact",
    solver: Annotated[str | None, typer.Option(help="solver of the methods qp, nlp and convex")] = None,
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    as_json: AsJSON = False,
) -> None:
    """Find the two pressures for a torque and a stiffness, and say what is in the way.

    With --mechanism all pressures of several joints, for their torques and a stiffness matrix, with --links that of the
    hand. The exit code is 3 where torque and stiffness are not both met.
    """
    from allocator.allocation import Method
    from allocator.allocation import allocate as solve
    from allocator.joint.gas import Stiffness
    from allocator.joint.limits import Limits
    from allocator.units import DEG

    if priority not in ("torque", "stiffness"):
        raise InvalidInput(f"--priority {priority}: choose torque or stiffness; allocate() in Python has weights, too")
    if mechanism_options.mechanism is not None:
        mechanism_options.alone(options, stiffness_options, theta)
        asked: dict[str, Any] = {"priority": priority, "method": method, "solver": solver, "min_force": min_force}
        if not answer(mechanism_options, stiffness, torque, at_least=at_least, as_json=as_json, **asked):
            raise typer.Exit(_NOT_MET)
        return
    if theta is None or at_least:
        raise InvalidInput("a joint needs --theta; --at-least goes with --mechanism")
    finite("--theta", theta, "degrees")
    if abs(theta) > 360:
        raise InvalidInput(f"theta = {theta:g}° is over a turn")
    found = solve(  # type: ignore[call-overload]  # the words are checked there
        theta * DEG,
        _one("--stiffness", stiffness, "N·m/rad"),
        _one("--torque", torque, "N·m"),
        joint=options.build(),
        method=Method.of(method)._replace(solver=solver),
        priority=priority,
        limits=Limits(min_force),
        stiffness=Stiffness(stiffness_options.kind(options.joint)),
    )
    if as_json:
        print_json(_values(found))
    else:
        _print(found)
    if not found.success:
        raise typer.Exit(_NOT_MET)


def _one(option: str, text: str, unit: str) -> float:
    """Read one number."""
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{option} {text}: expected one number [{unit}]") from None


def _values(a: "PairAllocation") -> dict[str, Any]:
    """Return what `--json` prints."""
    return a.to_dict() | {
        "limits": a.active,
        "stiffness": a.stiffness_name,
        "met": bool(a.success),
        "stiffness_std_Nm_per_rad": a.K_std,
        "F1_N": a.forces[0],
        "F2_N": a.forces[1],
        "F1_std_N": None if a.forces_std is None else a.forces_std[0],
        "F2_std_N": None if a.forces_std is None else a.forces_std[1],
        "torque_reachable_Nm": a.torque_interval,
        "stiffness_reachable_Nm_per_rad": a.stiffness_interval,
        "slack_assumed": a.joint.slack_assumed,
        "assumed": a.assumed,
        "message": a.message,
    }


def _print(found: "PairAllocation") -> None:
    from rich.console import Console

    console = Console()
    console.print(_table(found))
    say(console, found.message)


def _table(a: "PairAllocation") -> "Table":
    from rich.table import Table
    from rich.text import Text

    from allocator.joint.assumption import visits
    from allocator.units import BAR, DEG

    table = Table("", "asked", "given", "reachable", title=f"{number(a.theta / DEG)}° · {a.status.name}")
    (T_min, T_max), (K_min, K_max) = (map(number, ends) for ends in (a.torque_interval, a.stiffness_interval))
    table.add_row("torque [N·m]", number(a.T_target), number(a.T), f"{T_min} … {T_max}")
    table.add_row(f"{a.stiffness_name} [N·m/rad]", number(a.K_target), number(a.K), f"{K_min} … {K_max} at this torque")
    if a.K_std is not None:
        table.add_row("  its standard deviation", "", number(a.K_std, 2), "from the fit")
    if not a.kind.isobaric:
        table.add_row("  isobaric [N·m/rad]", "", number(a.isobaric_stiffness), "with the pressures held")
    unseen = ", a common force was not seen" if a.joint.slack_assumed else ""
    for i, (name, pressure) in enumerate((("agonist", a.P1), ("antagonist", a.P2))):
        std = "" if a.forces_std is None else f" ± {number(a.forces_std[i], 2)}"
        pull = f"pulls {number(a.forces[i])}{std} N{unseen}"
        table.add_row(Text(f"{name} pressure [bar]"), "", f"{pressure / BAR:.4f}", pull)
    table.add_row("binding limits", "", ", ".join(a.active) or "none", "")
    if a.joint.slack_assumed:
        table.add_row("slack limits", "", "assumed", "not seen in the fit of the joint")
    for visit in visits(a.joint, a.theta, a.P1, a.P2):
        within = "extrapolated" if visit.extrapolates.any() else "measured"
        table.add_row(f"force of the {visit.name}", "", within, Text(str(visit.region)))
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
app.command("map", cls=Command, short_help="which angles, stiffnesses and torques exist")(map_command)
