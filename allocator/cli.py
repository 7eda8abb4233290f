"""The command line: its group, the commands about statics, `antagonist muscles` and `antagonist bag`."""

from importlib import metadata
from pathlib import Path
from typing import Annotated

import typer

from allocator.allocate_cli import allocate_command
from allocator.errors import InvalidInput
from allocator.feasibility.cli import map_command
from allocator.identification.arm.cli import fit_arm_command
from allocator.identification.joint.cli import fit_joint_command
from allocator.identification.joint.planning.cli import plan_joint_command
from allocator.identification.muscle.cli import fit_command
from allocator.shell.options import Command
from allocator.shell.outputs import Force, check_ending, claim, say

app = typer.Typer(
    name="antagonist",
    invoke_without_command=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # it takes units in brackets for styles
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"antagonist {metadata.version('antagonist')}")
        raise typer.Exit


_FIRST = """\
Torque and stiffness of pneumatic-muscle joints. Five commands to begin with:

  antagonist track                                control a simulated joint
  antagonist map                                  draw its feasible stiffnesses
  antagonist allocate --theta 30 --stiffness 7.5  compute two pressures
  antagonist fit forces.csv --out muscle.toml     fit a muscle to measured forces
  antagonist init joint.toml                      write a joint file to edit

`antagonist --help` lists all commands; `antagonist track --help` describes one."""


@app.callback()
def _group(
    ctx: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Torque and stiffness of pneumatic-muscle joints.

    To identify a joint: `plan-joint` plans the measurement, `fit-joint` fits a joint to it, `fit-motion` fits a plant
    to a log of its motion, and `allocate`, `map`, `track`, `run` and `export` take the file with --machine. An arm is a
    MuJoCo model, --machine FILE.xml, or a file of `init --machine arm26`, for `allocate`, `map`, `track`, `run`, `tune`
    and `export`.
    """
    if ctx.invoked_subcommand is None:
        print(_FIRST)


@app.command(cls=Command, short_help="list muscles and force laws")
def muscles() -> None:
    """List the muscles that --muscle takes, and the force laws that `antagonist fit` fits."""
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
    say(console, "Forces are those at rest length. --muscle also takes a file that `antagonist fit` wrote.")


app.command("allocate", cls=Command, short_help="compute pressures for a torque and a stiffness")(allocate_command)
app.command("fit", cls=Command, short_help="fit a muscle to measured forces")(fit_command)
app.command("fit-joint", cls=Command, short_help="identify a joint from angles and pressures at rest")(
    fit_joint_command
)
app.command("fit-arm", cls=Command, short_help="find muscles and motion of an arm from its log")(fit_arm_command)


@app.command("bag", cls=Command, short_help="convert topics of a ROS bag to a CSV log")
def bag_command(
    bag: Annotated[Path, typer.Argument(help="ROS 1 .bag, .mcap, or the folder of a ROS 2 bag")],
    topics: Annotated[
        str | None,
        typer.Option(
            help="quantities and their fields; such as 'theta=/joint_states.position[0] "
            "pressure1=/valves.data[0]:bar'. Angles are in rad and pressures in Pa unless a unit follows. "
            "Without this option the topics are listed"
        ),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="CSV to write, for fit-motion, fit-joint or fit")] = None,
    force: Force = False,
) -> None:
    """Write topics of a ROS bag or an MCAP file as a CSV log.

    Each message of the first quantity gives a row with the latest messages of the others. Rows with a message older
    than a second are left out, so that a silent topic makes a gap in the log.
    """
    from rich.console import Console

    from allocator.files import bags

    console = Console()
    if topics is None:
        with bags.opened(bag) as recording:
            for name, (kind, count) in sorted(recording.topics.items()):
                say(console, f"{name}: {kind}, {count} messages")
        return
    if out is None:
        raise InvalidInput("--topics needs --out, the CSV to write")
    check_ending("--out", out, (".csv",))
    claim(out, inputs=(bag,), force=force)
    written, left = bags.to_csv(bag, bags.Quantity.parse(topics), out)
    say(
        console,
        f"written: {out}, {written} rows" + (f"; {left} without a recent message were left out" if left else ""),
    )


app.command("plan-joint", cls=Command, short_help="plan the measurement for fit-joint")(plan_joint_command)
app.command("map", cls=Command, short_help="draw the feasible angles, stiffnesses and torques")(map_command)
