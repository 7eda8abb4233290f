"""Plants under test as compiled functions: the formula of a fine step, and the loop over a sample.

The formula of a joint is that of `mpc.model.real` for CasADi and for the exported C; that of an arm consists of
the two of `mpc.model.real`, with their integration in `arm`. Plants that differ only in their numbers share
compiled code. Faults, except additions to the angles' readings, and processes of other kinds are not compiled.
"""

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Value
from allocator.lazy import Function
from mpc.codegen.graphs import Untranslatable
from mpc.codegen.modules import imported, with_formulas
from mpc.codegen.text import IMPORTS, filling
from mpc.model.experiment import integrated
from mpc.model.faults import Fault, WrongReadings
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.model.real import RealArm, RealPlant
from mpc.model.real_experiment import delayed, fine_steps, outside_torque
from mpc.trials.simulation import Process

_TEMPLATE, _ARM = (Path(__file__).with_name(f"{name}.py") for name in ("process", "arm"))
Compilable: TypeAlias = Plant | RealPlant | RealArm


@dataclass(frozen=True, eq=False)
class CompiledPlant:
    """Compiled equivalent of the plant under test `process`, of n joints and m muscles."""

    process: Compilable
    dt: float  # [s]
    module: ModuleType  # `mpc.trials.many.process` with the formula
    c: Array  # its numbers
    durations: Array  # of the pieces of a sample [s]
    steps: NDArray[np.int64]  # of each piece
    sensors: Array  # (4 + m,), see `mpc.trials.many.process.read`
    waiting: int  # number of delayed commands, including the last one

    @property
    def nominal(self) -> Machine:
        """Plant without unmodelled effects."""
        return self.process.nominal

    def at_rest(self, theta: Any, K: Any) -> Array:
        """Return the initial state (2n + m,)."""
        return self.process.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> "CompiledExperiment":
        """Begin an experiment from `x0` (2n + m,); `dt` [s] has to be that of the compilation."""
        if dt != self.dt:
            raise ValueError(f"compiled for samples of {self.dt:g} s, not of {dt:g} s")
        return CompiledExperiment(self, x0, seed)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true stiffness (M, …) and muscle forces (M, m) [N] in the states `x` (M, 2n + m)."""
        return self.process.along(x)


class CompiledExperiment:
    """Experiment on a `CompiledPlant`, with its whole state in flat arrays."""

    def __init__(self, plant: CompiledPlant, x0: Array, seed: int) -> None:
        process, n = plant.process, plant.nominal.n
        frictions = () if isinstance(process, Plant) else process.frictions
        begun = (np.atleast_1d(one.begun(at)) for one, at in zip(frictions, x0[:n].tolist(), strict=bool(frictions)))
        self.plant, self._noise, self._sample = plant, np.random.default_rng(seed), 0
        self._sizes = n, plant.nominal.m, plant.nominal.size
        self._faults = () if isinstance(process, Plant) else process.faults
        self.full = np.concatenate([x0, *begun])  # state and the frictions' memories
        # commands (w, m) [Pa], the last one to be filled in, and angles (a, n) [rad], oldest first
        self.waiting = np.tile(self.full[2 * n : x0.size], (plant.waiting, 1))
        self.angles = np.tile(self.full[:n], (int(plant.sensors[3]) + 2, 1))

    @property
    def x(self) -> Array:
        """True state (2n + m,)."""
        return self.full[: self._sizes[2]].copy()

    def measure(self) -> Array:
        """Read the sensors (2n + m,); every call draws new noise."""
        y = np.empty(self._sizes[2])
        self.plant.module.read(self.plant.sensors, self.full, self.angles, self.noise(1)[0], y)
        return y

    def advance(self, u: Array, d: Value = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] given now, and a torque `d` [N·m], (n,) for an arm,
        added to the plant's own.
        """
        plant = self.plant
        self.waiting[-1] = u
        moving = self.full, self.waiting, self.angles
        plant.module.advance(plant.c, plant.durations, plant.steps, *moving, self.torques(1)[0] + d)
        self._sample += 1

    def noise(self, samples: int) -> Array:
        """Return errors of the readings (samples, n + m) from now on: of the angles [rad] by faults, and the noise of
        the pressure sensors in standard deviations, equal to that drawn sample by sample.
        """
        n, m, size = self._sizes
        errors = np.zeros((samples, n + m))
        errors[:, n:] = self._noise.standard_normal((samples, m))
        for fault in self._faults:
            active = [k for k in range(samples) if fault.active(self.plant.dt * (self._sample + k))]
            if active:
                errors[active, :n] += fault.read(np.zeros(size), np.zeros(size))[:n]
        return errors

    def torques(self, samples: int) -> Array:
        """Return the external torques (samples, n) [N·m] from now on."""
        torques, process = np.zeros((samples, self._sizes[0])), self.plant.process
        if not isinstance(process, Plant):
            for k in range(samples):
                torques[k] = outside_torque(process.torque_profile, (self._sample + k) * self.plant.dt)
        return torques


def compiled_plant(process: Process, dt: float) -> CompiledPlant:
    """Return the compiled `process` at the sample time `dt` [s].

    Raises `Untranslatable` for plants that cannot be compiled, and `ImportError` or `OSError` without a compiler.
    """
    if not isinstance(process, Plant | RealPlant | RealArm):
        raise Untranslatable(f"a {type(process).__name__} is not compiled; a Plant, a RealPlant and a RealArm are")
    n, m = process.nominal.n, process.nominal.m
    if not isinstance(process, Plant) and not all(_added(fault, n) for fault in process.faults):
        raise Untranslatable(f"a plant with faults ({len(process.faults)} of them) is not compiled")
    text, c = _of_arm(process) if isinstance(process, RealArm) else _of_joint(process)
    module = imported(with_formulas(_TEMPLATE, f"{text}n, m = {n}, {m}\n\n\n"))
    pieces, waiting, sensors = [dt], 0, [0.0] * (4 + m)
    if not isinstance(process, Plant):
        pieces, waiting = delayed(process.dead_time, dt)
        age = process.reading_age / dt
        sensors = [process.encoder, process.pressure_noise, np.nan, age, *process.pressure_offset]
    steps = np.array(fine_steps(process, dt, pieces))
    return CompiledPlant(process, dt, module, c, np.array(pieces), steps, np.array(sensors), waiting + 1)


def _added(fault: Fault, joints: int) -> bool:
    """Return whether a fault only adds to readings of angles."""
    return isinstance(fault, WrongReadings) and fault.added and all(one < joints for one in fault.sensors)


def _of_arm(arm: RealArm) -> tuple[str, Array]:
    """Return the import of the arm's step and its numbers."""
    nominal, rubbed = arm.nominal, filling("rubbed", arm.rubbed)
    rate = filling("rate", arm.rate, rubbed.c.size)
    formulas = "".join(f"@inlined\n{source.text}\n\n" for source in (rubbed, rate))
    step = imported(with_formulas(_ARM, f"{IMPORTS}n, SIZE = {nominal.n}, {nominal.size}\n\n\n{formulas}"))
    return f"from {step.__name__} import stepped\n\n", np.concatenate([rubbed.c, rate.c])


def _of_joint(process: Plant | RealPlant) -> tuple[str, Array]:
    """Return the text of the joint's step and its numbers."""
    source = filling("stepped", _stepped(process))
    return f"{IMPORTS}@exactly\n{source.text}\n\n", source.c


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
