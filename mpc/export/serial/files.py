"""The files of a board's firmware are gathered here, and those of its simulation on a PC."""

import numpy as np
from numpy.typing import ArrayLike

from allocator.compilation.printer import number
from allocator.errors import InvalidInput
from mpc.export import text
from mpc.export.joint import Numbers
from mpc.export.parts import Files, copied
from mpc.export.plant import plant_files, real_plant
from mpc.export.serial.protocol import protocol_header
from mpc.export.serial.readme import firmware_readme
from mpc.export.serial.safety import Safety
from mpc.model.plant import Plant
from mpc.model.real_plant import RealPlant
from mpc.tracking.controller import TrackingMPC

_SAMPLES = 3  # that a watchdog waits for at least
_SPARE = 32  # samples of reference that the host may be ahead of what the controller needs
PLANT_DT = 1e-3  # [s] by which the simulated plant goes on


def firmware_files(limits: tuple[float, float], safety: Safety, controller: TrackingMPC | None = None) -> Files:
    """Return the board's own files, for commands within `limits` [Pa]; with a `controller` it follows references.

    Raises `InvalidInput` for a watchdog that a host could not keep quiet, saying something every sample.
    """
    if controller is not None and safety.watchdog < _SAMPLES * controller.dt:
        raise InvalidInput(
            f"watchdog = {safety.watchdog:g} s has to be {_SAMPLES} samples of {controller.dt:g} s or more: a host "
            "that says something every sample may be a little late"
        )
    files = {
        name: content for name, content in copied("serial", "serial/") if controller is not None or "follow" not in name
    }
    return files | {
        "serial/protocol.h": protocol_header(),
        "serial/config.h": _config(limits, safety, controller),
        "serial/README.md": firmware_readme(limits, safety, controller),
    }


def simulation_files(process: Plant | RealPlant, x0: ArrayLike) -> Files:
    """Return what makes a program for the PC of a board's files, with `process` under it, which begins in `x0` (4,)."""
    numbers = ", ".join(number(float(value), single=False) for value in np.asarray(x0))
    start = f"#define ANT_START {{{numbers}}} /* theta [rad], its rate [rad/s], P1, P2 [Pa] */"
    return {
        **dict(copied("simulated", "simulated/")),
        **plant_files(real_plant(process), PLANT_DT, "simulated/"),
        "simulated/start.h": text.header("ANT_START_H", "Where the simulated joint begins.", start),
    }


def _config(limits: tuple[float, float], safety: Safety, controller: TrackingMPC | None) -> str:
    low, high = limits
    numbers: Numbers = {
        "LOW": (float(low), "least command [Pa]"),
        "HIGH": (float(high), "greatest command [Pa]"),
        "FALL": (safety.fall, "how fast the higher pressure falls in the safe state; 0: both are held [Pa/s]"),
    }
    lines = [text.defines(numbers, single=True)]
    lines.append(_whole("WATCHDOG_US", round(safety.watchdog * 1e6), "silence of the host after which they do [us]"))
    if controller is not None:
        lines.append("#define ANT_BOARD_CONTROLS /* it has the controller */")
        lines.append(_whole("TICK_US", round(controller.dt * 1e6), "sample time of the controller [us]"))
        lines.append(_whole("ROOM", controller.ahead + 1 + _SPARE, "samples of reference that it can hold"))
    body = "\n".join(lines).replace("ANT_INFINITY", "INFINITY")
    return text.header("ANT_CONFIG_H", "What was chosen at export.", body, ["math.h"] if "INFINITY" in body else [])


def _whole(name: str, value: int, meaning: str) -> str:
    return f"#define ANT_{name} {value}u /* {meaning} */"
