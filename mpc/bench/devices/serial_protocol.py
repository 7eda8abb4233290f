"""Line protocol between a host and a board: constants, layout of the frames, coding.

`docs/serial.md` explains it; `mpc.export.serial.firmware` prints these tables as the C header of the firmware.

    on the line   0x00, COBS(payload), 0x00
    payload       kind u8, session u16, sequence u16, body, CRC-32 of all before it u32; little endian

A board has n encoders and m pressures, which it reports in INFO; a joint has n = 1 and m = 2. A stiffness has
s = n (n + 1) / 2 numbers: K11, K12, ..., K22, ...

COBS (Cheshire and Baker 1999, IEEE/ACM Trans. Networking 7(2)) removes every zero from a payload, so that a zero on the
line always ends a frame: after any loss or addition of bytes, both ends agree again at the next zero. The CRC is that
of IEEE 802.3, as in zlib.
"""

import struct
from collections.abc import Iterable, Iterator, Mapping
from enum import IntEnum
from functools import lru_cache
from typing import NamedTuple, TypeAlias
from zlib import crc32

from allocator.errors import InvalidInput

VERSION = 2
LONGEST = 253  # bytes of a payload at most; below 254, so that COBS adds a single byte
_BATCH = 16  # samples of reference in a frame at most


class Kind(IntEnum):
    """Kind of a frame: a request of the host, or an answer of the board."""

    HELLO = 0x01
    READ = 0x02
    WRITE = 0x03
    VENT = 0x04
    FOLLOW = 0x05
    INFO = 0x81
    READING = 0x82
    ACCEPTED = 0x83
    TRACKING = 0x85
    REFUSED = 0xFF


ANSWERS: Mapping[int, Kind] = {
    Kind.HELLO: Kind.INFO,
    Kind.READ: Kind.READING,
    Kind.WRITE: Kind.ACCEPTED,
    Kind.VENT: Kind.ACCEPTED,
    Kind.FOLLOW: Kind.TRACKING,
}  # or REFUSED


class State(IntEnum):
    """State of a board; in all but two states the pressures fall to the least."""

    IDLE = 0  # no session since it was switched on
    READY = 1  # a session, and no command in it yet
    DIRECT = 2  # the valves obey WRITE
    FOLLOWING = 3  # the valves obey the controller on the board
    TRIPPED = 4  # the host fell silent; only a new session ends this
    VENTED = 5  # the host said VENT; only a new session ends this


class Refusal(IntEnum):
    """Reason for which a board refused a request."""

    VERSION = 1
    SESSION = 2
    STALE = 3
    VALUE = 4
    SAFE = 5
    UNKNOWN = 6
    GAP = 7


REASONS: Mapping[int, str] = {
    Refusal.VERSION: "it speaks another version of the protocol",
    Refusal.SESSION: "it knows of no such session: it was switched off and on, or another program has opened it",
    Refusal.STALE: "the request was older than one that it has answered",
    Refusal.VALUE: "a pressure or a reference was beyond its limits, no number, or no stiffness that holds the joints",
    Refusal.SAFE: "it is in its safe state (the host was silent for too long, or said VENT) until a new session begins",
    Refusal.UNKNOWN: "it does not know this request",
    Refusal.GAP: "references were left out, or more were sent than it can hold",
}


