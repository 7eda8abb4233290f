"""Plants under test as compiled functions: the formula of a fine step, and the loop over a sample.

The formula is that of `mpc.model.real_plant` for CasADi and for the exported C. Plants that differ only in their
numbers share compiled code. Faults, except additions to an angle's readings, and processes of other kinds are not
compiled.
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.codegen.graphs import Untranslatable
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.python_text import IMPORTS, filling
from mpc.model.faults import Fault, WrongReadings
from mpc.model.integration import integrated
from mpc.model.plant import NU, NX, Plant
from mpc.model.real_experiment import delayed, fine_steps, outside_torque
from mpc.model.real_plant import RealPlant
from mpc.trials.simulation import Process

if TYPE_CHECKING:
    from casadi import Function

_TEMPLATE = Path(__file__).with_name("process.py")


@dataclass(frozen=True, eq=False)
class CompiledPlant:
    """Compiled equivalent of the plant under test `process`."""

    process: Plant | RealPlant
    dt: float  # [s]
    module: ModuleType  # `mpc.trials.many.process` with the formula
    c: Array  # its numbers
    durations: Array  # of the pieces of a sample [s]
    steps: NDArray[np.int64]  # of each piece
    sensors: Array  # (6,), see `mpc.trials.many.process.read`
    waiting: int  # number of delayed commands, including the last one

    @property
    def nominal(self) -> Plant:
        """Plant without unmodelled effects."""
        return self.process.nominal

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the initial state (4,)."""
        return self.process.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> "CompiledExperiment":
        """Begin an experiment from `x0` (4,); `dt` [s] has to be that of the compilation."""
        if dt != self.dt:
            raise ValueError(f"compiled for samples of {self.dt:g} s, not of {dt:g} s")
        return CompiledExperiment(self, x0, seed)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true stiffness (M,) [N·m/rad] and muscle forces (M, 2) [N] in the states `x` (M, 4)."""
        return self.process.along(x)


class CompiledExperiment:
    """Experiment on a `CompiledPlant`, with its whole state in flat arrays."""

    def __init__(self, plant: CompiledPlant, x0: Array, seed: int) -> None:
        process = plant.process
        self.plant, self._noise, self._sample = plant, np.random.default_rng(seed), 0
        friction = process.friction.begun(float(x0[0])) if isinstance(process, RealPlant) else []
        self.full = np.append(x0, friction)  # (n,) state and friction's memory
        self.waiting = np.tile(
            np.asarray(x0, float)[2:], (plant.waiting, 1)
        )  # (w, 2) [Pa], oldest first; the last to fill in
        self.angles = np.full(int(plant.sensors[5]) + 2, float(x0[0]))  # (a,) [rad], oldest first

    @property
    def x(self) -> Array:
        """True state (4,)."""
        return self.full[:NX].copy()

    def measure(self) -> Array:
        """Read the sensors (4,); every call draws new noise."""
        y = np.empty(NX)
        self.plant.module.read(self.plant.sensors, self.full, self.angles, self.noise(1)[0], y)
        return y

    def advance(self, u: Array, d: float = 0.0) -> None:
        """Advance by one sample with the commands `u` (2,) [Pa] given now, and a torque `d` [N·m] added to the plant's
        own.
        """
        plant = self.plant
        self.waiting[-1] = u
        torque = float(self.torques(1)[0]) + d
        moving = self.full, self.waiting, self.angles
        plant.module.advance(plant.c, plant.durations, plant.steps, *moving, torque)
        self._sample += 1

    def noise(self, samples: int) -> Array:
        """Return errors of the readings (samples, 3) from now on: of the angle [rad] by faults, and the noise of the
        pressure sensors in standard deviations, equal to that drawn sample by sample.
        """
        process, times = self.plant.process, self.plant.dt * (self._sample + np.arange(samples))
        faults = process.faults if isinstance(process, RealPlant) else ()
        added = [[fault.read(np.zeros(NX), np.zeros(NX))[0] * fault.active(t) for t in times] for fault in faults]
        angle = np.sum(added, axis=0) if added else np.zeros(samples)
        return np.column_stack([angle, self._noise.standard_normal((samples, NU))])

    def torques(self, samples: int) -> Array:
        """Return the external torques (samples,) [N·m] from now on."""
        if isinstance(self.plant.process, Plant):
            return np.zeros(samples)
        profile, times = self.plant.process.torque_profile, range(self._sample, self._sample + samples)
        return np.array([outside_torque(profile, k * self.plant.dt) for k in times])


def compiled_plant(process: Process, dt: float) -> CompiledPlant:
    """Return the compiled `process` at the sample time `dt` [s].

    Raises `Untranslatable` for plants that cannot be compiled, and `ImportError` or `OSError` without a compiler.
    """
    if not isinstance(process, Plant | RealPlant):
        raise Untranslatable(f"a {type(process).__name__} is not compiled, a Plant and a RealPlant are")
    if isinstance(process, RealPlant) and not all(map(_added, process.faults)):
        raise Untranslatable(f"a plant with faults ({len(process.faults)} of them) is not compiled")
    source = filling("stepped", _stepped(process))
    module = imported(with_formulas(_TEMPLATE, f"{IMPORTS}@exactly\n{source.text}\n\n"))
    pieces, waiting, sensors = [dt], 0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if isinstance(process, RealPlant):
        pieces, waiting = delayed(process.dead_time, dt)
        sensors = process.encoder, process.pressure_noise, np.nan, *process.pressure_offset, process.reading_age / dt
    steps = np.array(fine_steps(process, dt, pieces))
    return CompiledPlant(process, dt, module, source.c, np.array(pieces), steps, np.array(sensors), waiting + 1)


def _added(fault: Fault) -> bool:
    """Return whether a fault only adds to the angle's readings."""
    return isinstance(fault, WrongReadings) and fault.added and fault.sensors == (0,)


def _stepped(process: Plant | RealPlant) -> "Function":
    """Return (full, u, (d, h)) ↦ full after a fine step of h [s], a CasADi function."""
    import casadi as ca

    size = NX + (process.friction.size if isinstance(process, RealPlant) else 0)
    full, u, dh = ca.SX.sym("full", size), ca.SX.sym("u", NU), ca.SX.sym("dh", 2)
    if isinstance(process, RealPlant):
        later = ca.vertcat(*process.stepped(full[:NX], full[NX:], u, dh[0], dh[1]))
    else:
        later = integrated(lambda x, t: ca.vertcat(*process.rate(x, u, dh[0])), full, dh[1], 1)
    return ca.Function("stepped", [full, u, dh], [ca.cse(ca.densify(later))])
