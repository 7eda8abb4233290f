"""Stiffness measured by pushing: against the plant's own law, and every distance from the asked one with its cause."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.joint.antagonist import report_joint
from benchmarks.closed_loop.push import Cycle, push, slope
from mpc import Plant, RealPlant, Reference, Weights
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.trials.loops import Settings, loop

pytestmark = pytest.mark.slow

REAL = RealPlant.standard()
MODEL = REAL.nominal


def pushed(real=REAL, model=MODEL, reference=None, K=5.5, theta=0.0, at=4.0, cycle=None):
    reference = Reference([0.0, at], [theta, theta], [K, K]) if reference is None else reference
    settings = Settings(model, compensation=real.known(), weights=Weights.calm())
    return push(real, model, loop("mpc", settings), reference, at, cycle, seed=41)


@pytest.mark.parametrize(
    ("gains", "theta"),
    [((1.1, 0.9), 0.0), ((0.9, 1.1), 20 * DEG), ((1.1, 1.1), 0.0)],
    ids=["standard", "gains swapped, 20°", "both +10 %"],
)
def test_the_measured_stiffness_is_that_of_the_plant(gains, theta):
    found = pushed(RealPlant.standard(gains), theta=theta)
    assert found.measured == pytest.approx(found.true, rel=0.02)
    assert found.theta == pytest.approx(theta, abs=1 * DEG)
    assert sum(found.causes.values()) == pytest.approx(found.measured - found.asked, abs=1e-12)


def test_muscles_stronger_than_the_model_s_are_told_as_its_mismatch():
    """10 % more force at the same pressures is 10 % more stiffness."""
    found = pushed(RealPlant.standard((1.1, 1.1)))
    assert found.causes["mismatch"] == pytest.approx(0.1 * found.modelled, rel=1e-6)
    assert abs(found.causes["saturation"]) + abs(found.causes["dynamics"]) < 0.02
    assert found.estimated == pytest.approx(found.asked, rel=0.01)  # nobody in the loop can know


def test_a_stiffness_that_the_joint_cannot_have_is_told_as_saturation():
    plain = RealPlant(MODEL)
    found = pushed(plain, K=12.0)
    most = float(MODEL.stiffness(np.array([0.0, 0.0, 5 * BAR, 5 * BAR])))
    assert found.measured == pytest.approx(most, rel=0.02)
    assert found.causes["saturation"] == pytest.approx(most - 12.0, rel=1e-3)
    assert abs(found.causes["dynamics"]) + abs(found.causes["mismatch"]) < 0.02


def test_pressures_on_their_way_are_told_as_dynamics():
    """Frozen 50 ms after a sudden step of K nothing is where it is planned to be, and nothing else is wrong."""
    step = Reference([0.0, 1.99, 2.0, 4.0], np.zeros(4), [4.5, 4.5, 6.5, 6.5])
    bare = replace(MODEL, gas=False)
    found = pushed(RealPlant(bare), bare, reference=step, at=2.05)
    assert found.causes["dynamics"] == pytest.approx(found.measured - 6.5, abs=0.02)
    assert found.causes["dynamics"] < -0.5


def test_the_report_s_model_is_two_newton_metres_a_radian_off_on_this_plant():
    """With the Tondu2021 model on this plant the true K is about 2 N·m/rad off."""
    found = pushed(model=Plant(report_joint(), lag=0.12), K=7.6)
    assert found.causes["mismatch"] == pytest.approx(-2.0, abs=0.3)
    assert found.measured == pytest.approx(found.true, rel=0.02)
    assert found.estimated == pytest.approx(7.6, rel=0.01)


def test_friction_drops_out_of_the_slope_and_half_the_distance_of_the_branches_is_left():
    """A cycle of T_e = K ψ + z T_f for Dahl's z, quasi-static: a line through all of it would find something else."""
    K, T_f = 5.5, 0.3
    angle = 14 * DEG * np.sin(2 * np.pi * np.linspace(0, 1.25, 2001))
    T_e = K * angle + T_f * Friction(mu=1.0).along(0.0, angle)
    found, friction = slope(angle, T_e)
    assert found == pytest.approx(K, rel=2e-3)
    assert friction == pytest.approx(T_f, rel=2e-3)
    assert abs(np.polyfit(angle, T_e, 1)[0] - K) > 0.05 * K


@pytest.mark.parametrize("structure", [Friction, MaxwellSlip])
def test_whatever_the_structure_of_friction_the_measured_stiffness_is_the_joint_s(structure):
    found = pushed(replace(REAL, friction=structure.of_width(MODEL, 5 * DEG)), K=6.0)
    assert found.measured == pytest.approx(found.true, rel=0.01)


def test_who_pushes_too_softly_to_pass_the_friction_is_told_so():
    with pytest.raises(InvalidInput, match="push harder"):
        pushed(cycle=Cycle(torque=1.0))


def test_the_load_that_is_there_goes_on_while_the_joint_is_pushed():
    found = pushed(replace(REAL, torque_profile=((0.5, 1.0),)), theta=20 * DEG)
    assert found.measured == pytest.approx(found.true, rel=0.02)
    assert found.theta == pytest.approx(20 * DEG, abs=1 * DEG)


def test_with_shut_valves_the_trapped_gas_is_told_as_a_cause_of_its_own():
    gas = Plant(MODEL.joint, lag=0.12, gas=True)
    for shut in (False, True):
        found = pushed(RealPlant(gas), gas, cycle=Cycle(torque=3.0, shut=shut))
        trapped = gas.joint.stiffness(found.theta, *gas.at_rest(0.0, 5.5)[2:], valves="shut") - found.true
        assert found.gas == pytest.approx(trapped if shut else 0.0, rel=1e-3)
        assert found.measured == pytest.approx(found.true + found.gas, rel=0.01)
        assert sum(found.causes.values()) == pytest.approx(found.measured - found.asked, abs=1e-12)


def test_a_slow_push_does_not_find_the_stiffness_at_a_frequency():
    dynamic = Plant(MODEL.joint, gas=True, frequency=2.0)
    with pytest.raises(InvalidInput, match="dynamic stiffness at 2 Hz"):
        push(RealPlant(dynamic), dynamic, None, None, 1.0)
