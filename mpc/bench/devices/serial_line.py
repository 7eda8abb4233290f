"""Device of a board on a serial line, with the protocol of `serial_protocol`; see docs/serial.md.

    with SerialDevice("/dev/ttyUSB0", baud=921600) as device:
        reading = device.read()

Every call sends one request and waits until `timeout` for the answer with its sequence number: late answers are
skipped, and noise affects only one exchange. After `NoAnswer`, continue with the next sample. After `DeviceLost`, stop,
because the board has let the pressures fall or will do so by itself.
"""

import os
import time
from collections.abc import Iterator
from contextlib import suppress
from math import inf
from secrets import randbelow
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.bench.device import Clock, DeviceError, DeviceLost, MonotonicClock, NoAnswer, Reading
from mpc.bench.devices import serial_protocol as protocol
from mpc.bench.devices.serial_protocol import JOINT, Frame, Kind, Receiver, Refusal, Sizes
from mpc.model.experiment import check_stiffness
from mpc.trials.motions.reference import Reference

if TYPE_CHECKING:
    from serial import Serial

BAUD = 115200
TIMEOUT = 0.02  # [s]
_POLL = 0.002  # [s] longest wait for a byte: resolution of a time-out
_GREETING = 0.1  # [s] after which a greeting is repeated
_VENT_TRIES, _VENT_WAIT = 5, 0.05  # tries of a vent, and duration of each [s]
_DRIFT = 2e-4  # greatest drift of a board's clock against this computer's [-]
_LAST = 2**32 - 1  # number of a sample at most
_MOST = float(np.finfo(np.float32).max)  # [N·m/rad] of a stiffness in a frame
_LASTING = (Refusal.SAFE, Refusal.SESSION, Refusal.VERSION)  # refusals that the next request would get as well

_SYSTEM_ERRORS: tuple[type[Exception], ...] = (OSError,)  # exceptions of pyserial when a port does not work
with suppress(ImportError):  # on Windows
    from termios import error

    _SYSTEM_ERRORS = OSError, error

_OPENING_ERRORS: tuple[type[Exception], ...] = (*_SYSTEM_ERRORS, ValueError)
_READING_ERRORS: tuple[type[Exception], ...] = (*_SYSTEM_ERRORS, TypeError)  # closed by another thread while it reads


class BoardInfo(NamedTuple):
    """Description that a board sends in reply to HELLO."""

    joints: int  # n encoders
    muscles: int  # m pressures
    ahead: int  # samples of reference that its controller needs after the present one
    room: int  # samples of reference that it can hold; 0: it has no controller
    dt: float  # sample time of its controller [s], or 0
    low: float  # least command [Pa]
    high: float  # greatest command [Pa]
    watchdog: float  # silence of the host after which the pressures fall [s]
    fall: float  # rate at which the highest one then falls [Pa/s]


class Tracking(NamedTuple):
    """State of a board whose controller follows references."""

    reading: Reading
    u: tuple[float, ...]  # (m,) commanded now [Pa]
    sample: int  # of the reference that is followed now
    next: int  # sample of reference that the board needs next
    status: int  # `PlanStatus` of the last plan
    rung: int  # `Rung` of the last plan
    running: bool  # whether there were enough samples for the controller to begin


