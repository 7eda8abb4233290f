"""A process to be killed: a PID drives a simulated joint in real time, and every command goes into a file.

python driven.py DIRECTORY HANG; writes DIRECTORY/log.csv and DIRECTORY/commands, a line each, or `vent`. HANG is "no",
"call" (the hundredth reading never comes), "stubborn" (nor does an interruption help it), "device" (nor does a
command) or "thread" (nothing hangs, but the loop is in a thread, and the program ends after a hundred readings).
"""

import os
import signal
import sys
import threading
import time
from pathlib import Path

import numpy as np

from allocator import BAR
from mpc import Plant, Reference
from mpc.bench.device import CallableDevice, Reading
from mpc.bench.loop import RealTimeLoop
from mpc.bench.safety import SafeStop, SoftStart, Watchdog
from mpc.observer.base import Differentiator
from mpc.yardsticks.baselines import PIDControl

EXITS = {"finished": 0, "interrupted": 130, "terminated": 143}


def sleeping(stubborn):
    while True:
        try:
            time.sleep(3600)
        except BaseException:
            if not stubborn:
                raise


def main(directory, hang):
    if hasattr(signal, "SIGHUP"):
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # the tests may run under nohup
    commands = os.open(directory / "commands", os.O_WRONLY | os.O_CREAT | os.O_APPEND)
    readings, enough = iter(range(10**9)), threading.Event()

    def read():
        k = next(readings)
        if k >= 100 and hang == "thread":
            enough.set()
        elif k >= 100 and hang != "no":
            sleeping(hang == "stubborn")
        return Reading(time.monotonic(), 0.0, (2 * BAR, 2 * BAR))

    def write(P1, P2):
        if next(readings) >= 100 and hang == "device":
            sleeping(False)
        os.write(commands, f"{P1!r} {P2!r}\n".encode())

    def vent():
        if hang == "device":
            sleeping(False)
        os.write(commands, b"vent\n")

    plant = Plant()
    t = np.linspace(0, 600, 100)
    loop = RealTimeLoop(
        CallableDevice(read, write, vent), PIDControl(plant, 0.01), Differentiator(0.01),
        Reference(t, 0.0 * t, np.full(t.size, 7.5)),
        start=SoftStart(rate=50 * BAR, dwell=0.0, settle=0.0), stop=SafeStop(rate=20 * BAR),
        watchdog=Watchdog(silence=30.0, stall=0.5, reaction=None), log=directory / "log.csv",
    )  # fmt: skip
    if hang == "thread":
        threading.Thread(target=loop.run, daemon=True).start()
        enough.wait()
        return
    record = loop.run()
    print(record.ending, record.ending.delivered)
    sys.exit(EXITS.get(str(record.ending.reason), 4))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
