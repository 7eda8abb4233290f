"""Simulated device: a plant that moves with the clock, in real time or as fast as the computer can.

It behaves like a joint or an arm on a bench, including the effects of `RealPlant` and `RealArm`. At the ends of its
range are end stops, on which it lies without pressure. The time base is finer than a controller's, so that a command
acts from the time at which it is written.
"""

from dataclasses import replace
from math import nan
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.files.toml import Table
from allocator.machine_file import encoder_zero_in, machine_from
from allocator.mechanism import Mechanism
from allocator.units import BAR, DEG
from mpc.bench.device import Clock, DeviceError, MonotonicClock, Reading
from mpc.model.arm.storage import load_arm
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import Plant
from mpc.model.real import RealPlant, real_of
from mpc.model.real_experiment import RealExperiment, RealMachine
from mpc.model.stops import stop_torque

STEP = 1e-3  # of its time base [s]
_VENTED = 0.0  # [Pa]
_SENSORS = {"encoder": 0.02 * DEG, "pressure_noise": 0.02 * BAR}  # of a bench
_MOST = 2.0  # [s] longest time that one call simulates: more would take as long again


class SimulatedDevice:
    """`RealPlant` or `RealArm`, or a plant or an arm without their effects, with the interface of a device.

    Parameters
    ----------
    plant
        Simulated plant; by default that of the closed-loop benchmark, `RealPlant.standard()`.
    clock
        Clock of its motion: by default this computer's, for the speed of a real joint. With a `SimulatedClock`, which
        the loop needs as well, it is as fast as the computer.
    theta, pressures
        Initial angles [rad] and pressures [Pa]; by default it hangs in the middle, vented.
    seed
        Seed of the sensors' noise.
    measures_pressure
        Whether its regulators measure their pressures.
    zero
        Readings of its encoders at 0 of the joints [rad].
    """

    def __init__(
        self,
        plant: RealMachine | Machine | None = None,
        clock: Clock | None = None,
        *,
        theta: ArrayLike | None = None,
        pressures: ArrayLike = _VENTED,
        seed: int = 0,
        measures_pressure: bool = True,
        zero: ArrayLike = 0.0,
    ) -> None:
        self.plant = RealPlant.standard() if plant is None else real_of(plant)
        self.clock: Clock = MonotonicClock() if clock is None else clock
        nominal = self.plant.nominal
        middle = np.mean(nominal.angle_limits, axis=0)
        at = _row("theta", checks.angle("theta", middle if theta is None else theta), nominal.n)
        P = _row("pressures", checks.pressure("pressures", pressures), nominal.m)
        self._x0 = np.concatenate([at, np.zeros(nominal.n), P])
        self._seed, self._measures_pressure = checks.count("seed", seed, least=0), measures_pressure
        self._zero = _row("zero", checks.angle("zero", zero), nominal.n)
        self._inertias = nominal.inertias
        self._entered = 0
        self.torque: Value = 0.0  # of a weight on the joint [N·m], (n,) of an arm, positive if it pulls θ down
        self._experiment: RealExperiment | None = None

    def __enter__(self) -> Self:
        self._experiment = self.plant.begin(STEP, self._x0, self._seed + self._entered)  # noise does not repeat
        self._entered += 1
        self._u = self._x0[2 * self.plant.nominal.n :].copy()
        self._began, self._steps = self.clock.now(), 0
        return self

    def __exit__(self, *raised: object) -> None:
        """Stop; `x` remains available."""

    @property
    def x(self) -> Array:
        """True state (2n + m,) [rad, rad/s, Pa] of the last call. Raises `DeviceError` if never entered."""
        return self._running.x

    @property
    def command(self) -> Array:
        """Last commanded pressures (m,) [Pa]."""
        return self._u.copy()

    def read(self) -> Reading:
        """Return the sensor readings; their time is that of the state, independent of its computation time."""
        y, nominal = self._now().measure(), self.plant.nominal
        theta, P = y[: nominal.n] + self._zero, tuple(y[2 * nominal.n :].tolist())
        shown = P if self._measures_pressure else (nan,) * nominal.m
        t = self._began + self._steps * STEP
        return Reading(t, theta if nominal.angle_shape else float(theta[0]), shown)

    def write(self, *P: float) -> None:
        """Command the m pressures [Pa] from now on. Raises `InvalidInput` for another number of them."""
        if len(P) != (m := self.plant.nominal.m):
            raise InvalidInput(f"write: {len(P)} pressures for the {m} of the simulated device")
        self._now()
        self._u = np.array(P)

    def vent(self) -> None:
        """Vent all muscles."""
        self.write(*[_VENTED] * self.plant.nominal.m)

    def hang(self, torque: Value) -> bool:
        """Hang a weight of this torque [N·m], (n,) on an arm, positive if it pulls θ down; it acts at once."""
        _row("torque", checks.real("torque", torque, "N·m"), self.plant.nominal.n)
        self.torque = torque
        return True

    @property
    def _running(self) -> RealExperiment:
        if self._experiment is None:
            raise DeviceError("the simulated device is not connected: use it as a context, `with device:`")
        return self._experiment

    def _now(self) -> RealExperiment:
        """Return the experiment, simulated up to the present."""
        experiment = self._running
        due = int((self.clock.now() - self._began) / STEP * (1 + 1e-12) + 1e-6) - self._steps
        load = np.asarray(self.torque, float)
        for _ in range(min(due, int(_MOST / STEP))):
            experiment.advance(self._u, self._stopping(experiment.x) - load)
        self._steps += max(due, 0)
        return experiment

    def _stopping(self, x: Array) -> Array:
        """Return the torques (n,) [N·m] of the end stops, if there are any."""
        nominal = self.plant.nominal
        if not nominal.has_stops:
            return np.zeros(nominal.n)
        q, omega, (low, high) = x[: nominal.n], x[nominal.n : 2 * nominal.n], nominal.angle_limits
        return np.asarray(stop_torque(q, omega, low, high, self._inertias))


def _row(name: str, values: Array, size: int) -> Array:
    """Return `values` as a row, a number for all of them. Raises `InvalidInput` for another size."""
    if values.shape not in ((), (size,)):
        raise InvalidInput(f"{name} = {checks.brief(values)} has to be one number or a row of {size}")
    return np.broadcast_to(values, (size,))


def simulated(plant: Machine, known: Compensation, **effects: Any) -> RealMachine:
    """Return `plant` as a machine on a bench, with its `known` friction and regulators, and sensors of a bench.

    Unknown effects of a joint are those of `RealPlant.standard`, an arm has none. The muscles have the forces of the
    plant's.
    """
    if isinstance(plant, Plant):
        return replace(RealPlant.standard((1.0, 1.0), nominal=plant), **(known.told | effects))
    return real_of(plant, known, **(_SENSORS | effects))


def open_simulated(address: str = "", clock: Clock | None = None) -> SimulatedDevice:
    """Simulate a joint in real time: sim for the benchmark's, or sim:plant.toml for that of a file, or an arm."""
    if not address:
        return SimulatedDevice(RealPlant.standard(), clock)
    file = Table.read(address)
    if isinstance(machine_from(file), Mechanism):
        return SimulatedDevice(simulated(load_arm(address), Compensation.of_arm(address)), clock)
    zero = encoder_zero_in(file)
    return SimulatedDevice(simulated(Plant.load(address), Compensation.load(address)), clock, zero=zero)
