"""Strangers obey physics before they judge anybody."""

import numpy as np
import pytest

from allocator import BAR
from benchmarks.strangers import ages, physics
from benchmarks.strangers.plants import STRUCTURES, TUNING, Trial, drawn, elastic, gain
from benchmarks.strangers.runs import CASES, data_sheet, figures

pytestmark = pytest.mark.compiles

REST = np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR])


@pytest.fixture(params=STRUCTURES)
def structure(request):
    return request.param


def test_the_gas_does_the_muscle_s_work(structure):
    """V' = L F_P, and all slopes are slopes."""
    p, eps, h = drawn(structure, TUNING).parts, np.linspace(0.0, 0.25, 26), 1e-6
    A, slope, _ = gain(p, eps)
    (before, _, below), (after, _, above) = gain(p, eps - h), gain(p, eps + h)
    assert (above - below) / (2 * h) == pytest.approx(A, rel=1e-6)
    assert (after - before) / (2 * h) == pytest.approx(slope, rel=1e-6)
    assert (elastic(p, eps + h)[0] - elastic(p, eps - h)[0]) / (2 * h) == pytest.approx(elastic(p, eps)[1], rel=1e-6)
    V = np.array([physics.volume(p, 0, e) for e in eps])
    assert V[:, 1] == pytest.approx(p.rest_length * p.strength[0] * A)
    assert (V[:, 0] > 0).all()


def work_of_cycles(structure, **changed):
    """Work [J] that closed cycles of a load put into a stranger with shut valves."""
    stranger, works, work = drawn(structure, TUNING, dead_band=1e9, leak=0.0, **changed), [], 0.0
    trial = Trial(stranger, 0.01, REST, 0)
    for k in range(1600):
        load, before = np.sin(2 * np.pi * 0.5 * k * 0.01), trial.x[0]
        trial.advance(REST[2:], load)
        work += load * (trial.x[0] - before)
        if k % 200 == 199:
            works.append(work)
            work = 0.0
    return works[3:]


def test_no_cycle_gives_work(structure):
    lossy = work_of_cycles(structure)
    assert min(lossy) > 0.02
    lossless = dict.fromkeys(("damping", "bearing", "creep"), 0.0) | {"slip": np.zeros(physics.SLIPS)}
    least = work_of_cycles(structure, **lossless, inner_damping=80.0)
    assert -1e-4 < min(least)
    assert max(least) < 0.3 * min(lossy)


def test_the_stated_stiffness_is_the_slope_of_the_torque(structure):
    """Torque of the cables at held angles and constant pressures, without hysteresis."""
    stranger = drawn(structure, TUNING, slip=np.zeros(physics.SLIPS), creep=0.0)
    for theta in (-0.4, 0.0, 0.3):
        x = np.array([[theta + step, 0.0, 2.4 * BAR, 2.8 * BAR] for step in (-1e-4, 0.0, 1e-4)])
        K, F = stranger.along(x)
        levers = np.array([[physics.stretch(stranger.parts, i, row[0], 0.1)[1] for i in range(2)] for row in x])
        T = levers[:, 0] * F[:, 0] - levers[:, 1] * F[:, 1]
        assert -(T[2] - T[0]) / 2e-4 == pytest.approx(K[1], rel=1e-5)


def test_seeds_for_tuning_and_reporting_give_different_joints(structure):
    one, same, other = drawn(structure, 0), drawn(structure, 0), drawn(structure, TUNING)
    assert one.parts.inertia == same.parts.inertia != other.parts.inertia


@pytest.mark.slow
def test_a_stranger_is_tracked_and_judged():
    stranger = drawn("tips", TUNING)
    found = figures(stranger, data_sheet(stranger), "mpc", CASES["min-jerk"])
    assert not found.unstable
    assert 0.05 < found.before < 3.0
    assert found.before < found.after


def test_readings_are_made_older_than_the_model_is_told():
    plant, model = ages.older("braid", TUNING, 0.03)
    known = drawn("braid", TUNING).sensors.late * 0.01
    assert model.told.reading_age == pytest.approx(known)
    assert plant.sensors.late * 0.01 == pytest.approx(known + 0.03)
    own, told = ages.older(ages.OWN, 0, 0.03)
    assert (own.reading_age, told.told.reading_age) == (0.03, 0.0)


@pytest.mark.slow
def test_untold_age_makes_a_loop_ring_that_health_names_and_told_age_does_not():
    (untold,), (told,) = (ages.runs(ages.OWN, 0, 0.05, told, ["min-jerk"]) for told in (False, True))
    assert untold.swing > 4.0 > 1.0 > told.swing
    assert untold.named < 1.0
    assert np.isnan(told.named)
    table = "\n".join(ages.ages_table([r._replace(case=case) for case in ("rest", "sine") for r in (untold, told)]))
    assert "| RealPlant | 50 |" in table
