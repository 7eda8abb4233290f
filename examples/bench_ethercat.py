"""Drive two pressure regulators behind an EtherCAT coupler with pysoem. NOT TESTED BY US: it shows where calls go.

    pip install antagonist pysoem; sudo python examples/bench_ethercat.py eth0

Fit the layout of the process data and the scales to your terminals: here 16-bit outputs, 0 … 10 V for 0 … 6 bar, two
16-bit pressure inputs of the same scale, and a 32-bit encoder of 20 000 steps a turn.
"""

import struct
import sys
import time
from math import pi

from allocator import BAR
from mpc import KalmanObserver, Plant, TrackingMPC, sine
from mpc.bench import CallableDevice, DeviceLost, NoAnswer, Reading, RealTimeLoop

FULL, RANGE, STEPS = 32767, 6 * BAR, 20_000
TIMEOUT = 2000  # [µs] of a process data exchange


def connected(interface):
    import pysoem

    master = pysoem.Master()
    master.open(interface)
    if master.config_init() <= 0:
        raise DeviceLost(f"no EtherCAT terminals on {interface}")
    master.config_map()
    master.state = pysoem.OP_STATE
    master.write_state()
    return master


def exchanged(master):
    master.send_processdata()
    if master.receive_processdata(TIMEOUT) < master.expected_wkc:
        raise NoAnswer("a terminal did not take part in the exchange")


def device_on(master):
    outputs, inputs = master.slaves[1], master.slaves[2]

    def read():
        exchanged(master)
        one, two, steps = struct.unpack("<hhi", inputs.input[:8])
        return Reading(time.monotonic(), 2 * pi * steps / STEPS, (one / FULL * RANGE, two / FULL * RANGE))

    def write(P1, P2):
        outputs.output = struct.pack("<hh", *(round(P / RANGE * FULL) for P in (P1, P2)))
        exchanged(master)

    return CallableDevice(read, write, close=master.close)


if __name__ == "__main__":
    plant = Plant.load("my_plant.toml")
    controller, observer = TrackingMPC(plant), KalmanObserver(plant, 0.01)
    print(RealTimeLoop(device_on(connected(sys.argv[1])), controller, observer, sine(), log="run.csv").run().ending)
