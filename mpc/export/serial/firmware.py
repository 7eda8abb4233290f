"""Firmware of a board on a serial line: its safety, its files, and files that simulate the board on a PC.

protocol.h is generated from the tables of `mpc.bench.devices.serial_protocol`.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from math import isfinite
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from allocator.units import BAR
from mpc.bench.devices import serial_protocol as protocol
from mpc.bench.devices.serial_protocol import Field, Sizes
from mpc.export import text
from mpc.export.building import check, write
from mpc.export.entry import controller_files, pair
from mpc.export.joint import Numbers
from mpc.export.parts import Files, copied, filled, is_single, names_of
from mpc.export.plant import plant_files, real_machine, start_of
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real_experiment import RealMachine
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

_LONGEST = 1e3  # [s] of a watchdog; the board's clock wraps after 4295 s


@dataclass(frozen=True)
class Safety:
    """Behaviour of a board without messages from its host."""

    watchdog: float = 0.2  # silence after which the pressures fall [s]
    fall: float = 1 * BAR  # rate at which the highest one falls [Pa/s]; 0: all are held, inf: at once

    def __post_init__(self) -> None:
        """Check both values. Raises InvalidInput."""
        watchdog = checks.positive("watchdog", self.watchdog, "s")
        if not 1e-3 <= watchdog <= _LONGEST:
            raise InvalidInput(f"watchdog = {watchdog:g} s has to be between 0.001 and {_LONGEST:g} s")
        fall = checks.number_or_inf("fall", self.fall, "Pa/s")
        if not fall >= 0 or (isfinite(fall) and 0 < fall < BAR / 1e3):
            raise InvalidInput(f"fall = {fall:g} Pa/s has to be 0 (hold), inf (at once) or 100 Pa/s at least")


_SUDDEN = float(np.finfo(np.float32).max)  # [Pa/s] of a fall at once
_SAMPLES = 3  # least silence before a watchdog acts
_SPARE = 32  # samples of reference that the host may send beyond the horizon
PLANT_DT = 1e-3  # [s] step of the simulated plant


def firmware_files(machine: Machine, safety: Safety, controller: TrackingMPC | None = None) -> Files:
    """Return the board's own files, for commands within the supply of `machine`; with a `controller` it follows
    references.

    Raises `InvalidInput` for a watchdog that trips although the host sends a message every sample, and for a machine
    with too many joints or muscles.
    """
    sizes, limits = Sizes(machine.n, machine.m), machine.pressure_limits
    sizes.check()
    if controller is not None and safety.watchdog < _SAMPLES * controller.dt:
        raise InvalidInput(
            f"watchdog = {safety.watchdog:g} s has to be {_SAMPLES} samples of {controller.dt:g} s or more: a host "
            "that sends a message every sample may be a little late"
        )
    files = {
        name: content for name, content in copied("serial", "serial/") if controller is not None or "follow" not in name
    }
    return files | {
        "serial/protocol.h": protocol_header(sizes),
        "serial/config.h": _config(sizes, limits, safety, controller),
        "serial/README.md": firmware_readme(machine, safety, controller),
    }


def simulation_files(process: RealMachine, x0: Array) -> Files:
    """Return the additional files of a simulated board, with the machine `process` and its initial state `x0`
    (2n + m,).
    """
    numbers = ", ".join(number(float(value), single=False) for value in x0)
    start = f"#define ANT_START {{{numbers}}} /* angles [rad], rates [rad/s], pressures [Pa] */"
    return {
        **dict(copied("simulated", "simulated/")),
        **plant_files(process, PLANT_DT, "simulated/"),
        "simulated/start.h": text.header("ANT_START_H", "Initial state of the simulated machine.", start),
    }


def _config(sizes: Sizes, limits: tuple[float, float], safety: Safety, controller: TrackingMPC | None) -> str:
    low, high = limits
    numbers: Numbers = {
        "LOW": (float(low), "least command [Pa]"),
        "HIGH": (float(high), "greatest command [Pa]"),
        "FALL": (safety.fall, "rate at which the highest pressure falls in the safe state; 0: all are held [Pa/s]"),
    }
    lines = [text.defines(numbers, single=True)]
    lines.append(
        _whole("WATCHDOG_US", round(safety.watchdog * 1e6), "silence of the host that leads to the safe state [us]")
    )
    included = ["antagonist_config.h"]
    if controller is None:
        included = []
        lines.append(f"#define ANT_JOINTS {sizes.joints}\n#define ANT_MUSCLES {sizes.muscles}")
    else:
        lines.append("#define ANT_BOARD_CONTROLS /* the board has the controller */")
        lines.append(_whole("TICK_US", round(controller.dt * 1e6), "sample time of the controller [us]"))
        lines.append(_whole("ROOM", controller.ahead + 1 + _SPARE, "samples of reference that the board can hold"))
    body = "\n".join(lines).replace("ANT_INFINITY", "INFINITY")
    return text.header("ANT_CONFIG_H", "Choices at export.", body, included + ["math.h"] * ("INFINITY" in body))


def _whole(name: str, value: int, meaning: str) -> str:
    return f"#define ANT_{name} {value}u /* {meaning} */"


def protocol_header(sizes: Sizes) -> str:
    """Return protocol.h: constants, and the positions of the fields of every frame of a board of these `sizes`."""
    parts = [
        _defines("version and sizes [bytes, samples]", _sizes(sizes)),
        *(_enumerated(kind) for kind in (protocol.Kind, protocol.State, protocol.Refusal)),
        _layout("HEADER", protocol.HEADER, sizes),
        *(_layout(kind.name, fields, sizes) for kind, fields in protocol.LAYOUTS.items()),
        _layout("SAMPLE", protocol.SAMPLE, sizes),
    ]
    about = "The line protocol, generated from the host's tables. Offsets count from the beginning of a body."
    return text.header("ANT_PROTOCOL_H", about, "\n".join(parts))


def _sizes(sizes: Sizes) -> dict[str, int]:
    return {
        "PROTOCOL": protocol.VERSION,
        "LONGEST": protocol.LONGEST,
        "CRC_BYTES": protocol.CRC_BYTES,
        "BATCH": sizes.batch,
    }


def _defines(about: str, values: dict[str, int]) -> str:
    return f"/* {about} */\n" + "".join(f"#define ANT_{name} {value}\n" for name, value in values.items())


def _enumerated(kind: type[IntEnum]) -> str:
    """Return a C enumeration, with the first line of the Python docstring as its comment."""
    about = (kind.__doc__ or "").splitlines()[0]
    name = kind.__name__
    members = ",\n".join(f"    ANT_{name.upper()}_{member.name} = {member.value}" for member in kind)
    return f"/* {about} */\ntypedef enum {{\n{members}\n}} ant_{name.lower()};\n"


def _layout(name: str, fields: Iterable[Field], sizes: Sizes) -> str:
    """Return the positions of `fields`, and their total number of bytes."""
    lines, at = [], 0
    for field in fields:
        row = f"{sizes.count(field.row)} times " * bool(field.row)
        lines.append(f"    ANT_{name}_{field.name.upper()} = {at}, /* {row}{field.type}, {field.meaning} */")
        at += protocol.packing((field,), sizes).size
    lines.append(f"    ANT_{name}_BYTES = {at}")
    return "enum {\n" + "\n".join(lines) + "\n};\n"


_TERMINAL = "a terminal: it sends the sensor readings and sets the valves to the host's commands"
_CONTROLLER = "a board with the whole controller; the host sends only references (and, optionally, commands)"
_PACE = """\
The controller takes a step every {dt:g} s. Bytes that arrive meanwhile wait in the buffer behind `receive_byte`:
{bytes} bytes are enough at 115200 baud.
"""


def firmware_readme(machine: Machine, safety: Safety, controller: TrackingMPC | None) -> str:
    """Return serial/README.md."""
    (low, high), (joints, muscles) = machine.pressure_limits, names_of(machine)
    if safety.fall == 0:
        fall = "the pressures are held"
    elif safety.fall > _SUDDEN:
        fall = "all pressures fall to the least at once"
    else:
        fall = f"the highest pressure falls by {safety.fall:g} Pa/s, and the others in proportion"
    controls = controller is not None
    pace = _PACE.format(dt=controller.dt, bytes=int(11520 * controller.dt) + protocol.LONGEST) if controller else ""
    return filled(
        "board",
        variant=_CONTROLLER if controls else _TERMINAL,
        version=protocol.VERSION,
        joints=", ".join(joints),
        muscles=", ".join(muscles),
        low=low,
        high=high,
        watchdog=safety.watchdog,
        fall=fall,
        pace=pace,
        cc="cc -O2 -std=c99 -I. -Isrc -Iserial" if controls else "cc -O2 -std=c99 -I. -Iserial",
        sources=" src/*.c" if controls else "",
        shared="serial/board.c serial/frames.c" + (" serial/follow.c" if controls else ""),
    )


def export_board(
    out: str | PathLike[str],
    *,
    process: Machine | RealMachine | None = None,
    controller: TrackingMPC | None = None,
    observer: KalmanObserver | None = None,
    safety: Safety | None = None,
    precision: str = "double",
    x0: ArrayLike | None = None,
) -> Path:
    """Write the firmware of a board to the directory `out`, and return it.

    Parameters
    ----------
    process
        Joint or arm of the simulated board; commands have to lie within its supply. By default the controller's plant,
        or `Plant()`.
    controller, observer
        Controller on the board; without one the board is a terminal.
    safety
        Behaviour of the board without a host, by default `Safety()`.
    precision
        Precision of the controller, "double" or "single".
    x0
        Initial state (2n + m,) of the simulated plant: angles [rad], rates [rad/s], pressures [Pa]; by default at rest
        in the middle of the ranges.

    Raises
    ------
    InvalidInput
        For settings that C does not support (see `mpc.export.export`), a process of other sizes than the controller's
        machine, a bad `x0`, and a directory that is not empty. Nothing is written then.
    MissingBackend
        For an unknown `precision`.
    """
    single = is_single(precision)
    check(Path(out))
    return write(board_files(process, controller, observer, safety or Safety(), single, x0), out)


def board_files(
    process: Machine | RealMachine | None,
    controller: TrackingMPC | None,
    observer: KalmanObserver | None,
    safety: Safety,
    single: bool = False,
    x0: ArrayLike | None = None,
) -> Files:
    """Return the files of the firmware and of the simulated board; see `export_board`."""
    real = simulated_machine(process, controller)
    files: Files = {}
    if controller is not None:
        files = controller_files(*pair(None, controller, observer), single, alone=True)
    files |= firmware_files(real.nominal, safety, controller)
    return files | simulation_files(real, start_of(real, x0))


def simulated_machine(process: Machine | RealMachine | None, controller: TrackingMPC | None) -> RealMachine:
    """Return the machine of the simulated board; see `export_board`."""
    if controller is not None:
        checks.instance("controller", controller, TrackingMPC, "a TrackingMPC")
    if process is None:
        process = Plant() if controller is None else controller.plant
    real = real_machine(process)
    sizes, controlled = Sizes(real.nominal.n, real.nominal.m), real.nominal if controller is None else controller.plant
    if sizes != (controlled.n, controlled.m):
        raise InvalidInput(
            f"process has n = {sizes.joints} and m = {sizes.muscles}, the controller's machine n = {controlled.n} and "
            f"m = {controlled.m}"
        )
    return real