class SerialDevice:
    """Board at a serial port (`/dev/ttyUSB0`, `COM3`, or a URL of pyserial), of a joint or an arm."""

    def __init__(
        self,
        port: str,
        *,
        baud: int = BAUD,
        timeout: float = TIMEOUT,
        connect: float = 3.0,
        clock: Clock | None = None,
    ) -> None:
        """Describe the line; the context manager connects the device.

        `timeout` [s] limits the wait for an answer, `connect` [s] the time of a board to begin; `clock` times the
        readings. Raises `InvalidInput`.
        """
        self.port, self.baud = port, checks.count("baud", baud, least=1)
        self.timeout = checks.positive("timeout", timeout, "s")
        self.connect = checks.positive("connect", connect, "s")
        self.info = BoardInfo(0, 0, 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0)
        self.state = 0  # `State` of the board in its last answer
        self.unanswered = self.late = self.damaged_there = 0  # since connecting
        self.board_time = 0.0  # clock of the board at the last reading, since the first [s]
        self._receiver = Receiver()
        self._clock: Clock = MonotonicClock() if clock is None else clock
        self._line: Serial | None = None
        self._session = self._sequence = 0
        self._ticks: int | None = None  # [us]
        self._unsure, self._apart, self._dated_at = inf, 0.0, 0.0  # of both clocks [s]

    @property
    def damaged(self) -> int:
        """Number of received stretches without a frame since connecting."""
        return self._receiver.damaged

    @property
    def sizes(self) -> Sizes:
        """Joints and muscles of the connected board."""
        return self._receiver.sizes

    # --- a device ---------------------------------------------------------------------------------------------------

    def read(self) -> Reading:
        """Return a new reading, dated by the board's clock. Raises `NoAnswer` or `DeviceLost`."""
        asked = self._clock.now()
        return self._reading(self._ask(Kind.READ), asked)

    def write(self, *P: float) -> None:
        """Send the gauge pressures [Pa] as a command, one a muscle.

        Raises `InvalidInput` for another number of them and beyond the board's limits, `NoAnswer`, and `DeviceLost`,
        also if the board is in its safe state, which only a new connection ends.
        """
        if self._line is not None and len(P) != self.info.muscles:
            raise InvalidInput(f"write: {len(P)} pressures for the {self.info.muscles} of the board at {self.port}")
        pressures = tuple(checks.floats("P", P, "Pa").tolist())
        for j, pressure in enumerate(pressures, 1):
            if not self.info.low <= np.float32(pressure) <= self.info.high:
                raise InvalidInput(
                    f"P{j} = {pressure:g} Pa has to lie within the {self.info.low:g} to {self.info.high:g} Pa of the "
                    f"board at {self.port}"
                )
        self._ask(Kind.WRITE, pressures)

    def vent(self) -> None:
        """Vent all muscles at once; the board takes no command afterwards. Raises `DeviceError`."""
        for left in reversed(range(_VENT_TRIES)):
            try:
                self._ask(Kind.VENT, timeout=_VENT_WAIT)
                return
            except NoAnswer:
                if not left:
                    raise

    def __enter__(self) -> Self:
        """Open the port and begin a session. Raises `DeviceError`, and `MissingPackage` without pyserial."""
        self._line = self._opened()
        self._receiver, self._ticks, self.board_time = Receiver(), None, 0.0
        self._unsure, self._apart, self._dated_at = inf, 0.0, self._clock.now()
        self.unanswered = self.late = 0
        self._session, self._sequence = randbelow(2**16), randbelow(2**16)
        try:
            self.info = self._greet()
        except BaseException:
            self.__exit__()
            raise
        self.unanswered = 0
        return self

    def __exit__(self, *raised: object) -> None:
        """Close the port; a board that still obeys lets the pressures fall after its watchdog's time."""
        line, self._line = self._line, None
        if line is not None:
            try:
                line.close()
            except _SYSTEM_ERRORS:  # a lost port cannot be closed
                return

    # --- the controller on the board --------------------------------------------------------------------------------

    def follow(self, first: int, theta: ArrayLike, K: ArrayLike) -> Tracking:
        """Send samples of reference from number `first` on; none keep it going.

        They are angles θ (k,) or (k, n) [rad] and stiffnesses K (k,) or (k, n, n) [N·m/rad]; `sizes.batch` is for how
        many there is room. Raises `InvalidInput` for others and for a board without a controller, `NoAnswer`,
        `DeviceLost`.
        """
        self._check_controller()
        samples = self._samples(theta, K)
        if len(samples) > self.sizes.batch:
            raise InvalidInput(f"theta and K have to be at most {self.sizes.batch} samples each")
        return self._follow(checks.count("first", first, 0, _LAST), samples)

    def _check_controller(self) -> None:
        if not self.info.room:
            raise InvalidInput(f"the board at {self.port} has no controller; export one with --variant controller")

    def _follow(self, first: int, samples: Array) -> Tracking:
        asked = self._clock.now()
        answer = self._ask(Kind.FOLLOW, first, samples=tuple(samples.ravel().tolist()))
        sample, next_, status, rung = (int(answer.number(name)) for name in ("sample", "next", "status", "rung"))
        reading, u = self._reading(answer, asked), answer.row("u")
        return Tracking(reading, u, sample, next_, status, rung, bool(answer.number("running")))

    def _samples(self, theta: ArrayLike, K: ArrayLike) -> Array:
        """Return samples of reference, a row of numbers each. Raises `InvalidInput`."""
        n = self.info.joints
        angles = checks.angle("theta", theta)
        stiffness = checks.real("K", K, "N·m/rad")
        count = len(angles) if angles.ndim else -1
        if angles.size != count * n or stiffness.size != count * n * n:
            raise InvalidInput(
                f"theta and K of shapes {angles.shape} and {stiffness.shape} are no samples for the n = {n} "
                f"joint{'s' * (n > 1)} of the board at {self.port}"
            )
        matrices = stiffness.reshape(count, n, n)
        check_stiffness("K", matrices, "N·m/rad")
        if (matrices > _MOST).any():
            raise InvalidInput(f"K has to be at most {_MOST:g} N·m/rad")
        rows, columns = np.triu_indices(n)
        return np.hstack([angles.reshape(count, n), matrices[:, rows, columns]])

    def track(self, reference: Reference) -> Iterator[Tracking]:
        """Have the board follow `reference`, and yield its state about once per sample.

        The clock is the board's. A failed exchange is repeated as long as the board's watchdog allows. Raises
        `InvalidInput` before anything is sent, `NoAnswer`, `DeviceLost`.
        """
        checks.instance("reference", reference, Reference, "a Reference")
        self._check_controller()
        wanted = reference.resampled(self.info.dt)
        samples = self._samples(wanted.theta, wanted.K)
        last = len(samples) - 1
        next_, room, said = 0, self.info.room, time.monotonic()
        while True:
            until = min(next_ + self.sizes.batch, room, last + self.info.ahead + 1)
            numbers = [min(k, last) for k in range(next_, until)]
            began = self._clock.now()
            try:
                now = self._follow(next_, samples[numbers])
            except NoAnswer:
                if time.monotonic() - said > self.info.watchdog:
                    raise
                continue
            next_, room, said = now.next, now.sample + self.info.room, time.monotonic()
            yield now
            if now.sample >= last:
                return
            if now.running and len(numbers) < self.sizes.batch:  # its buffer is full
                self._clock.sleep_until(began + self.info.dt)

    # --- exchanges --------------------------------------------------------------------------------------------------

    def _ask(
        self,
        kind: Kind,
        *values: protocol.Value,
        samples: tuple[float, ...] = (),
        timeout: float | None = None,
    ) -> Frame:
        """Return the answer to a request; `DeviceLost` or `NoAnswer` if there is none or it is a refusal."""
        self._sequence = (self._sequence + 1) % 2**16
        number = self._sequence
        answers = protocol.ANSWERS[kind], Kind.REFUSED
        patience = self.timeout if timeout is None else timeout
        deadline = time.monotonic() + patience
        self._send(protocol.encoded(Frame(kind, self._session, number, values, samples), self.sizes))
        while True:
            come = list(self._receiver.frames(self._arrived()))
            meant = [f for f in come if (f.session, f.sequence) == (self._session, number) and f.kind in answers]
            self.late += len(come) - len(meant)
            if meant:
                return self._accepted(meant[0])
            if time.monotonic() >= deadline:
                self.unanswered += 1
                raise NoAnswer(f"the board at {self.port} did not answer within {1e3 * patience:g} ms")

    def _accepted(self, answer: Frame) -> Frame:
        self.state = int(answer.number("state"))
        if answer.kind is not Kind.REFUSED:
            return answer
        reason = int(answer.number("reason"))
        sentence = f"the board at {self.port} refused: {protocol.REASONS.get(reason, f'reason {reason}')}"
        raise (DeviceLost if reason in _LASTING else NoAnswer)(sentence)

    def _greet(self) -> BoardInfo:
        deadline = time.monotonic() + self.connect
        while True:
            try:
                answer = self._ask(Kind.HELLO, protocol.VERSION, timeout=_GREETING)
            except NoAnswer:
                if time.monotonic() < deadline:
                    continue
                raise DeviceError(
                    f"nothing at {self.port} ({self.baud} baud) answered within {self.connect:g} s as a board of "
                    "`antagonist export firmware` does"
                ) from None
            numbers: dict[str, Any] = {name: answer.number(name) for name in BoardInfo._fields}
            info = BoardInfo(**numbers | {"dt": numbers["dt"] / 1e6, "watchdog": numbers["watchdog"] / 1e6})
            self._check(info, int(answer.number("version")))
            self._receiver.sizes = Sizes(info.joints, info.muscles)
            return info

    def _check(self, info: BoardInfo, version: int) -> None:
        """Raise `DeviceError` for a board whose description makes no sense."""
        sizes = Sizes(info.joints, info.muscles)
        wrong = (
            (version != protocol.VERSION, f"version {version} of the protocol, not {protocol.VERSION}"),
            (not (min(sizes) > 0 and sizes.fit), f"{info.joints} joints and {info.muscles} muscles"),
            (not -inf < info.low < info.high < inf, f"commands from {info.low:g} to {info.high:g} Pa"),
            (not info.watchdog > 0, f"a watchdog of {info.watchdog:g} s"),
            (info.room > 0 and not info.dt > 0, f"a controller with samples of {info.dt:g} s"),
        )
        if found := [words for is_wrong, words in wrong if is_wrong]:
            raise DeviceError(f"the board at {self.port} describes itself with {' and '.join(found)}; flash it again")

    def _reading(self, answer: Frame, asked: float) -> Reading:
        come, ticks = self._clock.now(), int(answer.number("t"))
        if self._ticks is not None:
            self.board_time += 1e-6 * ((ticks - self._ticks) % 2**32)
        self._ticks = ticks
        self.damaged_there = int(answer.number("damaged"))
        theta = answer.row("theta")
        angles = theta[0] if self.sizes == JOINT else np.array(theta)
        return Reading(self._dated(asked, come), angles, answer.row("P"))

    def _dated(self, asked: float, come: float) -> float:
        """Return the time [s] at which the board read its sensors, between request and answer.

        The fastest exchange determines the offset of the clocks best; this estimate ages as the clocks drift.
        """
        self._unsure += _DRIFT * (come - self._dated_at)
        self._dated_at = come
        if come - asked <= self._unsure:
            self._unsure, self._apart = come - asked, (asked + come) / 2 - self.board_time
        return min(max(self.board_time + self._apart, asked), come)

    # --- the line ---------------------------------------------------------------------------------------------------

    def _opened(self) -> "Serial":
        import serial

        try:
            line = serial.serial_for_url(
                self.port, baudrate=self.baud, timeout=min(_POLL, self.timeout), write_timeout=max(0.1, self.timeout)
            )
            line.reset_input_buffer()
        except _OPENING_ERRORS as error:
            why = os.strerror(error.errno) if isinstance(error, OSError) and error.errno else error
            raise DeviceError(f"{self.port} cannot be opened ({why})") from None
        return line

    def _send(self, line: bytes) -> None:
        if self._line is None:
            raise DeviceLost(f"the board at {self.port} is not connected")
        try:
            self._line.write(line)
        except _SYSTEM_ERRORS as error:
            if "imeout" in type(error).__name__:
                raise NoAnswer(f"{self.port} takes no bytes ({error})") from None
            raise self._gone(error) from None

    def _arrived(self) -> bytes:
        """Wait for a byte, and return all received bytes."""
        if self._line is None:
            raise DeviceLost(f"the board at {self.port} is not connected")
        try:
            first: bytes = self._line.read(1)
            waiting = self._line.in_waiting if first else 0
            return first + self._line.read(waiting) if waiting else first
        except _READING_ERRORS as error:
            raise self._gone(error) from None

    def _gone(self, error: Exception) -> DeviceLost:
        return DeviceLost(f"the board at {self.port} is gone ({error})")


def open_serial(address: str, timeout: float = TIMEOUT) -> SerialDevice:
    """Talk to a board on a serial line: serial:PORT or serial:PORT@BAUD, e.g. serial:/dev/ttyUSB0@921600.

    Raises `InvalidInput`.
    """
    port, _, baud = address.rpartition("@") if "@" in address else (address, "", str(BAUD))
    if not port or not baud.isdecimal():
        raise InvalidInput(f"serial:{address} has to be serial:PORT or serial:PORT@BAUD, as serial:/dev/ttyUSB0@921600")
    return SerialDevice(port, baud=int(baud), timeout=timeout)
