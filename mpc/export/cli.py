"""`antagonist export`: allocator and controller as C. Heavy libraries load when it runs."""

from pathlib import Path
from typing import Annotated

import typer

from allocator.cli import JOINT, MUSCLE, REPORT_MUSCLE, chosen_joint


def export_command(
    out: Annotated[Path, typer.Option(help="new or empty directory for the C files")],
    what: Annotated[str, typer.Option(help="allocate, mpc or all")] = "all",
    precision: Annotated[str, typer.Option(help="double, or single for an FPU without double")] = "double",
    horizon: Annotated[int, typer.Option(help="samples of 10 ms that the controller looks ahead")] = 10,
    muscle: Annotated[str, MUSCLE] = REPORT_MUSCLE,
    joint: Annotated[Path | None, JOINT] = None,
) -> None:
    """Write allocator and controller as plain C99, for a microcontroller or a real-time PC."""
    from rich.console import Console

    from mpc.export.entry import default_controller, export

    chosen = chosen_joint(muscle, joint)
    controller = None if what == "allocate" else default_controller(chosen, horizon)
    made = export(out, joint=chosen, controller=controller, what=what, precision=precision)
    files = sum(path.is_file() for path in made.rglob("*"))
    Console().print(
        f"written: {files} files in {made}; {made / 'README.md'} says how to build them", highlight=False, markup=False
    )


__all__ = ["export_command"]
