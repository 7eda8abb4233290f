"""Register maps of Modbus devices: TOML files with the quantity, unit and scale of each register.

    device_id = 1            # the Modbus unit
    timeout = 0.02           # for an answer [s]; without one, the sample has no reading
    word_order = "big"       # of two registers with one number

    [read.theta]             # and [read.P1], [read.P2], if measured
    register = 0             # address on the wire, counted from 0 (4xxxx or 3xxxx in a manual: counted from 1)
    kind = "input"           # function 4; or "holding", function 3
    type = "int16"           # or uint16, int32, uint32, float32
    unit = "deg"             # or rad; of a pressure bar, mbar, kPa, MPa, Pa, psi; gauge
    scale = 0.01             # value [unit] = scale · number + offset
    offset = 0.0

    [write.P1]               # and [write.P2]: holding registers, function 16
    register = 0
    type = "uint16"
    unit = "bar"
    scale = 0.001

    [[vent]]                 # vents both muscles; without it both are commanded 0 Pa
    register = 2
    number = 0

The generic one, `generic_valve_terminal.toml` in `mpc/data/`, is a commented example to begin with.
"""

import struct
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import resources
from math import isfinite
from typing import Self

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.text import FilePath
from allocator.files.toml import Table
from allocator.identification.headers import UNITS
from mpc.bench.device import DeviceError

_FORMATS = {"int16": "h", "uint16": "H", "int32": "i", "uint32": "I", "float32": "f"}
_KINDS = ("input", "holding")
_QUANTITIES = {"theta": "theta", "P1": "pressure1", "P2": "pressure2"}
_WRITTEN = ("P1", "P2")
_LAST = 65535  # register
GENERIC = "generic_valve_terminal.toml"


@dataclass(frozen=True)
class Entry:
    """Quantity in registers: value [unit] = scale · number + offset."""

    quantity: str  # theta, P1 or P2
    register: int
    type: str = "int16"
    unit: str = ""  # the usual one of the quantity
    scale: float = 1.0
    offset: float = 0.0
    kind: str = "input"

    def __post_init__(self) -> None:
        units = UNITS[_QUANTITIES[self.quantity]]
        checks.count("register", self.register, least=0, most=_LAST)
        for name, value, among in (
            ("type", self.type, _FORMATS),
            ("kind", self.kind, _KINDS),
            ("unit", self.unit, units),
        ):
            if value not in among:
                raise InvalidInput(f"{name} = {value!r} has to be one of {', '.join(filter(None, among))}")
        for name in ("scale", "offset"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
                raise InvalidInput(f"{name} = {value!r} has to be a finite number")
        if not self.scale:
            raise InvalidInput("scale = 0 makes all numbers alike")

    @property
    def size(self) -> int:
        """Number of its registers."""
        return struct.calcsize(f">{_FORMATS[self.type]}") // 2

    def value(self, words: Sequence[int], big: bool) -> float:
        """Return the value [SI] that the registers `words` (size,) hold."""
        raw = struct.pack(f">{self.size}H", *(words if big else list(words)[::-1]))
        (number,) = struct.unpack(f">{_FORMATS[self.type]}", raw)
        return float((self.scale * number + self.offset) * self._unit)

    def words(self, value: float, big: bool) -> list[int]:
        """Return the registers (size,) that hold the `value` [SI]. Raises `DeviceError` if they cannot hold it."""
        number = (value / self._unit - self.offset) / self.scale
        code = _FORMATS[self.type]
        try:
            raw = struct.pack(f">{code}", number if code == "f" else round(number))
        except (struct.error, OverflowError):
            raise DeviceError(f"{self.quantity} = {value:g} would be {number:g}, which no {self.type} holds") from None
        words = list(struct.unpack(f">{self.size}H", raw))
        return words if big else words[::-1]

    @property
    def _unit(self) -> float:
        return UNITS[_QUANTITIES[self.quantity]][self.unit]


@dataclass(frozen=True)
class RegisterMap:
    """Registers of a device."""

    read: Mapping[str, Entry]
    write: Mapping[str, Entry]
    vent: tuple[tuple[int, int], ...] = ()  # (register, number), written in this order
    device_id: int = 1
    timeout: float = 0.02  # [s]
    word_order: str = "big"
    serial: Mapping[str, object] = field(default_factory=dict)  # of RTU: baudrate, parity, stopbits

    def __post_init__(self) -> None:
        checks.count("device_id", self.device_id, least=0, most=255)
        if not 0 < checks.number("timeout", self.timeout, "s") < 10:
            raise InvalidInput(f"timeout = {self.timeout!r} s has to be above 0 and below 10 s")
        if self.word_order not in ("big", "little"):
            raise InvalidInput(f"word_order = {self.word_order!r} has to be 'big' or 'little'")
        if "theta" not in self.read:
            raise InvalidInput("[read.theta] is missing: without its angle a joint cannot be controlled")
        if missing := [name for name in _WRITTEN if name not in self.write]:
            raise InvalidInput(f"[write.{missing[0]}] is missing")
        for register, number in self.vent:
            checks.count("register of [[vent]]", register, least=0, most=_LAST)
            checks.count("number of [[vent]]", number, least=0, most=_LAST)

    @property
    def big(self) -> bool:
        """Whether the first of two registers is the more significant one."""
        return self.word_order == "big"

    @classmethod
    def load(cls, path: FilePath) -> Self:
        """Read a map. Raises `InvalidFile`."""
        return cls._of(Table.read(path))

    @classmethod
    def generic(cls) -> Self:
        """Return the map that comes with the package."""
        file = resources.files("mpc") / "data" / GENERIC
        return cls._of(Table.parsed(GENERIC, file.read_text(encoding="utf-8")))

    @classmethod
    def _of(cls, file: Table) -> Self:
        file.only((f.name for f in fields(cls)), "a register map")
        made = {"read": _registers(file, "read", _QUANTITIES), "write": _registers(file, "write", _WRITTEN)}
        vent = tuple(step.made(_step) for step in file.each("vent"))
        return Table(file.path, {**file.entries, **made, "vent": vent}).made(cls)


def _registers(file: Table, name: str, quantities: Iterable[str]) -> dict[str, Entry]:
    """Return the entries of [read] or [write]."""
    table = file.table(name)
    if table is None:
        return {}
    table.only(quantities)
    found = {quantity: table.needed(quantity, "a register map") for quantity in table.entries}
    if unknown := [entry for entry in found.values() if "unit" not in entry.entries]:
        raise unknown[0].fault("it needs unit")
    return {quantity: entry.made(Entry, quantity=quantity) for quantity, entry in found.items()}


def _step(register: int, number: int) -> tuple[int, int]:
    return register, number
