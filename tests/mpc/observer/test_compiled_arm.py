"""The compiled estimate of an arm is that of the readable observer, and leaves to it what is not ordinary."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from mpc import Compensation, KalmanObserver
from mpc.model.arm.model import Arm
from mpc.model.faults import BrokenCable, DriftingSensor, FrozenSensors, Leak, SilentSensors, StuckValve
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealArm

from .test_compiled import DT, Pair

pytestmark = [pytest.mark.compiles, pytest.mark.slow]

ARM = Arm.machine("arm26")
SLIP = tuple(MaxwellSlip.of_width(ARM, 4 * DEG, joint=i) for i in range(2))
TOLD = Compensation(frictions=SLIP, dead_time=0.02, dead_band=0.05 * BAR, reading_age=0.02)
REST = ARM.at_rest(ARM.middle, np.diag([9.0, 8.0]))
REAL = RealArm.of(
    ARM, TOLD, force_gains=(0.95, 1.04, 1.0, 0.97, 1.05, 1.0), encoder=0.02 * DEG, pressure_noise=0.01 * BAR,
    pressure_offset=(0.02 * BAR,) * 6, torque_profile=((2.0, (0.5, -0.3)),),
)  # fmt: skip
PUSH = np.array([1.0, -1.4, 0.5, -0.5, 1.0, -1.0])


def swinging(k):
    """Commands that move both joints, with a rest in which encoders repeat themselves."""
    return REST[4:] + 0.15 * BAR * np.sin(k / 15) * PUSH * (k % 300 < 240)


def run(pair, real, samples, seed=1):
    experiment, said = real.begin(DT, REST, seed), set()
    for k in range(samples):
        pair.estimate(experiment.measure(), swinging(k - 1) if k else REST[4:])
        experiment.advance(swinging(k))
        said.add(str(pair.compiled.health))
    pair.same()
    return np.array(pair.taken), said


KNOWN = {
    "all effects": TOLD,
    "nothing": Compensation(),
    "Dahl's friction": Compensation(Friction(mu=0.02), dead_time=0.03),
}


@pytest.mark.parametrize("known", KNOWN.values(), ids=KNOWN.keys())
def test_a_long_noisy_run_is_that_of_the_readable_observer(known):
    taken, _ = run(Pair(ARM, compensation=known), REAL, 400)
    assert taken[4:].mean() > 0.95


FAULTS = {
    "leak": Leak(1.0, muscle=1, joints=2, muscles=6),
    "stuck valve": StuckValve(1.0, muscle=2, joints=2, muscles=6),
    "broken cable": BrokenCable(1.0, muscle=1, joints=2, muscles=6),
    "drifting sensor": DriftingSensor(1.0, sensor=4, rate=0.3 * BAR, joints=2, muscles=6),
    "frozen angle": FrozenSensors(1.0, 2.0, sensors=(0,), joints=2, muscles=6),
    "silent pressure": SilentSensors(1.0, 2.0, sensors=(5,), joints=2, muscles=6),
}


@pytest.mark.parametrize("fault", FAULTS.values(), ids=FAULTS.keys())
def test_whatever_is_broken_verdicts_and_health_are_those_of_the_readable_observer(fault):
    taken, said = run(Pair(ARM, compensation=TOLD), replace(REAL, faults=(fault,)), 300, seed=3)
    assert taken[4:100].all()
    assert taken[100:].any()
    assert len(said) > 1


def test_arms_that_differ_in_numbers_and_friction_share_what_is_compiled():
    other = replace(ARM, lag=tuple(1.1 * lag for lag in ARM.lag))
    one, two = KalmanObserver(ARM, DT), KalmanObserver(other, DT, compensation=TOLD)
    assert one.compiled.module is two.compiled.module


def test_with_gas_it_is_that_of_the_readable_observer():
    filled = replace(ARM, gas=True)
    taken, _ = run(Pair(filled, compensation=TOLD), replace(REAL, nominal=filled), 300, seed=2)
    assert taken[4:].mean() > 0.95
