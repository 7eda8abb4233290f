"""Pressures that are measured beside the commands tell the dead time, and the angle the age of its readings."""

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from allocator.errors import InvalidFile
from allocator.files.atomic import write_text
from allocator.identification import fit_motion
from allocator.identification.motion.samples import read_motion_log
from mpc import Compensation, Plant, RealPlant
from mpc.identification.plant import IdentifiedPlant, replay
from mpc.model.friction.maxwell_slip import MaxwellSlip

from ....rigs.moving_joint import JOINT, LAG, STEP, WIDTH
from ....rigs.once import once

pytestmark = pytest.mark.compiles

DEAD_TIME, AGE = 0.03, 0.05
OFFSET = (0.02 * BAR, -0.03 * BAR)


def log(age, seconds=60.0, gas=False):
    """Times, angle, commands and measured pressures of random steps."""
    plant = Plant(JOINT, inertia=0.2, damping=0.4, lag=LAG, gas=gas)
    slip = MaxwellSlip.of_width(plant, WIDTH)
    real = RealPlant(
        plant, friction=slip, dead_time=DEAD_TIME, reading_age=age, pressure_noise=0.02 * BAR, pressure_offset=OFFSET
    )
    rng, under_way = np.random.default_rng(0), real.begin(STEP, np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]), 0)
    u, until, rows = np.full(2, 2.5 * BAR), 0, []
    for k in range(round(seconds / STEP)):
        if k == until:
            u, until = rng.uniform(1.6, 3.8, 2) * BAR, k + int(rng.uniform(0.4, 1.5) / STEP)
        y = under_way.measure()
        rows.append([k * STEP, 0.05 * DEG * np.round(y[0] / (0.05 * DEG)), *u, y[2], y[3]])
        under_way.advance(u)
    return np.array(rows).T


@pytest.fixture(scope="session", params=[AGE, 0.0])
def fitted(request, tmp_path_factory):
    """The age, and the fit."""
    age = request.param

    def fit():
        t, theta, u1, u2, P1, P2 = log(age)
        return fit_motion(t, theta, u1, u2, joint=JOINT, measured=(P1, P2), gas=False)

    return age, once(tmp_path_factory, f"aged_{age}", fit)


def test_dead_time_and_age_are_found_apart_within_their_intervals(fitted):
    age, fit = fitted
    dead, old = fit.parameters["dead_time"], fit.parameters["reading_age"]
    assert dead.value == pytest.approx(DEAD_TIME, abs=0.003)
    assert old.value == pytest.approx(age, abs=0.005)
    assert dead.low < DEAD_TIME < dead.high
    assert old.low <= age < old.high
    assert fit.parameters["lag_up"].value == pytest.approx(LAG, rel=0.03)
    assert not any("counted as dead time" in sentence for sentence in fit.unseen)


def test_both_are_in_the_plant_s_file_which_predicts_the_angle_as_it_is_read(fitted, tmp_path):
    age, fit = fitted
    plant = IdentifiedPlant.of(fit)
    plant.save(tmp_path / "plant.toml")
    told = Compensation.load(tmp_path / "plant.toml")
    assert told.dead_time == pytest.approx(DEAD_TIME, abs=0.004)
    assert told.reading_age == pytest.approx(age, abs=0.005)
    if age:
        text = (tmp_path / "plant.toml").read_text(encoding="utf-8")
        write_text(tmp_path / "new.toml", text.replace("[sensors]  # s\nreading_age = ", "[source.was]\nage = "))
        assert replay(tmp_path / "new.toml", fit.log).errors().every > 1.5 * plant.errors.every


@pytest.mark.slow
def test_gas_that_motion_compresses_is_told_from_the_regulators():
    t, theta, u1, u2, P1, P2 = log(AGE, gas=True)
    found = fit_motion(t, theta, u1, u2, joint=JOINT, measured=(P1, P2)).parameters
    truths = {"dead_time": DEAD_TIME, "reading_age": AGE, "lag_up": LAG, "lag_down": LAG, "volume": 1.0}
    for name, truth in truths.items():
        assert found[name].low < truth < found[name].high
        assert found[name].value == pytest.approx(truth, rel=0.12)


def test_a_row_per_sample_is_asked_for():
    t = np.arange(0, 20, 0.05)
    P = 2.5 * BAR + BAR * np.sign(np.sin(t))
    with pytest.raises(InvalidInput, match="measured has to be two rows"):
        fit_motion(t, 0.3 * np.sin(t), P, 5 * BAR - P, measured=(P[1:], P[1:]))


def test_columns_of_measured_pressures_are_read_and_one_alone_is_refused(tmp_path):
    t, theta, u1, u2, P1, P2 = log(0.0, seconds=20.0)
    path, head = tmp_path / "log.csv", "time_s,theta_deg,P1_bar,P2_bar,measured1_bar,P2_measured_bar"
    table = np.stack([t, theta / DEG, u1 / BAR, u2 / BAR, P1 / BAR, P2 / BAR], axis=1)
    np.savetxt(path, table, delimiter=",", header=head, comments="")
    read = read_motion_log(path)
    np.testing.assert_allclose(read.measured, [P1, P2])
    write_text(path, path.read_text(encoding="utf-8").replace("P2_measured_bar", "other"))
    with pytest.raises(InvalidFile, match="only one of measured1 and measured2"):
        read_motion_log(path)
