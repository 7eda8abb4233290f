"""`antagonist export` writes allocator and controller as C. Heavy libraries load when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from allocator.shell.options import grouped
from allocator.shell.printing import say
from mpc.plant_cli import PlantOptions


@grouped
def export_command(
    out: Annotated[Path, typer.Option(help="new or empty directory for the C files")],
    options: PlantOptions,
    what: Annotated[str, typer.Option(help="allocate, mpc or all")] = "all",
    precision: Annotated[str, typer.Option(help="double, or single for an FPU without double")] = "double",
    horizon: Annotated[int, typer.Option(help="samples of 10 ms that the controller looks ahead")] = 10,
) -> None:
    """Write allocator and controller as plain C99, for a microcontroller or a real-time PC."""
    from rich.console import Console

    from mpc.export.entry import default_controller, export

    console = Console()
    plant = options.plant()
    known = options.compensation()
    controller = None if what == "allocate" else default_controller(plant, horizon, known)
    made = export(out, joint=plant.joint, controller=controller, what=what, precision=precision)
    if controller is not None:
        say(console, f"plant: {plant.summary}")
        if known.summary:
            say(console, f"told to the controller: {known.summary}")
    files = sum(path.is_file() for path in made.rglob("*"))
    say(console, f"written: {files} files in {made}; {made / 'README.md'} says how to build them")


__all__ = ["export_command"]
