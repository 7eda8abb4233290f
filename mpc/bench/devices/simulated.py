"""Simulated device: a plant that moves with the clock, in real time or as fast as the computer can.

It behaves like a joint on a bench, including the effects of `RealPlant`. Its time base is finer than a controller's, so
that a command acts from the time at which it is written.
"""

from dataclasses import replace
from math import nan
from typing import Any, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.files.toml import Table
from allocator.machine_file import encoder_zero_in
from mpc.bench.device import Clock, DeviceError, MonotonicClock, Reading
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.model.real_experiment import RealExperiment
from mpc.model.real_plant import RealPlant

STEP = 1e-3  # of its time base [s]
_VENTED = 0.0  # [Pa]
_MOST = 2.0  # [s] longest time that one call simulates: more would take as long again


class SimulatedDevice:
    """`RealPlant` or `Plant` with the interface of a device.

    Parameters
    ----------
    plant
        Simulated plant; by default that of the closed-loop benchmark, `RealPlant.standard()`.
    clock
        Clock of its motion: by default this computer's, for the speed of a real joint. With a `SimulatedClock`, which
        the loop needs as well, it is as fast as the computer.
    theta, pressures
        Initial angle [rad] and pressures [Pa]; by default it hangs in the middle, vented.
    seed
        Seed of the sensors' noise.
    measures_pressure
        Whether its regulators measure their pressures.
    zero
        Reading of its encoder at 0 of the joint [rad].
    """

    def __init__(
        self,
        plant: RealPlant | Plant | None = None,
        clock: Clock | None = None,
        *,
        theta: float | None = None,
        pressures: tuple[float, float] = (_VENTED, _VENTED),
        seed: int = 0,
        measures_pressure: bool = True,
        zero: float = 0.0,
    ) -> None:
        plant = RealPlant.standard() if plant is None else plant
        self.plant = RealPlant(plant) if isinstance(plant, Plant) else plant
        self.clock: Clock = MonotonicClock() if clock is None else clock
        middle = float(np.mean(self.plant.nominal.joint.angle_range))
        at = middle if theta is None else float(checks.angle("theta", theta))
        self._x0 = np.array([at, 0.0, *checks.pressure("pressures", pressures)])
        self._seed, self._measures_pressure = seed, measures_pressure
        self._zero = float(checks.angle("zero", zero))
        self._entered = 0
        self.torque = 0.0  # of a weight on the joint [N·m], positive if it pulls θ down
        self._experiment: RealExperiment | None = None

    def __enter__(self) -> Self:
        self._experiment = self.plant.begin(STEP, self._x0, self._seed + self._entered)  # noise does not repeat
        self._entered += 1
        self._u = self._x0[2:].copy()
        self._began, self._steps = self.clock.now(), 0
        return self

    def __exit__(self, *raised: object) -> None:
        """Stop; `x` remains available."""

    @property
    def x(self) -> Array:
        """True state (4,) [rad, rad/s, Pa, Pa] of the last call. Raises `DeviceError` if never entered."""
        return self._running.x

    @property
    def command(self) -> Array:
        """Last commanded pressures (2,) [Pa]."""
        return self._u.copy()

    def read(self) -> Reading:
        """Return the sensor readings; their time is that of the state, independent of its computation time."""
        experiment = self._now()
        theta, _, P1, P2 = experiment.measure().tolist()
        shown = (P1, P2) if self._measures_pressure else (nan, nan)
        return Reading(self._began + self._steps * STEP, theta + self._zero, shown)

    def write(self, P1: float, P2: float) -> None:
        """Command pressures [Pa] from now on."""
        self._now()
        self._u = np.array([P1, P2])

    def vent(self) -> None:
        """Vent both muscles."""
        self.write(_VENTED, _VENTED)

    def hang(self, torque: float) -> bool:
        """Hang a weight of this torque [N·m], positive if it pulls θ down; it acts at once."""
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
        for _ in range(min(due, int(_MOST / STEP))):
            experiment.advance(self._u, -self.torque)
        self._steps += max(due, 0)
        return experiment


def simulated(plant: Plant, known: Compensation, **effects: Any) -> RealPlant:
    """Return `plant` as a joint on a bench, with its `known` friction and regulators, and sensors of a bench.

    Unknown effects are those of `RealPlant.standard`; the muscles have the forces of the plant's.
    """
    standard = RealPlant.standard((1.0, 1.0), nominal=plant)
    return replace(standard, **(known.told | effects))


def open_simulated(address: str = "", clock: Clock | None = None) -> SimulatedDevice:
    """Simulate a joint in real time: sim for the benchmark's, or sim:plant.toml for that of a file."""
    if not address:
        return SimulatedDevice(RealPlant.standard(), clock)
    zero = encoder_zero_in(Table.read(address))
    return SimulatedDevice(simulated(Plant.load(address), Compensation.load(address)), clock, zero=zero)
