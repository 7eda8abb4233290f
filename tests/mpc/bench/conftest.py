"""A bench without hardware: a simulated joint or arm on a clock that goes as fast as the computer."""

from types import SimpleNamespace

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import Plant, Reference
from mpc.bench.device import SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.loop import RealTimeLoop
from mpc.bench.rows import Sheet
from mpc.bench.safety import SafeStop, SoftStart
from mpc.model.arm.model import Arm
from mpc.observer.base import Differentiator
from mpc.trials.motions.arm_trajectories import usual_stiffness
from mpc.yardsticks.baselines import PIDControl

from ...rigs.arm_pd import ArmPD

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

    def write(self, *P):
        if self.before_write is not None:
            self.before_write()
        self.commands.append(P)
        self.device.write(*P)

    def vent(self):
        self.vents += 1
        self.commands.append((0.0,) * self.device.plant.nominal.m)
        self.device.vent()


@pytest.fixture(scope="session")
def plant():
    return Plant()


@pytest.fixture
def bench(request, plant):
    """A machine at 0° with 2 bar in all muscles, a controller, and a second to 10° and back; `loop(…)` makes the loop.

    It is a joint with a PID, or arm26 where the test asks for "arm".
    """
    arm = getattr(request, "param", "joint") == "arm"
    plant, clock, t = Arm.machine("arm26") if arm else plant, SimulatedClock(), np.linspace(0, 1, 101)
    device = Spied(SimulatedDevice(plant, clock, theta=0.0, pressures=2 * BAR))
    theta = 10 * DEG * np.sin(np.pi * t) ** 2
    if arm:
        q = np.stack([theta, -theta], axis=1)
        reference, controller = Reference(t, q, usual_stiffness(plant)(q)), ArmPD(plant, DT)
    else:
        reference, controller = Reference(t, theta, np.full(t.size, 7.5)), PIDControl(plant, DT)

    def loop(observer=None, **settings):
        settings = {
            "start": SoftStart(rate=5 * BAR, dwell=0.1, settle=0.1),
            "stop": SafeStop(rate=10 * BAR),
            "clock": clock,
        } | settings
        return RealTimeLoop(device, controller, observer or Differentiator(DT, plant.n), reference, **settings)

    return SimpleNamespace(
        clock=clock, device=device, reference=reference, controller=controller, plant=plant, loop=loop,
        observer=lambda: Differentiator(DT, plant.n), sheet=Sheet.of(plant),
    )  # fmt: skip
