"""The plant to test against: without its effects it is the nominal one, and each effect is what it says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.model.experiment import FINE
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.real import RealPlant
from mpc.model.real_experiment import delayed, fine_steps

DT = 0.01
PLANT = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12)
REST = PLANT.at_rest(0.0, 5.5)


def states(process, commands, x0=REST, dt=DT, seed=0):
    experiment = process.begin(dt, x0, seed)
    found = [experiment.x]
    for u in commands:
        experiment.advance(u)
        found.append(experiment.x)
    return np.array(found)


def stepped(steps, change=(0.5, -0.3)):
    return np.tile(REST[2:] + np.array(change) * BAR, (steps, 1))


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 2**31))
def test_without_effects_it_is_the_nominal_plant(seed):
    u = REST[2:] + BAR * np.random.default_rng(seed).uniform(-1, 1, (30, 2))
    real = RealPlant.standard(torque_profile=((0.0, 1.0),))
    off = real.without(*(set(real.__dataclass_fields__) - {"nominal"}))
    np.testing.assert_allclose(states(off, u), states(PLANT, u), rtol=1e-9, atol=1e-9)
    experiment = off.begin(DT, REST, seed)
    np.testing.assert_array_equal(experiment.measure()[[0, 2, 3]], REST[[0, 2, 3]])


@pytest.mark.parametrize("dead_time", [0.01, 0.03, 0.014, 0.037])
def test_a_dead_time_moves_the_motion_in_time_and_changes_nothing_else(dead_time):
    prompt = states(RealPlant(PLANT), np.repeat(stepped(10), 10, axis=0), dt=DT / 10)
    late = states(RealPlant(PLANT, dead_time=dead_time), stepped(10))
    for k in range(4, 11):
        np.testing.assert_allclose(late[k], prompt[10 * k - round(dead_time / DT * 10)], rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("structure", [Friction, MaxwellSlip])
@pytest.mark.parametrize("width", [2.5, 5.0])
def test_the_hysteresis_loop_of_a_slow_sweep_is_as_wide_as_asked(width, structure):
    """At P1 + P2 = 5 bar around θ = 0, measured where P1 = P2 passes upwards and downwards."""
    slow = replace(PLANT, damping=0.01)  # so that viscous friction adds nothing
    real = RealPlant(slow, friction=structure.of_width(PLANT, width * DEG))
    quarter = np.linspace(0, 1, 2000)  # 20 s
    half = 0.4 * BAR * np.concatenate([quarter, quarter[-2::-1], -quarter[1:], -quarter[-2::-1], quarter[1:]])
    u = np.stack([2.5 * BAR + half / 2, 2.5 * BAR - half / 2], axis=1)
    x = states(real, u, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]))
    difference, theta = x[:, 2] - x[:, 3], x[:, 0] / DEG
    crossings = np.flatnonzero(difference[1:-1] * difference[2:] < 0) + 1
    down, up = (
        np.interp(0.0, *(v[k : k + 2][::s] for v in (difference, theta)))
        for k, s in zip(crossings[-2:], (-1, 1), strict=True)
    )
    assert abs(up - down) == pytest.approx(width, rel=0.01)


def test_the_friction_torque_s_closed_form_is_its_differential_equation():
    theta = 2 * DEG * np.concatenate([np.linspace(0, 1, 4000), np.linspace(1, 0.3, 4000), np.linspace(0.3, 2, 4000)])
    friction, z = Friction(0.1), [0.2]
    for motion in np.diff(theta):
        z.append(z[-1] + (motion - abs(motion) * z[-1]) / friction.presliding)
    np.testing.assert_allclose(friction.along(0.2, theta), z, atol=1e-3)


@settings(max_examples=50, deadline=None)
@given(st.floats(-1, 1), st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=20))
def test_friction_never_exceeds_its_limit(z, motions):
    assert np.abs(Friction(0.1).along(z, np.cumsum(motions))).max() <= 1


def test_pressures_rest_half_a_dead_band_short_of_the_command():
    x = states(RealPlant(replace(PLANT, gas=False), dead_band=0.1 * BAR), stepped(300))
    np.testing.assert_allclose((x[-1, 2:] - REST[2:]) / BAR, [0.45, -0.25], atol=1e-6)


def test_pressures_rise_and_fall_no_faster_than_the_flow_lets_them():
    x = states(RealPlant(replace(PLANT, gas=False), flow=2 * BAR), stepped(40, (1.5, -1.5)))
    slopes = np.diff(x[:, 2:], axis=0) / DT / BAR
    assert np.abs(slopes).max() == pytest.approx(2.0, rel=1e-6)


def test_force_gains_scale_torque_stiffness_and_forces():
    x = np.array([0.3, 0.0, 3 * BAR, 2 * BAR])
    real, more = RealPlant(PLANT, (1.1, 0.9)), RealPlant(PLANT, (1.1, 1.1))
    F1, F2 = PLANT.forces(x)
    assert real.forces(x) == pytest.approx((1.1 * F1, 0.9 * F2), rel=1e-12)
    assert real.torque(x) == pytest.approx(0.02 * (1.1 * F1 - 0.9 * F2), rel=1e-9)
    assert more.stiffness(x) == pytest.approx(1.1 * PLANT.stiffness(x), rel=1e-12)


def test_a_torque_profile_is_a_torque_from_its_time_on():
    real = RealPlant(replace(PLANT, damping=0.0), torque_profile=((0.05, 1.0), (0.1, 0.0)))
    x = states(real, np.tile(REST[2:], (12, 1)))
    acceleration = np.diff(x[:, 1]) / DT * PLANT.inertia
    assert acceleration[:5] == pytest.approx(0.0, abs=1e-6)
    assert acceleration[5] == pytest.approx(1.0, rel=0.01)
    assert acceleration[9] > 0.5 > 0 > acceleration[11]


def test_sensors_round_add_noise_of_the_stated_size_and_repeat_with_the_seed():
    real = RealPlant(PLANT, encoder=0.02 * DEG, pressure_noise=0.02 * BAR)
    x0 = np.array([0.123456, 0.0, 3 * BAR, 2 * BAR])
    first, again, other = (real.begin(DT, x0, seed) for seed in (1, 1, 2))
    read = np.array([first.measure() for _ in range(2000)])
    np.testing.assert_array_equal(read, [again.measure() for _ in range(2000)])
    assert (read[0, 2:] != other.measure()[2:]).all()
    assert np.isnan(read[:, 1]).all()
    assert read[:, 0] / (0.02 * DEG) == pytest.approx(round(0.123456 / (0.02 * DEG)), abs=1e-9)
    assert (read[:, 2:] - x0[2:]).std() == pytest.approx(0.02 * BAR, rel=0.05)


@pytest.mark.parametrize(
    ("argument", "named"),
    [
        ({"dead_time": -0.1}, "dead_time"),
        ({"flow": 0.0}, "flow"),
        ({"encoder": np.nan}, "encoder"),
        ({"force_gains": (1.0, -1.0)}, "force_gains"),
        ({"torque_profile": ((1.0, 1.0), (0.5, 0.0))}, "torque_profile"),
    ],
)
def test_an_impossible_effect_is_refused_by_its_name(argument, named):
    with pytest.raises(InvalidInput, match=named):
        RealPlant(PLANT, **argument)


@pytest.mark.parametrize(("argument", "named"), [({"mu": -0.1}, "mu"), ({"presliding": 0.0}, "presliding")])
def test_impossible_friction_is_refused_by_its_name(argument, named):
    with pytest.raises(InvalidInput, match=named):
        Friction(**argument)


def test_an_unknown_effect_cannot_be_switched_off():
    with pytest.raises(InvalidInput, match="backlash"):
        RealPlant.standard().without("backlash")


def test_a_lag_that_no_integration_resolves_is_refused_before_it_is_tried():
    with pytest.raises(InvalidInput, match=r"lag_up or lag_down = 1e-09 s is so short"):
        RealPlant(lag_up=1e-9, lag_down=0.1).substeps(0.01, 0.02)
    assert RealPlant(lag_up=1e-3, lag_down=0.1).substeps(0.01, 0.02) == 500


@pytest.mark.parametrize("dead_time", [0.0, 1e-9, 0.0137, 0.02, 0.0299999])
def test_the_commands_of_a_sample_share_its_fine_steps(dead_time):
    real = RealPlant(PLANT, dead_time=dead_time)
    pieces, _ = delayed(dead_time, DT)
    steps, whole = fine_steps(real, DT, pieces), real.substeps(DT, FINE)
    assert min(steps) >= 1
    assert whole <= sum(steps) <= whole + 1
    assert max(np.divide(pieces, steps)) <= DT / whole * (1 + 1e-9)
