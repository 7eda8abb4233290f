"""Valve terminals with Modbus TCP or RTU, with a `RegisterMap` of their registers.

The module needs pymodbus (`pip install 'antagonist[modbus]'`). `NoAnswer` is a late or missing answer, an exception of
the device, or an answer to another request (of another function, to another register). The next call then opens a new
connection, so that a late answer cannot be mistaken for that of another request. A failed connection is a `DeviceLost`.

Register maps of Modbus devices: TOML files with the quantity, unit and scale of each register.

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

import re
import struct
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from importlib import resources
from math import isfinite, nan
from types import ModuleType
from typing import TYPE_CHECKING, Self, TypeAlias

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.text import FilePath
from allocator.files.toml import Table
from allocator.identification.headers import UNITS
from mpc.bench.device import Clock, DeviceError, DeviceLost, MonotonicClock, NoAnswer, Reading

if TYPE_CHECKING:
    from pymodbus.client import ModbusSerialClient, ModbusTcpClient
    from pymodbus.pdu import ModbusPDU

    Client: TypeAlias = ModbusTcpClient | ModbusSerialClient


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
        checks.count("register", self.register, least=0, most=_LAST)
        choices = {"type": _FORMATS, "kind": _KINDS, "unit": UNITS[_QUANTITIES[self.quantity]]}
        for name, known in choices.items():
            if (value := getattr(self, name)) not in known:
                raise InvalidInput(f"{name} = {value!r} has to be one of {', '.join(filter(None, known))}")
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


PORT = 502
_ADDRESS = re.compile(r"(?P<place>[^:]+)(:(?P<port>[^:./\\]+))?(:(?P<map>.+\.toml))?")
_MOST = 125  # registers of a request
_READ = {"holding": 3, "input": 4}  # function codes
_WRITE = 16


class ModbusDevice:
    """Modbus device with the connection object of pymodbus that `client()` returns (`tcp`, `rtu`)."""

    def __init__(self, client: Callable[[], "Client"], registers: RegisterMap, clock: Clock | None = None) -> None:
        self._make, self.registers = client, registers
        self._clock: Clock = MonotonicClock() if clock is None else clock
        self._client: Client = None
        self._requests = [_request(kind, registers) for kind in ("input", "holding")]

    @classmethod
    def tcp(cls, host: str, port: int = PORT, registers: RegisterMap | None = None, clock: Clock | None = None) -> Self:
        """Return the device at this address, with the generic map if none is given. Raises `MissingPackage`."""
        client, known = _pymodbus().ModbusTcpClient, RegisterMap.generic() if registers is None else registers
        return cls(lambda: client(host, port=port, timeout=known.timeout, retries=0), known, clock)

    @classmethod
    def rtu(cls, port: str, registers: RegisterMap | None = None, clock: Clock | None = None) -> Self:
        """Return the device on this serial port, with the generic map if none is given. Raises `MissingPackage`."""
        client, known = _pymodbus().ModbusSerialClient, RegisterMap.generic() if registers is None else registers
        return cls(lambda: client(port, timeout=known.timeout, retries=0, **known.serial), known, clock)

    def __enter__(self) -> Self:
        """Connect. Raises `DeviceLost`."""
        self._client = self._make()
        self._connect()
        return self

    def __exit__(self, *raised: object) -> None:
        self._client.close()

    def read(self) -> Reading:
        """Read all registers, in one request if they are neighbours of one kind."""
        values = {"theta": nan, "P1": nan, "P2": nan}
        for request in self._requests:
            for first, count, entries in request:
                words = self._words(entries[0].kind, first, count)
                for entry in entries:
                    at = entry.register - first
                    values[entry.quantity] = entry.value(words[at : at + entry.size], self.registers.big)
        return Reading(self._clock.now(), values["theta"], (values["P1"], values["P2"]))

    def write(self, *P: float) -> None:
        """Command both pressures [Pa], in one request if the registers are neighbours."""
        places = self.registers.write["P1"], self.registers.write["P2"]
        blocks = sorted(
            (place.register, place.words(value, self.registers.big)) for place, value in zip(places, P, strict=True)
        )
        (first, words), (second, more) = blocks
        if first + len(words) == second:
            blocks = [(first, words + more)]
        for register, numbers in blocks:
            self._write(register, numbers)

    def vent(self) -> None:
        """Write the registers that vent both muscles."""
        if not self.registers.vent:
            self.write(0.0, 0.0)
        for register, number in self.registers.vent:
            self._write(register, [number])

    # --- requests ---------------------------------------------------------------------------------------------------

    def _words(self, kind: str, first: int, count: int) -> list[int]:
        ask = self._connected.read_input_registers if kind == "input" else self._connected.read_holding_registers
        answer = self._answer(lambda: ask(first, count=count, device_id=self.registers.device_id), _READ[kind])
        words = answer.registers
        if len(words) != count:
            raise self._not_meant(f"{len(words)} registers were answered, not {count}")
        return list(words)

    def _write(self, register: int, numbers: list[int]) -> None:
        client = self._connected
        ask = partial(client.write_registers, register, numbers, device_id=self.registers.device_id)
        answer = self._answer(ask, _WRITE)
        if (answer.address, answer.count) != (register, len(numbers)):
            raise self._not_meant(f"{answer.count} registers from {answer.address} on were written")

    def _answer(self, ask: "Callable[[], ModbusPDU]", function: int) -> "ModbusPDU":
        """Return the answer to a request of this `function` code. Raises `NoAnswer`."""
        from pymodbus.exceptions import ModbusException

        try:
            answer = ask()
        except (ModbusException, OSError) as error:
            self._client.close()  # a late answer must not be taken for the next one
            raise NoAnswer(f"no answer ({error})") from None
        if answer.isError():
            raise NoAnswer(f"the device refused: {answer}")
        if answer.function_code != function:
            raise self._not_meant(f"the answer is of function {answer.function_code}, not {function}")
        return answer

    def _not_meant(self, why: str) -> NoAnswer:
        """Return the error for an answer to another request; later answers on this connection are not trusted."""
        self._client.close()
        return NoAnswer(f"the device answered another request: {why}")

    @property
    def _connected(self) -> "Client":
        if self._client is None:
            raise DeviceError("the Modbus device is not connected: use it as a context, `with device:`")
        if not self._client.connected:
            self._connect()
        return self._client

    def _connect(self) -> None:
        if not self._client.connect():
            raise DeviceLost(f"no connection to {self._client.comm_params.host}")


def _request(kind: str, registers: RegisterMap) -> list[tuple[int, int, list[Entry]]]:
    """Return (first register, number, entries) of the requests that read all registers of a kind."""
    requests: list[tuple[int, int, list[Entry]]] = []
    for entry in sorted((e for e in registers.read.values() if e.kind == kind), key=lambda e: e.register):
        if requests:
            first, count, entries = requests[-1]
            needed = max(first + count, entry.register + entry.size) - first
            if entry.register <= first + count and needed <= _MOST:
                requests[-1] = first, needed, [*entries, entry]
                continue
        requests.append((entry.register, entry.size, [entry]))
    return requests


def _pymodbus() -> ModuleType:
    import pymodbus.client

    found: ModuleType = pymodbus.client
    return found


def open_modbus(address: str) -> ModbusDevice:
    """Drive a Modbus valve terminal: modbus:HOST[:PORT][:MAP.toml], or modbus:/dev/tty…[:MAP.toml] for RTU."""
    parts = _ADDRESS.fullmatch(address)
    if parts is None or parts["place"].endswith(".toml"):  # a map alone
        raise InvalidInput(f"device modbus:{address}: expected HOST:PORT or /dev/ttyUSB0, and then :MAP.toml")
    place, port, file = parts["place"], parts["port"] or str(PORT), parts["map"]
    known = RegisterMap.generic() if file is None else RegisterMap.load(file)
    if place.startswith("/") or re.fullmatch(r"COM\d+", place, re.IGNORECASE):
        return ModbusDevice.rtu(place, known)
    if not port.isdecimal() or not 0 < int(port) < 65536:
        raise InvalidInput(f"device modbus:{address}: {port!r} is no port, 1 to 65535")
    return ModbusDevice.tcp(place, int(port), known)
