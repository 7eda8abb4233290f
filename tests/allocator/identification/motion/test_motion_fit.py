"""A moving joint is recovered from its log, of plants whose truth is known and of measured ones."""

from pathlib import Path

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidInput
from allocator.identification import fit_motion
from allocator.identification.motion.intervals import _estimates
from allocator.identification.motion.samples import MotionLog, read_motion_log
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import Plant

from ....rigs.moving_joint import DEAD_TIME, JOINT, LAG, WIDTH

pytestmark = pytest.mark.slow
SLOW_K = float(JOINT.stiffness(0.0, 2.7 * BAR, 2.7 * BAR))  # N·m/rad, at the mean pressures


def inside(estimate, truth):
    return estimate.low <= truth <= estimate.high


@pytest.fixture
def fit(slow_fit):
    return slow_fit


def test_lags_and_hysteresis_of_a_plant_of_another_structure_lie_in_the_intervals(fit):
    found = fit.parameters
    assert inside(found["lag_up"], LAG)
    assert inside(found["lag_down"], LAG)
    assert inside(found["dead_time"], DEAD_TIME)
    assert inside(found["damping"], 0.05 / SLOW_K)
    assert inside(found["inertia"], 0.002 / SLOW_K)
    assert inside(found["loop_width"], WIDTH)
    assert found["loop_width"].low > 2 * DEG
    assert inside(found["gain"], 1.0)


def test_friction_with_springs_of_its_own_is_told_from_shares_of_the_stiffness(fit, slow_joint):
    plant = Plant(JOINT, inertia=0.002, damping=0.05, lag=LAG, gas=False)
    true, found = MaxwellSlip.of_width(plant, WIDTH).loop, fit.joint.loop
    assert not fit.problem.elastic
    H, width = fit.operator, fit.parameters["loop_width"].value  # both where P1 + P2 = 5 bar
    assert 2 * np.dot(H.weights[1:], H.thresholds) == pytest.approx(width, rel=1e-9)
    assert H.stiffness == pytest.approx(float(JOINT.stiffness(0.0, 2.5 * BAR, 2.5 * BAR)), rel=0.05)
    for filled in (4 * BAR, 7 * BAR):
        K = float(JOINT.stiffness(0.0, filled / 2, filled / 2))
        for amplitude in (2 * DEG, 5 * DEG):
            added = [loop.secant(amplitude).added(K, 0.0, filled) for loop in (true, found)]
            assert added[1] == pytest.approx(added[0], rel=0.15)


def test_what_the_log_does_not_show_is_left_out_and_named(fit):
    assert {"dead_band", "filling"}.isdisjoint(fit.parameters)
    said = " ".join(fit.unseen)
    assert "the dead band" in said
    assert "how fast the valves can fill" in said
    assert "the age of the angle's readings, counted as dead time" in said


def test_the_rest_of_the_log_is_predicted_without_any_measured_angle(fit, slow_joint):
    assert fit.held_out.every < 0.2 * DEG < 0.02 * slow_joint.theta.std()
    half = slice(0, 1500)
    again = fit.predicted(slow_joint.t[half], slow_joint.P1[half], slow_joint.P2[half])
    np.testing.assert_allclose(again, fit.run.theta[half], rtol=0, atol=1e-9)


def test_where_no_joint_is_given_there_is_no_plant(slow_joint):
    fit = fit_motion(*slow_joint.rows)
    assert "gain" not in fit.parameters
    assert fit.held_out.every < 1.5 * DEG
    with pytest.raises(InvalidInput, match="no joint was given"):
        _ = fit.joint


def test_clipped_pressures_leave_the_motion_unexplained_and_a_warning(slow_joint, fit):
    t, theta, P1, P2 = slow_joint.rows
    clipped = fit_motion(t, theta, np.minimum(P1, 2.0 * BAR), np.minimum(P2, 2.0 * BAR))
    assert any("are they clipped or of another joint" in warning for warning in clipped.warnings)
    assert not fit.warnings


