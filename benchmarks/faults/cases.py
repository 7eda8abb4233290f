"""Faults with their expected names, plants, trajectories and loads."""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from allocator.units import BAR, DEG
from benchmarks.closed_loop.cases import PLANTS, VARIANTS
from benchmarks.strangers.plants import REPORTING, STRUCTURES, Stranger, drawn
from mpc.model.faults import (
    BrokenCable,
    DriftingSensor,
    Fault,
    FrozenSensors,
    Leak,
    SilentSensors,
    StuckValve,
    SupplyDrop,
)
from mpc.model.real import RealPlant
from mpc.observer.health import FaultKind, Part, Suspect

K = 5.5  # [N·m/rad] about which the trajectories are


class Case(NamedTuple):
    """Fault that begins at a time [s], and its name."""

    begun: Callable[[float], Fault]
    named: Suspect


def _suspects(kind: FaultKind, parts: tuple[Part, ...]) -> list[Suspect]:
    return [Suspect(kind, part) for part in parts]


_LEAK = _suspects(FaultKind.LEAK, (Part.MUSCLE_1, Part.MUSCLE_2))
_STUCK = _suspects(FaultKind.STUCK_VALVE, (Part.MUSCLE_1, Part.MUSCLE_2))
_CABLE = _suspects(FaultKind.BROKEN_CABLE, (Part.MUSCLE_1, Part.MUSCLE_2))
_DRIFT = _suspects(FaultKind.DRIFTING_SENSOR, (Part.ANGLE, Part.P1, Part.P2))
_FROZEN = _suspects(FaultKind.FROZEN_SENSOR, (Part.ANGLE, Part.P1, Part.P2))
_SILENT = _suspects(FaultKind.SILENT_SENSOR, (Part.ANGLE, Part.P1, Part.P2))

FAULTS = {
    "leak 1": Case(lambda t: Leak(t, muscle=1), _LEAK[0]),
    "leak 2": Case(lambda t: Leak(t, muscle=2), _LEAK[1]),
    "burst 1": Case(lambda t: Leak(t, muscle=1, kept=0.5), _LEAK[0]),
    "stuck valve 1": Case(lambda t: StuckValve(t, muscle=1), _STUCK[0]),
    "stuck valve 2": Case(lambda t: StuckValve(t, muscle=2), _STUCK[1]),
    "supply at 2.5 bar": Case(lambda t: SupplyDrop(t, supply=2.5 * BAR), Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY)),
    "supply at 3 bar": Case(lambda t: SupplyDrop(t, supply=3 * BAR), Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY)),
    "broken cable 1": Case(lambda t: BrokenCable(t, muscle=1), _CABLE[0]),
    "broken cable 2": Case(lambda t: BrokenCable(t, muscle=2), _CABLE[1]),
    "P1 drifts up, 0.1 bar/s": Case(lambda t: DriftingSensor(t, sensor=2, rate=0.1 * BAR), _DRIFT[1]),
    "P1 drifts down, 0.1 bar/s": Case(lambda t: DriftingSensor(t, sensor=2, rate=-0.1 * BAR), _DRIFT[1]),
    "P2 drifts up, 0.3 bar/s": Case(lambda t: DriftingSensor(t, sensor=3, rate=0.3 * BAR), _DRIFT[2]),
    "P2 drifts down, 0.3 bar/s": Case(lambda t: DriftingSensor(t, sensor=3, rate=-0.3 * BAR), _DRIFT[2]),
    "angle drifts, 20°/s": Case(lambda t: DriftingSensor(t, sensor=0, rate=20 * DEG), _DRIFT[0]),
    "angle silent": Case(lambda t: SilentSensors(t, sensors=(0,)), _SILENT[0]),
    "P1 silent": Case(lambda t: SilentSensors(t, sensors=(2,)), _SILENT[1]),
    "angle frozen": Case(lambda t: FrozenSensors(t, sensors=(0,)), _FROZEN[0]),
    "P1 frozen": Case(lambda t: FrozenSensors(t, sensors=(2,)), _FROZEN[1]),
}
FAULTY = {name: tested.real for name, tested in PLANTS.items()}
MOVED = ("sine", "min-jerk", "steps")  # trajectories with faults
ONSETS = 2.0, 4.6, 6.0  # [s]
SOUND: dict[str, RealPlant] = FAULTY | {name: t.real for name, t in VARIANTS.items() if t.N == 20}
LOADS = 0.0, 1.0, -2.0, 3.0  # [N·m], from LOAD_FROM on
STRANGERS = tuple(f"{structure} {seed}" for structure in STRUCTURES for seed in (REPORTING, REPORTING + 1))
IDENTIFIED = tuple(f"{name} identified" for name in STRANGERS)  # the same, with the models that are fitted to them
PAYLOADS = 0.0, 1.0  # [N·m] of strangers, with their inertia
LOAD_FROM = 5.0  # [s]


def with_fault(plant: str, fault: str, onset: float) -> RealPlant | Stranger:
    """Return the plant of that name, with the fault from `onset` [s] on."""
    real = FAULTY[plant] if plant in FAULTY else stranger(plant)
    return replace(real, faults=(FAULTS[fault].begun(onset),))


def with_load(plant: str, load: float) -> RealPlant | Stranger:
    """Return the plant of that name under `load` [N·m]."""
    if plant in SOUND:
        return replace(SOUND[plant], torque_profile=((LOAD_FROM, load),))
    return stranger(plant).loaded(load, LOAD_FROM)


def stranger(name: str) -> Stranger:
    """Return the stranger of a name of `STRANGERS` or `IDENTIFIED`."""
    structure, seed = name.split()[:2]
    return drawn(structure, int(seed))
