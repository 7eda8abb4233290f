"""The README of a board's firmware is written here."""

from mpc.bench.devices import serial_protocol as protocol
from mpc.export.serial.safety import Safety
from mpc.tracking.controller import TrackingMPC

_HEAD = """\
# A board on a serial line

Exported from the Python package `antagonist`: firmware in portable C99, without a heap, for
{variant}.
It talks to `mpc.bench.devices.serial_line.SerialDevice` and to `antagonist run --device serial:/dev/ttyUSB0`; the
project's `docs/serial.md` documents the line protocol (version {version}).

**Yours to fill in** are the five functions of `port.c`: `read_sensors`, `write_valves`, a microsecond clock, and the
bytes of the UART. `port.h` says what is asked of them, `config.h` what was chosen at export: commands within {low:g} to
{high:g} Pa, a watchdog of {watchdog:g} s, after which {fall}.
Call `ant_board_poll` as often as you can, as `main.c` does; it never waits.
{pace}
    {cc} serial/*.c{sources} -lm -o firmware

compiles it for the PC, to see that it does; with your microcontroller's compiler it is the same line.

**A board to try hosts on**, the same C behind a pseudo-terminal of Linux, with a simulated joint under it:

    {cc} -Isimulated simulated/*.c {shared}{sources} -lm -o simulated_board
    ./simulated_board

It prints the name of its port, e.g. `/dev/pts/3`; `antagonist bench-check serial:/dev/pts/3` examines it as it does a
real one. `antagonist bench-check` alone does all of this by itself.
"""

_TERMINAL = "a dumb terminal: it sends what the sensors say and sets the valves as the host commands"
_CONTROLLER = (
    "a board with the whole controller on it, which the host sends references alone (and, if it likes, commands)"
)
_PACE = """\
A step of the controller is to be taken every {dt:g} s, and bytes that arrive meanwhile have to wait in the buffer
behind `receive_byte`: {bytes} bytes of it are enough at 115200 baud.
"""


def firmware_readme(limits: tuple[float, float], safety: Safety, controller: TrackingMPC | None) -> str:
    """Return serial/README.md."""
    low, high = limits
    if safety.fall == 0:
        fall = "the pressures are held"
    else:
        fall = f"the higher pressure falls by {safety.fall:g} Pa/s, and the other in proportion"
    controls = controller is not None
    pace = _PACE.format(dt=controller.dt, bytes=int(11520 * controller.dt) + protocol.LONGEST) if controller else ""
    return _HEAD.format(
        variant=_CONTROLLER if controls else _TERMINAL,
        version=protocol.VERSION,
        low=low,
        high=high,
        watchdog=safety.watchdog,
        fall=fall,
        pace=pace,
        cc="cc -O2 -std=c99 -I. -Isrc -Iserial" if controls else "cc -O2 -std=c99 -I. -Iserial",
        sources=" src/*.c" if controls else "",
        shared="serial/board.c serial/frames.c" + (" serial/follow.c" if controls else ""),
    )
