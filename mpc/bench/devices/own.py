"""Devices of one's own, `--device MODULE:FUNCTION`: the function takes no arguments and returns a `Device`."""

import os
import sys
from collections.abc import Callable, Iterable
from importlib import import_module
from pathlib import Path
from traceback import extract_tb
from typing import Any

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from mpc.bench.device import Device
from mpc.bench.stops import said


def own_device(module: str, function: str, known: Iterable[str]) -> Device:
    """Return the device that `function` makes; `known` are the names of other devices, for messages.

    The module is one of an installed package, or else a file in the current folder. Raises `InvalidInput` if it cannot
    be imported, has no such function, or makes no device.
    """
    if (folder := os.getcwd()) not in sys.path:
        sys.path.append(folder)  # last, so that a file of the user hides no package
    name = f"{module}:{function}"
    try:
        imported = import_module(module)
    except ModuleNotFoundError as error:
        if error.name is None or not f"{module}.".startswith(f"{error.name}."):
            raise InvalidInput(f"device {name!r}: {module} needs {error.name}, which is not installed") from error
        there = f"{', '.join(sorted(known))} and the modules of this folder and of installed packages"
        raise InvalidInput(f"device {name!r}: there is no module {error.name}; known are {there}") from None
    except Exception as error:
        raise InvalidInput(f"device {name!r}: importing {module} raised {_located(error)}") from error
    device = _made(name, getattr(imported, function, None))
    checks.instance(f"device {name!r}: {function}()", device, Device, "a device, such as a CallableDevice")
    return device


def _made(name: str, make: Callable[[], Any] | None) -> Device:
    """Return the result of the function `make` with this name. Raises `InvalidInput`."""
    module, _, function = name.partition(":")
    if not callable(make):
        lacks = f"has no function {function}" if make is None else f"has {function}, which is not a function"
        raise InvalidInput(f"device {name!r}: {module} {lacks}")
    try:
        made: Device = make()
    except AntagonistError:
        raise
    except Exception as error:
        raise InvalidInput(f"device {name!r}: {function}() raised {_located(error)}") from error
    return made


def _located(error: Exception) -> str:
    """Return type and message of an exception, and the line of the file that raised it, unless it names that itself."""
    frame = extract_tb(error.__traceback__)[-1]
    place = "" if frame.filename.startswith("<") else f" ({Path(frame.filename).name}, line {frame.lineno})"
    return said(error) + place
