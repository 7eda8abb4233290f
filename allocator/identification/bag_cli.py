"""Command `antagonist bag`: export of a robot's recorded topics to a CSV for the fits."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from allocator.errors import InvalidInput
from allocator.files import bags
from allocator.shell.outputs import Force, check_ending, claim, say


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
