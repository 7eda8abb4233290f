"""A bench without hardware: a simulated joint on a clock that goes as fast as the computer."""

from types import SimpleNamespace

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import Plant, Reference
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.loop import RealTimeLoop
from mpc.bench.safety import SafeStop, SoftStart
from mpc.model.real_plant import RealPlant
from mpc.observer.base import Differentiator
from mpc.yardsticks.baselines import PIDControl

DT = 0.01


class Spied:
    """A device that notes what it is told, and does before a reading or a command what a test wants."""

    def __init__(self, device):
        self.device, self.commands, self.vents = device, [], 0
        self.before_read = self.before_write = self.changed = None

    def __enter__(self):
        self.device.__enter__()
        return self

    def __exit__(self, *error):
        self.device.__exit__(*error)

    def read(self):
        if self.before_read is not None:
            self.before_read()
        reading = self.device.read()
        return reading if self.changed is None else self.changed(reading)

    def write(self, P1, P2):
        if self.before_write is not None:
            self.before_write()
        self.commands.append((P1, P2))
        self.device.write(P1, P2)

    def vent(self):
        self.vents += 1
        self.commands.append((0.0, 0.0))
        self.device.vent()


@pytest.fixture(scope="session")
def plant():
    return Plant()


@pytest.fixture
def bench(plant):
    """A joint at 0° with 2 bar in both muscles, a PID, and a second to 10° and back; `loop(…)` makes the loop."""
    clock = SimulatedClock()
    device = Spied(SimulatedDevice(RealPlant(plant), clock, theta=0.0, pressures=(2 * BAR, 2 * BAR)))
    t = np.linspace(0, 1, 101)
    reference = Reference(t, 10 * DEG * np.sin(np.pi * t) ** 2, np.full(t.size, 7.5))
    controller = PIDControl(plant, DT)

    def loop(observer=None, **settings):
        settings = {
            "start": SoftStart(rate=5 * BAR, dwell=0.1, settle=0.1),
            "stop": SafeStop(rate=10 * BAR),
            "clock": clock,
        } | settings
        return RealTimeLoop(device, controller, observer or Differentiator(DT), reference, **settings)

    return SimpleNamespace(
        clock=clock, device=device, reference=reference, controller=controller, plant=plant, loop=loop
    )
