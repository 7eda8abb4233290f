"""Faults of two joints are named by the names of their joints and muscles, and nothing is named of a sound arm."""

from dataclasses import replace

import numpy as np
import pytest

from allocator.units import BAR, DEG
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.model.arm.model import Arm
from mpc.model.faults import (
    BrokenCable,
    DriftingSensor,
    FrozenSensors,
    Leak,
    SilentSensors,
    StuckValve,
    SupplyDrop,
    WrongReadings,
)
from mpc.observer.filter import CALM_NOISE
from mpc.observer.health import FaultKind, Part, Reaction, Suspect
from mpc.observer.kalman import KalmanObserver

pytestmark = pytest.mark.compiles

ARM = Arm.machine("arm26")
JOINTS, MUSCLES = ARM.mechanism.joint_names, ARM.mechanism.muscle_names
REST = ARM.at_rest(ARM.middle, [[12.0, 4.6], [4.6, 9.5]])
SWING = 0.4 * BAR * np.array([1, -1, 0.7, -0.7, 0.5, -0.5])
DT, BEGIN, MANY = 0.01, 1.2, {"joints": 2, "muscles": 6}
ANGLE, PRESSURE = f"angle of {JOINTS[0]}", f"pressure of {MUSCLES[4]}"


@pytest.fixture(scope="module", params=[False, True], ids=["no gas", "gas"])
def observer(request):
    return KalmanObserver(replace(ARM, gas=request.param), DT, CALM_NOISE)


def healths(observer, *faults, seconds=2.4, load=0.0):
    """What is said sample by sample while commands swing the arm, and the errors of the angles that are estimated."""
    observer.reset()
    plant = MujocoPlant.of(observer.plant, faults=faults, encoder=0.02 * DEG, pressure_noise=0.02 * BAR)
    run, u, said, errors = plant.begin(DT, REST, 1), REST[4:], [], []
    for k in range(round(seconds / DT)):
        x, _ = observer.estimate(run.measure(), u)
        said.append(observer.health)
        errors.append(np.abs(x[:2] - run.x[:2]))
        u = REST[4:] + SWING * np.sin(2 * np.pi * k * DT)
        run.advance(u, load * np.clip(2 * (k * DT - BEGIN), 0, 1))
    return said, np.array(errors)


def test_nothing_is_named_of_a_sound_arm(observer):
    said, errors = healths(observer)
    assert all(health.well for health in said)
    assert errors.max() < 0.1 * DEG


@pytest.mark.parametrize(
    ("fault", "named"),
    [
        (Leak(BEGIN, muscle=1, **MANY), Suspect(FaultKind.LEAK, MUSCLES[0])),
        (StuckValve(BEGIN, muscle=4, **MANY), Suspect(FaultKind.STUCK_VALVE, MUSCLES[3])),
        (BrokenCable(BEGIN, muscle=5, **MANY), Suspect(FaultKind.BROKEN_CABLE, MUSCLES[4])),
        (DriftingSensor(BEGIN, sensor=8, rate=0.5 * BAR, **MANY), Suspect(FaultKind.DRIFTING_SENSOR, PRESSURE)),
        (SilentSensors(BEGIN, sensors=(8,), **MANY), Suspect(FaultKind.SILENT_SENSOR, PRESSURE)),
        (FrozenSensors(BEGIN, sensors=(0,), **MANY), Suspect(FaultKind.FROZEN_SENSOR, ANGLE)),
        (SupplyDrop(BEGIN, supply=2.4 * BAR, **MANY), Suspect(FaultKind.SUPPLY_DROP, Part.SUPPLY)),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, Suspect) else "",
)
def test_a_fault_is_among_the_suspects_soon_and_nothing_before(observer, fault, named):
    said, _ = healths(observer, fault)
    onset = round(BEGIN / DT)
    assert all(health.well for health in said[:onset])
    alarm = next(k for k, health in enumerate(said) if not health.well)
    assert (alarm - onset) * DT <= 0.9
    hidden = isinstance(fault, DriftingSensor) and observer.plant.gas is not None  # at first it is one with an offset
    after = 25 if hidden else 10
    assert named in said[alarm + after].suspects
    assert any(named in health.suspects for health in said[-30:])


def test_a_usual_load_is_found_and_nothing_is_named(observer):
    said, _ = healths(observer, load=np.array([0.0, 2.0]))
    assert all(health.well for health in said)
    assert observer.belief.xi[-2:] == pytest.approx([0.0, 2.0], abs=0.3)


def test_an_angle_that_is_lost_is_worth_a_halt():
    assert Suspect(FaultKind.FROZEN_SENSOR, ANGLE).reaction is Reaction.HOLD
    assert Suspect(FaultKind.FROZEN_SENSOR, PRESSURE).reaction is Reaction.NONE


def test_an_angle_that_is_off_for_five_samples_does_not_move_the_estimate(observer):
    off = WrongReadings(BEGIN, BEGIN + 0.05, sensors=(0,), value=0.5, added=True, **MANY)
    _, errors = healths(observer, off, seconds=1.4)
    assert errors.max() < 0.2 * DEG