def test_rows_at_a_stop_are_left_out(slow_joint, fit):
    t, theta, P1, P2 = slow_joint.rows
    ends = np.quantile(theta, [0.15, 0.8])
    stopped = fit_motion(t, np.clip(theta, *ends), P1, P2, joint=JOINT)
    said = [warning for warning in stopped.warnings if "taken for an end stop, and left out of the fit" in warning]
    assert len(stopped.warnings) == len(said) == 2
    assert stopped.parameters["gain"].value == pytest.approx(fit.parameters["gain"].value, rel=0.03)
    for name in ("lag_up", "lag_down", "loop_width"):
        assert inside(stopped.parameters[name], fit.parameters[name].value)


def test_a_joint_that_swings_shows_its_inertia_and_its_hysteresis(swinging_joint, swinging_fit):
    (plant, _), fit = swinging_joint, swinging_fit
    K = float(plant.stiffness((0.0, 0.0, 2.7 * BAR, 2.7 * BAR)))
    assert inside(fit.parameters["inertia"], plant.inertia / K)
    assert fit.parameters["inertia"].low > 0
    assert inside(fit.parameters["loop_width"], WIDTH)
    assert fit.parameters["loop_width"].low > 1.5 * DEG
    assert inside(fit.parameters["lag_up"], LAG)
    assert inside(fit.parameters["lag_down"], LAG)


def test_swapped_muscles_wrong_units_and_pressures_never_seen_are_refused(fit, slow_joint):
    log = slow_joint
    with pytest.raises(InvalidInput, match="the muscles are swapped, or the angle has the other sign"):
        fit_motion(log.t, log.theta, log.P2, log.P1, joint=JOINT)
    with pytest.raises(InvalidInput, match=r"log go up to 37\.9 bar, those of the joint up to 5 bar: check the unit"):
        fit_motion(log.t, log.theta, 10 * log.P1, 10 * log.P2, joint=JOINT)
    with pytest.raises(InvalidInput, match=r"P1 goes up to 6\.\d* bar, and that of the log that was fitted up to 3.7"):
        fit.predicted(log.t[:500], log.P1[:500] + 3 * BAR, log.P2[:500])


# --- measured logs, and those of the strangers ----------------------------------------------------------------------


def test_a_measured_joint_is_predicted_within_4_1_degrees_and_3_3_where_taut(measured):
    fit = fit_motion(*measured)
    for errors in (fit.held_out, fit.left_out):
        assert errors.every < 4.1 * DEG
        assert errors.taut < 3.3 * DEG
    assert len(fit.blocks) == 5
    assert fit.parameters["lag_up"].high < fit.parameters["lag_down"].high
    assert fit.converged
    assert "stuck_slope" not in fit.parameters  # at its bound: no interval is claimed
    assert any("how far a stuck joint gives" in sentence for sentence in fit.unseen)


COLUMNS = {"theta": "phi:deg", "pressure1": "p1:bar", "pressure2": "p2:bar"}


@pytest.mark.parametrize("kind", ["ramp", "stair"])
def test_the_truth_of_a_strangers_log_lies_in_the_intervals_or_is_named_as_unseen(shared, kind):
    log = read_motion_log(shared(Path("data") / "stranger" / f"log_{kind}.csv"), COLUMNS)
    fit = fit_motion(log.t, log.theta, log.P1, log.P2)
    assert inside(fit.parameters["loop_width"], 3 * DEG)
    assert fit.parameters["loop_width"].low > 1 * DEG
    if kind == "stair":
        assert inside(fit.parameters["lag_up"], 0.2)
        assert inside(fit.parameters["lag_down"], 0.2)
    else:
        assert "lag_up" not in fit.parameters
        assert any(sentence.startswith("the lags") for sentence in fit.unseen)
    assert any("P1 + P2, which stays at 5 bar" in sentence for sentence in fit.unseen)


def test_what_lies_at_the_bound_of_its_search_has_an_interval_all_the_same():
    t = np.arange(0.0, 120.0, 0.02)
    P = 2e5 + 1e5 * np.sign(np.sin(np.arange(t.size) // 100 * 1.7)), 2e5 + 1e5 * np.sign(np.cos(t // 3 * 2.3))
    log = MotionLog.checked(t, np.sin(t), *P)
    here = {"lag_up": 0.0, "base": 0.05}
    found = _estimates(here, [here] * 10, [], {}, log, rms=0.0)
    assert found["lag_up"].high > log.step / 4  # half a sample of lag is no lag to be seen
    assert found["base"].low == 0.0
    assert found["base"].high > 0.05