class Sizes(NamedTuple):
    """Sizes of a board."""

    joints: int = 1  # n
    muscles: int = 2  # m

    def count(self, row: str) -> int:
        """Return the numbers in a `row` of n, m or s; 1 for "", which is no row."""
        return {"n": self.joints, "m": self.muscles, "s": self.joints * (self.joints + 1) // 2, "": 1}[row]

    @property
    def batch(self) -> int:
        """Samples of reference in a frame at most."""
        free = LONGEST - packing(HEADER, self).size - packing(LAYOUTS[Kind.FOLLOW], self).size - CRC_BYTES
        return min(_BATCH, free // packing(SAMPLE, self).size)

    @property
    def fit(self) -> bool:
        """Whether all frames are short enough."""
        longest = max(packing(fields, self).size for fields in LAYOUTS.values())
        return packing(HEADER, self).size + longest + CRC_BYTES <= LONGEST and self.batch >= 1

    def check(self) -> None:
        """Raise `InvalidInput` for a machine whose frames would be too long."""
        if not self.fit:
            raise InvalidInput(
                f"a board for n = {self.joints} joints and m = {self.muscles} muscles would need frames of over "
                f"{LONGEST} bytes"
            )


JOINT = Sizes()


class Field(NamedTuple):
    """Number in a frame's body, or a row of them."""

    name: str
    type: str  # of `TYPES`
    meaning: str
    row: str = ""  # "n", "m" or "s" numbers; "": one


TYPES: Mapping[str, str] = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "f32": "f"}  # names in `struct`

_STATE = Field("state", "u8", "State")
_VERSION = Field("version", "u8", "of the protocol")
_MEASURED = (
    Field("t", "u32", "clock of the board, which begins anew after 2^32 [us]"),
    Field("theta", "f32", "joint angles, NaN if not measured [rad]", "n"),
    Field("P", "f32", "gauge pressures, of a joint those of agonist and antagonist, or NaN [Pa]", "m"),
    Field("damaged", "u16", "frames that came damaged to the board, modulo 2^16"),
)
HEADER = (
    Field("kind", "u8", "Kind"),
    Field("session", "u16", "chosen by the host at random"),
    Field("sequence", "u16", "one more at every request; an answer repeats it"),
)
LAYOUTS: Mapping[Kind, tuple[Field, ...]] = {
    Kind.HELLO: (_VERSION,),
    Kind.READ: (),
    Kind.WRITE: (Field("P", "f32", "commands, gauge [Pa]", "m"),),
    Kind.VENT: (),
    Kind.FOLLOW: (Field("first", "u32", "number of the first of the samples that follow, `SAMPLE` each"),),
    Kind.INFO: (
        _VERSION,
        Field("joints", "u8", "n"),
        Field("muscles", "u8", "m"),
        Field("ahead", "u16", "samples of reference that the controller wants after the present one"),
        Field("room", "u16", "samples of reference that the board can hold; 0: it has no controller"),
        Field("dt", "u32", "sample time of the controller, or 0 [us]"),
        Field("low", "f32", "least command [Pa]"),
        Field("high", "f32", "greatest command [Pa]"),
        Field("watchdog", "u32", "silence of the host after which the pressures fall [us]"),
        Field("fall", "f32", "how fast the highest one then falls [Pa/s]"),
        _STATE,
    ),
    Kind.READING: (*_MEASURED, _STATE),
    Kind.ACCEPTED: (_STATE,),
    Kind.TRACKING: (
        *_MEASURED,
        Field("u", "f32", "commanded pressures [Pa]", "m"),
        Field("sample", "u32", "number of the sample of reference that is followed now"),
        Field("next", "u32", "number of the sample of reference that the board wants next"),
        Field("status", "i8", "of the last plan, as PlanStatus"),
        Field("rung", "i8", "of the last plan, as Rung"),
        Field("running", "u8", "1 once there were enough samples for the controller to begin"),
        _STATE,
    ),
    Kind.REFUSED: (Field("reason", "u8", "Refusal"), _STATE),
}
SAMPLE = (
    Field("theta", "f32", "reference of the angles [rad]", "n"),
    Field("K", "f32", "reference of the stiffness, upper triangle [N*m/rad]", "s"),
)
CRC_BYTES = 4


@lru_cache(maxsize=256)
def packing(fields: tuple[Field, ...], sizes: Sizes = JOINT) -> struct.Struct:
    """Return the `struct` format of `fields`."""
    return struct.Struct("<" + "".join(f"{sizes.count(field.row)}{TYPES[field.type]}" for field in fields))


_HEADER = packing(HEADER)
_CRC = struct.Struct("<I")
_KINDS = frozenset(int(kind) for kind in Kind)

Value: TypeAlias = float | tuple[float, ...]  # a number or a row of them


class Frame(NamedTuple):
    """Message from one end to the other."""

    kind: Kind
    session: int
    sequence: int
    values: tuple[Value, ...] = ()  # the fields of its layout
    samples: tuple[float, ...] = ()  # of FOLLOW: θ (n,) [rad] and K (s,) [N·m/rad] of each

    def number(self, name: str) -> float:
        """Return the number in the field called `name`."""
        found = self._value(name)
        assert not isinstance(found, tuple)
        return found

    def row(self, name: str) -> tuple[float, ...]:
        """Return the row of numbers in the field called `name`."""
        found = self._value(name)
        assert isinstance(found, tuple)
        return found

    def _value(self, name: str) -> Value:
        return self.values[[field.name for field in LAYOUTS[self.kind]].index(name)]


def encoded(frame: Frame, sizes: Sizes = JOINT) -> bytes:
    """Return the bytes of `frame` on the line, from or to a board of these `sizes`."""
    body = packing(LAYOUTS[frame.kind], sizes).pack(*_flat(frame.values))
    samples = struct.pack(f"<{len(frame.samples)}f", *frame.samples)
    payload = _HEADER.pack(frame.kind, frame.session, frame.sequence) + body + samples
    return b"\0" + stuffed(payload + _CRC.pack(crc32(payload))) + b"\0"


def decoded(stretch: bytes, sizes: Sizes = JOINT) -> Frame | None:
    """Return the frame in a `stretch` of the line between two zeros; None if that is not a whole, undamaged one."""
    payload = unstuffed(stretch)
    if payload is None or not _HEADER.size + CRC_BYTES <= len(payload) <= LONGEST:
        return None
    said, (crc,) = payload[:-CRC_BYTES], _CRC.unpack(payload[-CRC_BYTES:])
    if crc32(said) != crc:
        return None
    number, session, sequence = _HEADER.unpack_from(said)
    if number not in _KINDS:
        return None
    kind, body = Kind(number), said[_HEADER.size :]
    layout = packing(LAYOUTS[kind], sizes)
    rest = len(body) - layout.size
    if rest < 0 or (rest and kind is not Kind.FOLLOW) or rest % packing(SAMPLE, sizes).size:
        return None
    values = _grouped(layout.unpack_from(body), LAYOUTS[kind], sizes)
    return Frame(kind, session, sequence, values, struct.unpack_from(f"<{rest // 4}f", body, layout.size))


def _flat(values: Iterable[Value]) -> Iterator[float]:
    for value in values:
        yield from value if isinstance(value, tuple) else (value,)


def _grouped(numbers: tuple[float, ...], fields: tuple[Field, ...], sizes: Sizes) -> tuple[Value, ...]:
    """Return the values of `fields` with these `numbers`."""
    each = iter(numbers)
    return tuple(tuple(next(each) for _ in range(sizes.count(f.row))) if f.row else next(each) for f in fields)


def stuffed(payload: bytes) -> bytes:
    """Return `payload`, at most 253 bytes of it, without zeros   (COBS)"""
    parts = payload.split(b"\0")
    return b"".join(bytes([len(part) + 1]) + part for part in parts)


def unstuffed(stretch: bytes) -> bytes | None:
    """Return the payload that `stuffed` turns into `stretch`; None if there is none."""
    parts = []
    at = 0
    while at < len(stretch):
        length = stretch[at]
        if length == 0 or length == 0xFF or at + length > len(stretch):
            return None
        parts.append(stretch[at + 1 : at + length])
        at += length
    return b"\0".join(parts) if parts else None


class Receiver:
    """Receiver that finds frames in arriving bytes, and counts damaged stretches."""

    def __init__(self, sizes: Sizes = JOINT) -> None:
        self.sizes = sizes  # of the board; its INFO has the same layout for all
        self.damaged = 0  # stretches without a frame
        self._open = bytearray()  # since the last zero
        self._lost = False  # more than any frame can be

    def frames(self, arrived: bytes) -> Iterator[Frame]:
        """Yield the frames that end within `arrived`."""
        for byte in arrived:
            if byte:
                self._lost = self._lost or len(self._open) > LONGEST
                if not self._lost:
                    self._open.append(byte)
                continue
            frame = None if self._lost else decoded(bytes(self._open), self.sizes)
            if self._lost or self._open:
                self.damaged += frame is None
            self._open.clear()
            self._lost = False
            if frame is not None:
                yield frame
