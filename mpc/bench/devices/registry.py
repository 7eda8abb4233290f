"""Registry of devices by name, of this project and of other packages.

A package adds devices by an entry point of the group `antagonist.devices`. Its name is the part before the first colon
of `--device NAME:ADDRESS`, and its object maps the rest to a device, `(address: str) -> Device`. `antagonist devices`
shows the first line of its docstring:

    [project.entry-points."antagonist.devices"]
    acme = "acme_valves:open_for_antagonist"

`--device MODULE:FUNCTION` calls a function of one's own, without arguments.
"""

import os
import sys
from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from traceback import extract_tb
from typing import Any, NamedTuple

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput, MissingBackend
from mpc.bench.device import Device
from mpc.bench.stops import said

GROUP = "antagonist.devices"
_OURS = {
    "sim": "mpc.bench.devices.simulated:open_simulated",
    "modbus": "mpc.bench.devices.modbus:open_modbus",
    "serial": "mpc.bench.devices.serial_line:open_serial",
}


class Kind(NamedTuple):
    """Kind of device: the entry point of a function that makes one from an address."""

    entry: EntryPoint
    brought_by: str  # the distribution, "" for this one

    @property
    def summary(self) -> str:
        """One line with its description, or the reason why it cannot be used."""
        try:
            return (self.entry.load().__doc__ or "").strip().partition("\n")[0]
        except (ImportError, AttributeError) as error:
            return f"cannot be loaded ({error})"


def kinds() -> Mapping[str, Kind]:
    """Return all kinds of devices by name; other packages cannot replace those of this project."""
    brought = {entry.name: Kind(entry, entry.dist.name if entry.dist else "") for entry in entry_points(group=GROUP)}
    return brought | {name: Kind(EntryPoint(name, value, GROUP), "") for name, value in _OURS.items()}


def open_device(spec: str) -> Device:
    """Return the device that `spec` describes, NAME, NAME:ADDRESS or MODULE:FUNCTION; it connects when it is entered.

    Raises `MissingBackend` for an unknown name, `InvalidInput` for an invalid address, a package that cannot be loaded,
    and a function that returns no device.
    """
    name, _, address = spec.partition(":")
    known = kinds()
    if name not in known:
        if address.isidentifier() and all(map(str.isidentifier, name.split("."))):
            return own_device(name, address, known)
        raise MissingBackend("device", name, [*known, "MODULE:FUNCTION"])
    try:
        make: Callable[[str], Device] = known[name].entry.load()
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"device {spec!r}: {known[name].entry.value} cannot be loaded ({error})") from None
    return make(address)


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
