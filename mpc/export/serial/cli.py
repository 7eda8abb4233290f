"""Command `antagonist bench-check`, and the options of a board."""

from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from allocator.errors import InvalidInput, MissingBackend
from allocator.shell.options import within
from allocator.shell.outputs import say
from allocator.units import BAR

if TYPE_CHECKING:
    from mpc.model.real_experiment import RealMachine
    from mpc.observer.kalman import KalmanObserver
    from mpc.tracking.controller import TrackingMPC

_SCHEME = "serial:"
_VARIANTS = ("controller", "terminal")


@dataclass(frozen=True)
class BoardOptions:
    """Options of a board on a serial line."""

    PANEL: ClassVar[str] = "Board"

    variant: Annotated[
        str, typer.Option(help="controller, which takes references, or terminal, which takes commands")
    ] = "controller"
    watchdog: Annotated[float, typer.Option(help="silence of the host after which the board stops [s]")] = 0.2
    fall: Annotated[
        float,
        typer.Option(
            help="rate at which the stopped board lowers the pressures [bar/s]; 0: it holds them, inf: at once"
        ),
    ] = 1.0

    def __post_init__(self) -> None:
        if self.variant not in _VARIANTS:
            raise MissingBackend("variant of the board", self.variant, _VARIANTS)

    def export(
        self,
        out: Path,
        process: "RealMachine",
        controller: "TrackingMPC | None",
        observer: "KalmanObserver | None",
        precision: str,
    ) -> Path:
        """Write the firmware and a simulated board, of the machine `process`; return `out`."""
        from mpc.export.serial.firmware import Safety, export_board

        safety = Safety(self.watchdog, self.fall * BAR)
        return export_board(
            out, process=process, controller=controller, observer=observer, safety=safety, precision=precision
        )


def bench_check_command(
    device: Annotated[
        str | None,
        typer.Argument(
            help="port of the board, e.g. serial:/dev/ttyUSB0@921600; by default a simulated board is compiled and run"
        ),
    ] = None,
    exchanges: Annotated[int, typer.Option(help="number of readings and commands to exchange")] = 500,
    timeout: Annotated[float, typer.Option(help="time to wait for an answer [s]")] = 0.02,
) -> None:
    """Check a board on a serial line: round-trip times, lost frames and the watchdog.

    Only the least pressure is commanded.
    """
    from rich.console import Console

    from mpc.bench.device import DeviceError
    from mpc.bench.devices.serial_line import open_serial
    from mpc.export.serial.check import examine
    from mpc.export.serial.simulated import SimulatedBoard

    within("--exchanges", exchanges, "", 1, 1e6)
    within("--timeout", timeout, "s", 1e-4, 10)
    if device is not None and not device.startswith(_SCHEME):
        raise InvalidInput(f"DEVICE {device!r}: expected {_SCHEME} and a port, e.g. {_SCHEME}/dev/ttyUSB0")
    console = Console()
    with SimulatedBoard() if device is None else nullcontext() as board:
        address = board.port if isinstance(board, SimulatedBoard) else str(device).removeprefix(_SCHEME)
        if device is None:
            say(console, f"simulated board: the exported C, compiled on this machine, behind {address}")
        found = examine(lambda: open_serial(address, timeout), exchanges)
    say(console, *found.lines())
    if found.faults:
        raise DeviceError(f"do not use this board: {'; '.join(found.faults)}")
