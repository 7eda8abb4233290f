"""The commands about statics are gathered here, and `antagonist muscles` stands here."""

from importlib import metadata
from typing import Annotated

import typer

from allocator.allocate_cli import allocate_command
from allocator.feasibility.cli import map_command
from allocator.identification.bag_cli import bag_command
from allocator.identification.joint.cli import fit_joint_command, plan_joint_command
from allocator.identification.muscle.cli import fit_command
from allocator.shell.options import Command
from allocator.shell.printing import say

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
    and a log of its motion, and `allocate`, `map`, `track` and `export` take the file with --machine.
    """


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


app.command("allocate", cls=Command, short_help="pressures for a torque and a stiffness")(allocate_command)
app.command("fit", cls=Command, short_help="a muscle from measured forces (CSV)")(fit_command)
app.command("fit-joint", cls=Command, short_help="a joint from angles at pressures (CSV)")(fit_joint_command)
app.command("bag", cls=Command, short_help="topics of a ROS bag or MCAP file as a CSV log")(bag_command)
app.command("plan-joint", cls=Command, short_help="what to measure for fit-joint")(plan_joint_command)
app.command("map", cls=Command, short_help="which angles, stiffnesses and torques exist")(map_command)
