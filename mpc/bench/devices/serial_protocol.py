"""Line protocol between a host and a board: constants, layout of the frames, coding.

`docs/serial.md` explains it; `mpc.export.serial.firmware` prints these tables as the C header of the firmware.

    on the line   0x00, COBS(payload), 0x00
    payload       kind u8, session u16, sequence u16, body, CRC-32 of all before it u32; little endian

COBS (Cheshire and Baker 1999, IEEE/ACM Trans. Networking 7(2)) removes every zero from a payload, so that a zero on the
line always ends a frame: after any loss or addition of bytes, both ends agree again at the next zero. The CRC is that
of IEEE 802.3, as in zlib.
"""

import struct
from collections.abc import Iterator, Mapping
from enum import IntEnum
from typing import NamedTuple
from zlib import crc32

VERSION = 1
LONGEST = 200  # bytes of a payload at most; below 254, so that COBS adds a single byte
BATCH = 16  # samples of reference in a frame at most


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
    Refusal.VALUE: "a pressure or a reference was beyond its limits, or no number",
    Refusal.SAFE: "it is in its safe state (the host was silent for too long, or said VENT) until a new session begins",
    Refusal.UNKNOWN: "it does not know this request",
    Refusal.GAP: "references were left out, or more were sent than it can hold",
}


class Field(NamedTuple):
    """Number in a frame's body."""

    name: str
    type: str  # of `TYPES`
    meaning: str


TYPES: Mapping[str, str] = {"u8": "B", "i8": "b", "u16": "H", "u32": "I", "f32": "f"}  # names in `struct`

_STATE = Field("state", "u8", "State")
_VERSION = Field("version", "u8", "of the protocol")
_MEASURED = (
    Field("t", "u32", "clock of the board, which begins anew after 2^32 [us]"),
    Field("theta", "f32", "joint angle, NaN if it is not measured [rad]"),
    Field("P1", "f32", "gauge pressure of the agonist, or NaN [Pa]"),
    Field("P2", "f32", "gauge pressure of the antagonist, or NaN [Pa]"),
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
    Kind.WRITE: (
        Field("P1", "f32", "command for the agonist, gauge [Pa]"),
        Field("P2", "f32", "command for the antagonist, gauge [Pa]"),
    ),
    Kind.VENT: (),
    Kind.FOLLOW: (Field("first", "u32", "number of the first of the samples that follow, `SAMPLE` each"),),
    Kind.INFO: (
        _VERSION,
        Field("ahead", "u16", "samples of reference that the controller wants after the present one"),
        Field("room", "u16", "samples of reference that the board can hold; 0: it has no controller"),
        Field("dt", "u32", "sample time of the controller, or 0 [us]"),
        Field("low", "f32", "least command [Pa]"),
        Field("high", "f32", "greatest command [Pa]"),
        Field("watchdog", "u32", "silence of the host after which the pressures fall [us]"),
        Field("fall", "f32", "how fast the higher one then falls [Pa/s]"),
        _STATE,
    ),
    Kind.READING: (*_MEASURED, _STATE),
    Kind.ACCEPTED: (_STATE,),
    Kind.TRACKING: (
        *_MEASURED,
        Field("u1", "f32", "commanded to the agonist [Pa]"),
        Field("u2", "f32", "commanded to the antagonist [Pa]"),
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
    Field("theta", "f32", "reference of the angle [rad]"),
    Field("K", "f32", "reference of the stiffness [N*m/rad]"),
)
CRC_BYTES = 4


def packing(fields: tuple[Field, ...]) -> struct.Struct:
    """Return the `struct` format of `fields`."""
    return struct.Struct("<" + "".join(TYPES[field.type] for field in fields))


_HEADER, _SAMPLE = packing(HEADER), packing(SAMPLE)
_BODIES = {kind: packing(fields) for kind, fields in LAYOUTS.items()}
_CRC = struct.Struct("<I")


class Frame(NamedTuple):
    """Message from one end to the other."""

    kind: Kind
    session: int
    sequence: int
    values: tuple[float, ...] = ()  # the fields of its layout; of FOLLOW also θ [rad] and K [N·m/rad] of each sample

    def value(self, name: str) -> float:
        """Return the value of the field called `name`."""
        return self.values[[field.name for field in LAYOUTS[self.kind]].index(name)]


def encoded(frame: Frame) -> bytes:
    """Return the bytes of `frame` on the line."""
    fields = len(LAYOUTS[frame.kind])
    body = _BODIES[frame.kind].pack(*frame.values[:fields])
    samples = struct.pack(f"<{len(frame.values) - fields}f", *frame.values[fields:])
    payload = _HEADER.pack(frame.kind, frame.session, frame.sequence) + body + samples
    return b"\0" + stuffed(payload + _CRC.pack(crc32(payload))) + b"\0"


def decoded(stretch: bytes) -> Frame | None:
    """Return the frame in a `stretch` of the line between two zeros; None if that is not a whole, undamaged one."""
    payload = unstuffed(stretch)
    if payload is None or not _HEADER.size + CRC_BYTES <= len(payload) <= LONGEST:
        return None
    said, (crc,) = payload[:-CRC_BYTES], _CRC.unpack(payload[-CRC_BYTES:])
    if crc32(said) != crc:
        return None
    number, session, sequence = _HEADER.unpack_from(said)
    body = said[_HEADER.size :]
    if number not in _KINDS or len(body) < (size := _BODIES[Kind(number)].size):
        return None
    rest = len(body) - size
    if rest % _SAMPLE.size or (rest and number != Kind.FOLLOW):
        return None
    values = _BODIES[Kind(number)].unpack_from(body) + struct.unpack_from(f"<{rest // 4}f", body, size)
    return Frame(Kind(number), session, sequence, values)


_KINDS = frozenset(int(kind) for kind in Kind)


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

    def __init__(self) -> None:
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
            frame = None if self._lost else decoded(bytes(self._open))
            if self._lost or self._open:
                self.damaged += frame is None
            self._open.clear()
            self._lost = False
            if frame is not None:
                yield frame
