"""Corrupted bytes for both ends of a serial line, and the permitted consequences."""

import struct
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

import numpy as np

from mpc.bench.device import Clock, SimulatedClock
from mpc.bench.devices.serial_line import SerialDevice
from mpc.bench.devices.serial_protocol import (
    ANSWERS,
    JOINT,
    LAYOUTS,
    LONGEST,
    SAMPLE,
    VERSION,
    Frame,
    Kind,
    Receiver,
    Sizes,
    encoded,
    packing,
    stuffed,
)  # fmt: skip

from .toolchain import SANITISED, compiled, run

BOARD = Path(__file__).parent / "c" / "serial" / "fuzz.c"
HIGH = 5e5  # [Pa]


class Stream(NamedTuple):
    """Bytes for a board, and the intended commands (kind, pressures or reference, zeros) in them."""

    line: bytes
    meant: list[tuple[float, ...]]  # in the order of their first transmission
    whole: list[int]  # indices in `meant` of undamaged ones in a session that had begun


def board(directory: Path, *, controls: bool = False) -> Path:
    """Return the exported firmware in `directory` as a program under sanitizers that reads a file."""
    parts = [f"serial/{name}.c" for name in ("board", "frames", *(["follow"] if controls else []))]
    return compiled(directory, BOARD, "fuzzed", "-Iserial", *SANITISED, linked=tuple(parts))


def accepted(program: Path, line: bytes, sizes: Sizes = JOINT) -> np.ndarray:
    """Return the commands (n, 1 + m) that the board accepted from `line`."""
    (program.parent / "in").write_bytes(line)
    run(program, "in", "out")
    return np.fromfile(program.parent / "out").reshape(-1, 1 + sizes.muscles)


def noise(rng: np.random.Generator, n: int) -> bytes:
    """Return random bytes, a tenth of them zeros, so that frames end."""
    return np.where(rng.random(n) < 0.1, 0, rng.integers(0, 256, n)).astype(np.uint8).tobytes()


def damage(rng: np.random.Generator, line: bytes) -> bytes:
    """Return `line` with bits flipped, bytes lost, added, doubled or moved, or truncated."""
    b = bytearray(line)
    at = int(rng.integers(len(b)))
    match rng.integers(6):
        case 0:
            b[at] ^= 1 << int(rng.integers(8))
        case 1:
            b[at] = int(rng.integers(256))
        case 2:
            del b[at : at + int(rng.integers(1, 4))]
        case 3:
            b[at:at] = noise(rng, int(rng.integers(1, 6)))
        case 4:
            del b[at:]
        case _:
            other = int(rng.integers(len(b)))
            b[at], b[other] = b[other], b[at]
    return bytes(b)


def damaged(rng: np.random.Generator, n: int, *, follows: bool = False, sizes: Sizes = JOINT) -> Stream:
    """Return about `n` bytes of sessions with half of the frames damaged, some repeated, some late, amid noise."""
    line, meant, whole, earlier = bytearray(), [], [], []
    session = sequence = first = 0
    greeted = False
    while len(line) < n:
        if not line or rng.random() < 0.02:
            session, sequence, first = int(rng.integers(2**16)), int(rng.integers(2**16)), 0
            frame, greeted = encoded(Frame(Kind.HELLO, session, sequence, (VERSION,))), True
            if rng.random() < 0.2:
                frame, greeted = damage(rng, frame), False
            line += frame
        sequence = (sequence + 1) % 2**16
        numbers = _reference(sizes, len(meant)) if follows else _pressures(rng, sizes, len(meant))
        kind = Kind.FOLLOW if follows else Kind.WRITE
        values = (first,) if follows else (numbers,)
        frame = encoded(Frame(kind, session, sequence, values, numbers if follows else ()), sizes)
        meant.append((float(follows), *numbers, *(0.0,) * (sizes.muscles - len(numbers))))
        if (fine := rng.random() < 0.5) and greeted:
            whole.append(len(meant) - 1)
            first += follows
        line += frame if fine else damage(rng, frame)
        if rng.random() < 0.1 and earlier:
            line += earlier[int(rng.integers(len(earlier)))]  # a late or repeated frame
        if rng.random() < 0.1:
            line += noise(rng, int(rng.integers(1, 2 * LONGEST)))
        earlier = [*earlier[-20:], frame] if fine else earlier
    return Stream(bytes(line), meant, whole)


def _pressures(rng: np.random.Generator, sizes: Sizes, number: int) -> tuple[float, ...]:
    """Return pressures of which the first is unique."""
    rest = rng.uniform(0, HIGH, sizes.muscles - 1).astype(np.float32)
    return (float(np.float32(number)), *rest.tolist())


def _reference(sizes: Sizes, number: int) -> tuple[float, ...]:
    """Return angles, of which the first is unique, and a stiffness."""
    n = sizes.joints
    entries = [5.0 if i == j else 1.0 for i, j in zip(*np.triu_indices(n), strict=True)]
    return (float(np.float32(number / 1e6)), *(0.125,) * (n - 1), *entries)


def stiffnesses(references: np.ndarray, sizes: Sizes) -> np.ndarray:
    """Return the stiffness matrices (k, n, n) of the references (k, m) that a board accepted."""
    n, (rows, columns) = sizes.joints, np.triu_indices(sizes.joints)
    K = np.zeros((len(references), n, n))
    K[:, rows, columns] = K[:, columns, rows] = references[:, n : n + rows.size]
    return K


