"""Examination of a real or simulated board: its answers, their delay, and falling pressures without a host."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from mpc.bench.device import DeviceLost, NoAnswer
from mpc.bench.devices.serial_line import BoardInfo, SerialDevice
from mpc.bench.devices.serial_protocol import State

_MARGIN = 0.1  # [s] after the watchdog's time, by which it must have acted
_LOST = 0.01  # share of the exchanges that may be lost


@dataclass(frozen=True)
class Examination:
    """Results of `exchanges` readings and commands of a board."""

    info: BoardInfo
    exchanges: int
    read: Array  # round trips [s] of the answered ones
    write: Array
    unanswered: int
    late: int  # answers after their time limit
    damaged_here: int  # received byte sequences that were no frame
    damaged_there: int
    clock: float  # relative rate error of the board's clock against the host's, positive if fast [-]
    obeyed_late: bool  # whether it still took commands after the watchdog's time
    tripped: bool  # whether it reported that the watchdog had acted
    greeted: bool  # whether a new session ended the safe state

    @property
    def faults(self) -> list[str]:
        """Return the faults of the board, one sentence each; none if it may be used."""
        lost = self.unanswered / (2 * self.exchanges)
        found = [
            (lost > _LOST, f"{100 * lost:.2g} % of the requests were not answered in time"),
            (self.obeyed_late, "it took a command after its host had been silent for longer than its watchdog's time"),
            (not self.tripped, "it did not say that its watchdog had acted"),
            (not self.greeted, "a new session did not lead it out of its safe state"),
        ]
        return [sentence for wrong, sentence in found if wrong]

    def lines(self) -> list[str]:
        """Return the report."""
        info = self.info
        kind = f"a controller every {1e3 * info.dt:g} ms" if info.room else "a dumb terminal"
        sizes = f"{info.joints} joint{'s' * (info.joints > 1)} and {info.muscles} muscles"
        return [
            f"board: {kind} for {sizes}, commands within {info.low / 1e5:g} to {info.high / 1e5:g} bar, "
            f"clock {self.clock:+.1e}",
            f"read:  {_quantiles(self.read)}",
            f"write: {_quantiles(self.write)}",
            f"of {2 * self.exchanges} requests {self.unanswered} were not answered in time, {self.late} answers came "
            f"late, damaged frames: {self.damaged_there} there, {self.damaged_here} here",
            f"watchdog after {info.watchdog:g} s of silence: "
            + ("acted" if self.tripped and not self.obeyed_late else "DID NOT ACT")
            + ("; a new session ends its safe state" if self.greeted else "; its safe state could not be left"),
        ]


def examine(connect: Callable[[], SerialDevice], exchanges: int = 500) -> Examination:
    """Return the examination of the board that `connect` opens; only its least pressure is commanded.

    Raises `DeviceError`.
    """
    with connect() as device:
        low = (device.info.low,) * device.info.muscles
        began, ticks = device.read().t, device.board_time
        read, write = [], []
        for _ in range(exchanges):
            read.append(_timed(device.read))
            write.append(_timed(lambda: device.write(*low)))
        time.sleep(device.info.watchdog + _MARGIN)
        obeyed, tripped = _after_silence(device, low)
        passed, board = device.read().t - began, device.board_time - ticks
        counted = device.unanswered, device.late, device.damaged, device.damaged_there
        info = device.info
    unanswered, late, here, there = counted
    return Examination(
        info=info,
        exchanges=exchanges,
        read=np.array([t for t in read if t is not None]),
        write=np.array([t for t in write if t is not None]),
        unanswered=unanswered,
        late=late,
        damaged_here=here,
        damaged_there=there,
        clock=board / passed - 1,
        obeyed_late=obeyed,
        tripped=tripped,
        greeted=_greeted(connect),
    )


def _timed(exchange: Callable[[], object]) -> float | None:
    """Return the duration of the exchange [s], or None if it failed."""
    began = time.perf_counter()
    try:
        exchange()
    except NoAnswer:
        return None
    return time.perf_counter() - began


def _after_silence(device: SerialDevice, low: tuple[float, ...]) -> tuple[bool, bool]:
    """Return whether the board obeyed, and whether it reported that its watchdog had acted."""
    for _ in range(10):
        try:
            device.write(*low)
        except NoAnswer:
            continue
        except DeviceLost:
            return False, device.state == State.TRIPPED
        return True, False
    return False, False


def _greeted(connect: Callable[[], SerialDevice]) -> bool:
    """Return whether a new session is obeyed; the board is vented then."""
    with connect() as device:
        for _ in range(10):
            try:
                device.write(*(device.info.low,) * device.info.muscles)
            except NoAnswer:
                continue
            except DeviceLost:
                return False
            device.vent()
            return True
    return False


def _quantiles(times: Array) -> str:
    if not times.size:
        return "never answered"
    median, most, worst = 1e3 * np.quantile(times, [0.5, 0.99, 1.0])
    return f"{median:.2f} ms median, {most:.2f} ms for 99 %, {worst:.2f} ms at worst"
