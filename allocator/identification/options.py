"""Options of the commands that read measured data."""

from typing import Annotated

import typer

SkipRows = Annotated[
    int, typer.Option("--skip-rows", min=0, help="Leave out so many lines at the beginning of the file.")
]
DropSpikes = Annotated[
    bool,
    typer.Option(
        "--drop-spikes",
        help="Leave out the rows of a log in which a reading jumps there and back, drops out, or is missing.",
    ),
]