def forged(rng: np.random.Generator, n: int, sizes: Sizes = JOINT) -> bytes:
    """Return about `n` bytes of whole frames, of random kinds, sessions, lengths and numbers."""
    line = bytearray(encoded(Frame(Kind.HELLO, 7, 0, (VERSION,))))
    special = [struct.pack("<f", value) for value in (np.nan, np.inf, -np.inf, 0.0, 1e-40, HIGH, -1.0, 3e38, 5.0)]
    sequence = 0
    while len(line) < n:
        kind = int(rng.choice([1, 2, 3, 4, 5, int(rng.integers(256))], p=[0.06, 0.1, 0.4, 0.01, 0.33, 0.1]))
        sequence += int(rng.choice([0, 1, 2, -1, int(rng.integers(2**16))], p=[0.1, 0.74, 0.1, 0.05, 0.01]))
        words = [special[int(i)] for i in rng.integers(len(special), size=int(rng.integers(0, 40)))]
        body = b"".join(words) if rng.random() < 0.7 else noise(rng, int(rng.integers(0, LONGEST - 10)))
        if kind == Kind.WRITE and rng.random() < 0.9:
            P, layout = rng.uniform(-0.2 * HIGH, 1.2 * HIGH, sizes.muscles), packing(LAYOUTS[Kind.WRITE], sizes)
            body = (
                layout.pack(*np.clip(P, 0, HIGH) if rng.random() < 0.4 else P)
                if rng.random() < 0.5
                else body[: layout.size]
            )
        if kind == Kind.FOLLOW and rng.random() < 0.9:
            sample = packing(SAMPLE, sizes)
            two = sample.pack(*_reference(sizes, 1)) + sample.pack(*_reference(sizes, 2))
            body = body[: sample.size * (len(body) // sample.size)] if rng.random() < 0.5 else two
            body = struct.pack("<I", int(rng.choice([0, 1, 2, 5, 2**32 - 1]))) + body
        session = 7 if kind == 1 or rng.random() < 0.9 else int(rng.integers(2**16))
        said = struct.pack("<BHH", kind, session, sequence % 2**16) + (bytes([VERSION]) if kind == 1 else body)
        line += b"\0" + stuffed((said + struct.pack("<I", crc32(said)))[:253]) + b"\0"
    return bytes(line)


class NoisyLine:
    """Replacement of pyserial's port with a board behind it and nine kinds of faults between."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.carried = rng, 0
        self.said: dict[int, float] = {}  # the angle in the true answer, by sequence number
        self._waiting, self._late = bytearray(), bytearray()
        self._there = Receiver()

    @property
    def in_waiting(self) -> int:
        return len(self._waiting)

    def read(self, n: int) -> bytes:
        taken = bytes(self._waiting[:n])
        del self._waiting[:n]
        self.carried += len(taken)
        return taken

    def write(self, line: bytes) -> None:
        for request in self._there.frames(line):
            answer = self._answer(request)
            trouble = self.rng.random() if request.kind is not Kind.HELLO else 1.0
            self._waiting += self._late
            self._late.clear()
            if trouble < 0.3:
                self._waiting += damage(self.rng, answer)
            elif trouble < 0.4:
                self._late += answer
            elif trouble < 0.5:
                self._waiting += noise(self.rng, int(self.rng.integers(1, 3 * LONGEST))) + answer
            elif trouble < 0.55:
                self._waiting += answer + answer
            elif trouble < 0.6:
                self._waiting += noise(self.rng, 40)
            else:
                self._waiting += answer

    def close(self) -> None: ...

    def _answer(self, request: Frame) -> bytes:
        theta = float(np.float32(self.rng.uniform(-1, 1)))
        self.said[request.sequence] = theta
        values = {
            Kind.INFO: (VERSION, 1, 2, 0, 0, 0, 0.0, HIGH, 200_000, 1e5, 1),
            Kind.READING: (5, (theta,), (2e5, 3e5), 0, 2),
            Kind.ACCEPTED: (2,),
        }
        kind = ANSWERS[request.kind]
        return encoded(Frame(kind, request.session, request.sequence, values[kind]))


class SlowLine(NoisyLine):
    """Line without noise but with delays in both directions, to a board whose clock is fast by 100 ppm."""

    def __init__(self, rng: np.random.Generator, clock: SimulatedClock) -> None:
        super().__init__(rng)
        self.clock, self.measured = clock, 0.0

    def write(self, line: bytes) -> None:
        self._delay()
        for request in self._there.frames(line):
            self.measured = self.clock.now()
            ticks = round(1e6 * (4290.0 + 1.0001 * self.measured)) % 2**32  # which wraps after 5 s
            kind = ANSWERS[request.kind]
            values = {
                Kind.INFO: (VERSION, 1, 2, 0, 0, 0, 0.0, HIGH, 200_000, 1e5, 1),
                Kind.READING: (ticks, (0.0,), (0.0, 0.0), 0, 2),
            }
            self._waiting += encoded(Frame(kind, request.session, request.sequence, values[kind]))
        self._delay()

    def _delay(self) -> None:
        """Wait 20 µs, and every other time up to 5 ms more."""
        self.clock.spend(2e-5 + (self.rng.random() < 0.5) * self.rng.uniform(0, 5e-3))


class NoisyDevice(SerialDevice):
    """Serial device at the end of a `NoisyLine`."""

    def __init__(self, line: NoisyLine, clock: Clock | None = None) -> None:
        super().__init__("a noisy line", timeout=2e-4, clock=clock)
        self.line = line

    def _opened(self) -> NoisyLine:
        return self.line

    @property
    def asked(self) -> int:
        """Sequence number of the last request."""
        return self._sequence
