"""`RealArm`: equal to its model without effects, and to MuJoCo with them."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealArm

DT = 0.01
ARM = Arm.machine("arm26")
FILLED = np.concatenate([ARM.middle, [0.0, 0.0], np.full(6, 2.5 * BAR)])


def moved(plant, u, samples=50, load=(0.3, -0.2)):
    trial = plant.begin(DT, FILLED, 0)
    for _ in range(samples):
        trial.advance(u, np.array(load))
    return trial.x


@pytest.mark.parametrize("gas", [None, True])
def test_without_effects_it_is_the_model(gas):
    arm, u = replace(ARM, gas=gas), FILLED[4:] + np.linspace(-0.2, 0.3, 6) * BAR
    ours, exact = moved(RealArm(arm), u), moved(arm, u)
    assert ours[:4] == pytest.approx(exact[:4], abs=1e-9)
    assert ours[4:] == pytest.approx(exact[4:], abs=1e-2)


@pytest.mark.slow
def test_with_effects_it_moves_as_in_mujoco():
    pytest.importorskip("mujoco")
    from mpc.arm.mjcf import to_mjcf
    from mpc.arm.mujoco_plant import MujocoPlant

    slips = tuple(MaxwellSlip.of_width(ARM, 4 * DEG, joint=i) for i in range(2))
    effects = {"force_gains": (1.1, 0.9, 1.05, 0.95, 1.0, 1.08), "friction": slips, "dead_time": 0.025}
    effects |= {"dead_band": 0.1 * BAR}
    u = FILLED[4:] + np.linspace(-0.3, 0.4, 6) * BAR
    model = to_mjcf(ARM.mechanism, ARM.bodies)
    limits = {"pressure_limits": ARM.pressure_limits, "lag": ARM.lag, "slew": 1e9, "gas": ARM.gas, "nominal": ARM}
    theirs = MujocoPlant(model, ARM.mechanism.muscles, **limits, **effects)
    ours, free = moved(RealArm(ARM, **effects), u), moved(ARM, u)
    assert ours == pytest.approx(moved(theirs, u), rel=2e-3, abs=2e-3)
    assert np.abs(ours[:2] - free[:2]).max() > 0.02


def test_heavier_links_and_rubbing_hinges_slow_it():
    u = FILLED[4:] + np.array([0.5, -0.5, 0.0, 0.0, 0.0, 0.0]) * BAR
    light, heavy, rubbing = (abs(moved(RealArm(ARM, **how), u, 8)[2]) for how in ({}, {"mass": 1.5}, {"damping": 3.0}))
    assert heavy < 0.9 * light
    assert rubbing < 0.9 * light


def test_sensors_read_late_in_steps_and_not_the_velocities():
    real = RealArm(ARM, encoder=1 * DEG, reading_age=0.02, pressure_offset=tuple(np.arange(6) * 100.0))
    trial = real.begin(DT, FILLED, 0)
    for _ in range(5):
        trial.advance(FILLED[4:], np.array([3.0, 0.0]))
    read = trial.measure()
    assert np.isnan(read[2:4]).all()
    assert read[4:] - trial.x[4:] == pytest.approx(np.arange(6) * 100.0)
    assert np.abs(read[:2] / DEG - np.round(read[:2] / DEG)).max() < 1e-9
    assert abs(read[0]) < abs(trial.x[0]) - 1 * DEG


def test_known_effects_become_those_of_the_arm_and_survive_a_pickle():
    known = Compensation(dead_time=0.02, lag_up=0.08, frictions=(MaxwellSlip.of_width(ARM, 0.05),) * 2)
    real = RealArm.of(ARM, known)
    assert (real.dead_time, real.frictions) == (0.02, known.frictions)
    assert real.lags == tuple((pytest.approx(0.08), 0.1) for _ in range(6))
    assert pickle.loads(pickle.dumps(real)) == real


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"force_gains": (1.0, 1.0)}, "6 numbers"),
        ({"friction": (MaxwellSlip.of_width(ARM, 0.05),) * 3}, "3 frictions for n = 2 joints"),
        ({"mass": 0.0}, "mass"),
        ({"torque_profile": ((1.0, (0.0, np.nan)),)}, "finite pairs"),
    ],
)
def test_wrong_effects_are_one_sentence(wrong, said):
    with pytest.raises(InvalidInput, match=said):
        RealArm(ARM, **wrong)
