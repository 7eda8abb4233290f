"""Registry of devices by name, of this project and of other packages.

A package adds devices by an entry point of the group `antagonist.devices`. Its name is the part before the first colon
of `--device NAME:ADDRESS`, and its object maps the rest to a device, `(address: str) -> Device`. `antagonist devices`
shows the first line of its docstring:

    [project.entry-points."antagonist.devices"]
    acme = "acme_valves:open_for_antagonist"
"""

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import NamedTuple

from allocator.errors import InvalidInput, MissingBackend
from mpc.bench.device import Device
from mpc.bench.devices.own import own_device

GROUP = "antagonist.devices"
_OURS = {
    "sim": "mpc.bench.devices.simulated:open_simulated",
    "modbus": "mpc.bench.devices.modbus:open_modbus",
    "serial": "mpc.bench.devices.serial_line:open_serial",
}


class Kind(NamedTuple):
    """Kind of device: a name, and a function that makes one from an address."""

    name: str
    entry: EntryPoint
    brought_by: str  # the distribution, "" for this one

    @property
    def summary(self) -> str:
        """One line with its description, or the reason why it cannot be used."""
        try:
            return (self.load().__doc__ or "").strip().partition("\n")[0]
        except (ImportError, AttributeError) as error:
            return f"cannot be loaded ({error})"

    def load(self) -> Callable[[str], Device]:
        """Return its function."""
        module, _, name = self.entry.value.partition(":")
        function: Callable[[str], Device] = getattr(import_module(module), name)
        return function


def kinds() -> Mapping[str, Kind]:
    """Return all kinds of devices by name; other packages cannot replace those of this project."""
    brought = {
        entry.name: Kind(entry.name, entry, entry.dist.name if entry.dist else "")
        for entry in entry_points(group=GROUP)
    }
    return brought | {name: Kind(name, EntryPoint(name, value, GROUP), "") for name, value in _OURS.items()}


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
        make = known[name].load()
    except (ImportError, AttributeError) as error:
        raise InvalidInput(f"device {spec!r}: {known[name].entry.value} cannot be loaded ({error})") from None
    return make(address)
