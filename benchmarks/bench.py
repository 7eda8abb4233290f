"""Lateness of a loop's samples on this computer, alone and next to a process that loads a core.

    python -m benchmarks.bench [--seconds 60] [--out benchmarks/results/bench.md]

MPC and observer on a simulated joint in real time, 100 Hz for 60 s and 500 Hz for 30 s, each alone and next to a busy
process; then one sample of 100 Hz that takes 50 ms longer. Unlike a real joint the simulated one costs time: 13 µs per
simulated millisecond. The process has no real-time priority and no separate core, unless started with them (`chrt -f 50
python -m benchmarks.bench`).
"""

import argparse
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from allocator import DEG
from allocator.files.atomic import write_text
from benchmarks.allocators.machine import machine
from mpc import KalmanObserver, RealPlant, TrackingMPC, Weights
from mpc.bench.cycle import Phase
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.logs import Record
from mpc.bench.loop import RealTimeLoop
from mpc.bench.safety import SafeStop, SoftStart, Watchdog
from mpc.trials.motions.reference import sine

RATES = (100, 60.0), (500, 30.0)  # [Hz], [s]
LATE = 0.05  # [s]
HEADER = (
    "| rate | beside it | late: median [ms] | 99 % [ms] | worst [ms] | missed samples | of | "
    "read to command, median [ms] | 99 % [ms] | angle error, RMS [°] |\n|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|"
)


_BUSY = """
import os
if hasattr(os, "SCHED_OTHER"):  # whatever priority the loop has
    os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
while True: pass
"""


@contextmanager
def loaded(busy: bool) -> Iterator[None]:
    """Run a busy process meanwhile, if `busy`."""
    if not busy:
        yield
        return
    process = subprocess.Popen([sys.executable, "-c", _BUSY])
    try:
        yield
    finally:
        process.kill()
        process.wait()


def run(rate: int, seconds: float, late: float = 0.0) -> Record:
    """Run a sine of ±30° at 0.5 Hz; in its middle one step of the controller takes `late` [s] longer."""
    real = RealPlant.standard()
    known, dt = real.known(), 1 / rate
    controller = TrackingMPC(real.nominal, dt, 20, Weights.calm(), compensation=known)
    observer = KalmanObserver(real.nominal, dt, compensation=known)
    reference = sine(amplitude=30 * DEG, K=5.6, duration=seconds)
    loop = RealTimeLoop(
        SimulatedDevice(real), controller, observer, reference,
        start=SoftStart(rate=2e5), stop=SafeStop(rate=5e5), watchdog=Watchdog(reaction=None),
    )  # fmt: skip
    if late:
        step, begun = controller.step, time.monotonic()

        def slow(*arguments):
            nonlocal begun
            if begun and time.monotonic() - begun > 2.5 + seconds / 2:
                begun = 0.0
                time.sleep(late)
            return step(*arguments)

        controller.step = slow
    return loop.run()


def row(rate: int, busy: bool, record: Record) -> str:
    """Return a line of the table."""
    late, (took,) = record.lateness, record.where("took", phases=(Phase.RUN,))
    if str(record.ending) != "finished":
        return f"| {rate} Hz | {'a busy process' if busy else ''} | ended: {record.ending} |"
    times = (1e3 * value for value in (late.median, late.p99, late.worst))
    return " | ".join(
        [
            f"| {rate} Hz", "a busy process" if busy else "", *(f"{t:.3f}" for t in times), str(late.missed),
            str(late.samples + late.missed), *(f"{1e3 * t:.3f}" for t in np.percentile(took, [50, 99])),
            f"{record.theta_rms / DEG:.3f} |",
        ]
    )  # fmt: skip


def after_late(record: Record) -> str:
    """Return a sentence on the loop's reaction to the late sample."""
    columns = record.columns
    i = int(np.argmax(columns["missed"]))
    error = np.abs(columns["theta"] - columns["theta_ref"])
    before, after = (float(np.nanmax(error[part])) / DEG for part in (slice(i - 100, i), slice(i, i + 100)))
    late, took = (1e3 * columns[name][i] for name in ("late", "took"))
    return (
        f"One step took {1e3 * LATE:.0f} ms longer at 100 Hz: {columns['missed'][i]} samples were left out, the next "
        f"began {late:.1f} ms after its deadline, and its command was sent {took:.1f} ms later; the largest angle "
        f"error was {before:.2f}° in the second before and {after:.2f}° in the second after."
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--seconds", type=float, help="of each run, instead of 60 and 30")
    parser.add_argument("--out", type=Path, help="a .md to write")
    given = parser.parse_args()
    lines = [HEADER]
    print(HEADER, flush=True)
    for rate, seconds in RATES:
        for busy in (False, True):
            with loaded(busy):
                lines.append(row(rate, busy, run(rate, given.seconds or seconds)))
            print(lines[-1], flush=True)
    lines += ["", after_late(run(100, 10.0, LATE))]
    print(lines[-1])
    if given.out is not None:
        title = f"# Lateness of a loop\n\n`python -m benchmarks.bench`, {machine()}\n\n"
        write_text(given.out, title + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
