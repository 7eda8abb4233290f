"""Commands about statics: `antagonist allocate`. Degrees and bar here, SI behind."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.errors import AntagonistError, InvalidInput
from allocator.feasibility.cli import map_command
from allocator.identification.cli import fit_command
from allocator.identification.joint_cli import fit_joint_command
from allocator.joint import AntagonistJoint, report_joint
from allocator.joint_storage import load_joint
from allocator.muscles.catalogue import named_muscle

if TYPE_CHECKING:
    from rich.table import Table

    from allocator.allocation import Allocation

REPORT_MUSCLE = "tondu-dmsp-20-400n"
MUSCLE = typer.Option(help="both muscles: a name of the catalogue, or a TOML file written by `antagonist fit`")

JOINT = typer.Option(help="a joint in a TOML file written by `antagonist fit-joint`, instead of --muscle")

app = typer.Typer(
    name="antagonist",
    help="Torque and stiffness of pneumatic-muscle joints.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # it takes units in brackets for styles
)


@app.callback()
def _group() -> None:
    """Torque and stiffness of pneumatic-muscle joints."""


@app.command()
def allocate(
    theta: Annotated[float, typer.Option(help="joint angle [degrees]")],
    stiffness: Annotated[float, typer.Option(help="isobaric stiffness wanted [N·m/rad]")],
    torque: Annotated[float, typer.Option(help="torque wanted [N·m]")] = 0.0,
    priority: Annotated[str, typer.Option(help="what is met first: torque or stiffness")] = "torque",
    method: Annotated[str, typer.Option(help="exact, qp, nlp, convex, or analytic: no limits")] = "exact",
    solver: Annotated[str | None, typer.Option(help="solver of the methods qp, nlp and convex")] = None,
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    muscle: Annotated[str, MUSCLE] = REPORT_MUSCLE,
    joint: Annotated[Path | None, JOINT] = None,
) -> None:
    """Find the two pressures for a torque and a stiffness, and say what is in the way."""
    from rich.console import Console

    from allocator.allocation import allocate as solve
    from allocator.units import DEG

    if abs(theta) > 360:
        raise InvalidInput(f"theta = {theta:g}° is over a turn")
    answer = solve(
        theta * DEG,
        stiffness,
        torque,
        joint=chosen_joint(muscle, joint),
        method=method,  # type: ignore[arg-type]  # checked there
        priority=priority,  # type: ignore[arg-type]  # checked there
        min_force=min_force,
        solver=solver,
    )
    console = Console()
    console.print(_table(answer))
    console.print(answer.message, highlight=False)


def chosen_joint(muscle: str, joint: Path | None) -> AntagonistJoint:
    """The joint in the file, or the report's with the muscle of this name."""
    return report_joint(named_muscle(muscle)) if joint is None else load_joint(joint)


def _table(a: "Allocation") -> "Table":
    from rich.table import Table
    from rich.text import Text

    from allocator.units import BAR, DEG

    table = Table("", "asked", "given", "reachable", title=f"{a.theta / DEG:.4g}° · {a.status.name}")
    T_min, T_max = a.torque_interval
    K_min, K_max = a.stiffness_interval
    table.add_row("torque [N·m]", f"{a.T_target:.4g}", f"{a.T:.4g}", f"{T_min:.4g} … {T_max:.4g}")
    table.add_row("stiffness [N·m/rad]", f"{a.K_target:.4g}", f"{a.K:.4g}", f"{K_min:.4g} … {K_max:.4g} at this torque")
    if a.K_std is not None:
        table.add_row("  its standard deviation", "", f"{a.K_std:.2g}", "from the fit, not from the choice of model")
    for name, pressure, force in zip(("agonist", "antagonist"), (a.P1, a.P2), a.forces, strict=True):
        table.add_row(Text(f"{name} pressure [bar]"), "", f"{pressure / BAR:.4f}", f"pulls {force:.4g} N")
    table.add_row("binding limits", "", ", ".join(a.active) or "none", "")
    return table


app.command("fit")(fit_command)
app.command("fit-joint")(fit_joint_command)
app.command("map")(map_command)


def run(application: typer.Typer) -> None:
    """Run `application`; what it raises on purpose becomes one sentence and exit code 2."""
    try:
        application()
    except AntagonistError as error:
        print(f"antagonist: {error}", file=sys.stderr)
        sys.exit(2)


__all__ = ["JOINT", "MUSCLE", "REPORT_MUSCLE", "app", "chosen_joint", "run"]
