"""The command `antagonist bench-check` is here. Heavy libraries load when it runs."""

from contextlib import nullcontext
from typing import Annotated

import typer

from allocator.errors import InvalidInput
from allocator.shell.options import within
from allocator.shell.printing import say

_SCHEME = "serial:"


def bench_check_command(
    device: Annotated[
        str | None, typer.Argument(help="e.g. serial:/dev/ttyUSB0; without it a simulated board is compiled and run")
    ] = None,
    baud: Annotated[int, typer.Option(help="of the serial line")] = 115200,
    exchanges: Annotated[int, typer.Option(help="readings and commands to exchange")] = 500,
    timeout: Annotated[float, typer.Option(help="for which an answer is waited [s]")] = 0.02,
) -> None:
    """Check a board on a serial line: round trips, lost frames, and whether its watchdog works.

    Nothing but the least pressure is commanded.
    """
    from rich.console import Console

    from mpc.bench.device import DeviceError
    from mpc.bench.serial_device import SerialDevice
    from mpc.export.serial.check import examine
    from mpc.export.serial.simulated import SimulatedBoard

    within("--exchanges", exchanges, "", 1, 1e6)
    within("--timeout", timeout, "s", 1e-4, 10)
    if device is not None and not device.startswith(_SCHEME):
        raise InvalidInput(f"DEVICE {device!r}: expected {_SCHEME} and a port, e.g. {_SCHEME}/dev/ttyUSB0")
    console = Console()
    with SimulatedBoard() if device is None else nullcontext() as board:
        port = board.port if isinstance(board, SimulatedBoard) else str(device).removeprefix(_SCHEME)
        if device is None:
            say(console, f"simulated board: the exported C, compiled here, behind {port}")
        found = examine(lambda: SerialDevice(port, baud=baud, timeout=timeout), exchanges)
    for line in found.lines():
        say(console, line)
    if found.faults:
        raise DeviceError(f"do not use this board: {'; '.join(found.faults)}")


__all__ = ["bench_check_command"]
