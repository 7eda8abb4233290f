"""`antagonist export` writes allocator and controller as C. Heavy libraries load when it runs."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from allocator.errors import MissingBackend
from allocator.shell.options import grouped
from allocator.shell.printing import say
from allocator.units import BAR
from mpc.export.serial.safety import Safety
from mpc.plant_cli import PlantOptions

if TYPE_CHECKING:
    from mpc.model.compensation import Compensation
    from mpc.model.plant import Plant

TARGETS = ("c", "serial")


@grouped
def export_command(
    out: Annotated[Path, typer.Option(help="new or empty directory for the C files")],
    options: PlantOptions,
    what: Annotated[str, typer.Option(help="allocate, mpc or all")] = "all",
    precision: Annotated[str, typer.Option(help="double, or single for an FPU without double")] = "double",
    horizon: Annotated[int, typer.Option(help="samples of 10 ms that the controller looks ahead")] = 10,
    target: Annotated[str, typer.Option(help="c, or serial: with the firmware of a board on a serial line")] = "c",
    variant: Annotated[
        str, typer.Option(help="of that board: controller, which takes references, or terminal, which takes commands")
    ] = "controller",
    watchdog: Annotated[float, typer.Option(help="silence of the host after which that board acts [s]")] = 0.2,
    fall: Annotated[
        float, typer.Option(help="how fast it then lets the pressures fall [bar/s]; 0: it holds them, inf: at once")
    ] = 1.0,
) -> None:
    """Write allocator and controller as plain C99, for a microcontroller or a real-time PC."""
    from rich.console import Console

    from mpc.export.entry import default_controller, export

    console = Console()
    if target not in TARGETS:
        raise MissingBackend("target", target, TARGETS)
    plant = options.plant()
    known = options.compensation()
    if target == "serial":
        made = _board(out, plant, known, variant, precision, horizon, Safety(watchdog, fall * BAR))
        say(console, f"written: {_count(made)} files in {made}; {made / 'serial' / 'README.md'} says what to do")
        return
    controller = None if what == "allocate" else default_controller(plant, horizon, known)
    made = export(out, joint=plant.joint, controller=controller, what=what, precision=precision)
    if controller is not None:
        say(console, f"plant: {plant.summary}")
        if known.summary:
            say(console, f"told to the controller: {known.summary}")
    say(console, f"written: {_count(made)} files in {made}; {made / 'README.md'} says how to build them")


def _board(
    out: Path, plant: "Plant", known: "Compensation", variant: str, precision: str, horizon: int, safety: Safety
) -> Path:
    from mpc.export.entry import default_controller
    from mpc.export.serial.entry import VARIANTS, export_board

    if variant not in VARIANTS:
        raise MissingBackend("variant of the board", variant, VARIANTS)
    controller = default_controller(plant, horizon, known) if variant == "controller" else None
    return export_board(out, process=plant, controller=controller, safety=safety, precision=precision)


def _count(directory: Path) -> int:
    return sum(path.is_file() for path in directory.rglob("*"))


__all__ = ["export_command"]
