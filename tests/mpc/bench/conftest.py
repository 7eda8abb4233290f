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
from mpc.tracking.limits import Limits
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times
from mpc.trials.motions.arm_trajectories import usual_stiffness
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

    def write(self, *P):
        if self.before_write is not None:
            self.before_write()
        self.commands.append(P)
        self.device.write(*P)

    def vent(self):
        self.vents += 1
        self.commands.append((0.0,) * self.device.plant.nominal.m)
        self.device.vent()


class ArmPD:
    """A controller of an arm that takes no compiler: pressures for the torque of the reference and its error."""

    ahead = 2

    def __init__(self, plant, dt):
        self.plant, self.dt, self._limits = plant, dt, Limits.of(plant, dt)
        self.reset()

    def reset(self):
        self._sent = None

    def step(self, x, q_ref, K_ref, d=0.0):
        n, (q, K) = (
            self.plant.n,
            (np.reshape(q_ref, (-1, self.plant.n)), np.reshape(K_ref, (-1, *np.shape(K_ref)[-2:]))),
        )
        ahead = q[-1] - q[0]
        alpha = (q[-1] - 2 * q[len(q) // 2] + q[0]) / self.dt**2 if len(q) == 3 else 0.0 * ahead
        back = np.nan_to_num(20.0 * (q[0] - x[:n]) + 2.0 * (ahead / self.dt / 2 - x[n : 2 * n]))
        T = self.plant.torque_for(q[0], 0.0 * ahead, alpha) + back
        wanted = self.plant.held(q[:1], K[:1], T[None], 0.0).P
        last = x[2 * n :] if self._sent is None else self._sent
        self._sent = self._limits.limited(last, wanted)[0]
        moved = np.stack([x, x]), self.plant.along(np.stack([x, x]))[0]
        return Plan(self._sent[None].copy(), *moved, PlanStatus.CLOSED_FORM, Rung.ALLOCATION, 0.0, Times(*5 * (0.0,)))


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
