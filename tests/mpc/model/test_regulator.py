"""Pressures that fall more slowly than they rise: in the model, its file, the feed-forward and the loop."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidInput
from mpc import Compensation, KalmanObserver, Plant, RealPlant, TrackingMPC, margins, simulate, sine
from mpc.codegen.buffered import Buffered
from mpc.model.experiment import FINE
from mpc.model.pressures import each_way, pull, ratio
from mpc.trials.margins import linear_model

from ...rigs.followed import missed

UNEQUAL = Plant(lag=(0.1, 0.15), venting=1.5)
DT = 0.01


def test_a_regulator_fills_with_one_lag_and_vents_with_the_other():
    e = np.array([-2.0, -1e-3, 0.0, 1e-3, 2.0])
    np.testing.assert_allclose(pull(e, 0.08, 0.12), np.where(e > 0, e / 0.08, e / 0.12), rtol=1e-12)


def test_the_lag_is_the_mean_of_both_ways_and_their_ratio_is_given():
    rising, falling = each_way((0.1, 0.15), 1.5)
    np.testing.assert_allclose(np.add(rising, falling) / 2, (0.1, 0.15))
    np.testing.assert_allclose(np.divide(falling, rising), 1.5)
    assert UNEQUAL.lags_each_way == (rising, falling)
    assert Plant(lag=0.1).lags_each_way == ((0.1, 0.1), (0.1, 0.1))


def test_lags_that_hardly_differ_count_as_one():
    assert ratio(0.119, 0.12) == 1.0
    assert ratio(0.08, 0.12) == pytest.approx(1.5)
    assert ratio(0.12, 0.08) == pytest.approx(2 / 3)


@pytest.mark.parametrize("venting", [0.0, -1.0, np.nan])
def test_a_ratio_that_is_not_positive_is_refused(venting):
    with pytest.raises(InvalidInput, match="venting"):
        Plant(venting=venting)


def test_the_commands_of_the_feed_forward_drive_rising_and_falling_pressures_along_the_reference():
    """Half a second at 1 Hz; a feed-forward for the mean lags misses the pressures by fifty times as much."""
    N, t = 50, DT * np.arange(51)
    theta, K = 0.3 * (1 - np.cos(6 * t)), np.full(N + 1, 7.6)
    known, mean = (missed(UNEQUAL, model, theta, K, DT) for model in (UNEQUAL, replace(UNEQUAL, venting=1.0)))
    assert 50 * known < mean


def test_a_file_with_both_lags_of_the_regulators_gives_their_ratio_unless_it_has_one_itself(tmp_path):
    path = tmp_path / "plant.toml"
    Plant(lag=0.1).save(path)
    text = path.read_text(encoding="utf-8").replace("venting = 1.0\n", "")
    path.write_text(text + "\n[regulators]\nlag_up = 0.08\nlag_down = 0.12\n", encoding="utf-8")
    plant, known = Plant.load(path), Compensation.load(path)
    assert plant.venting == pytest.approx(1.5)
    assert known.untold(plant) == ""
    assert (
        known.untold(replace(plant, venting=1.0))
        == "lag 0.08 s of a rising pressure and lag 0.12 s of a falling pressure"
    )
    path.write_text(path.read_text(encoding="utf-8").replace("[plant]", "[plant]\nventing = 1.2"), encoding="utf-8")
    assert Plant.load(path) == replace(plant, venting=1.2)
    plant.save(path)
    assert Plant.load(path) == plant


def test_a_simulated_plant_without_lags_of_its_own_has_those_of_its_model():
    np.testing.assert_allclose(RealPlant(UNEQUAL).lags, np.transpose(UNEQUAL.lags_each_way))


@pytest.mark.compiles
def test_a_loop_that_knows_both_lags_follows_better_than_one_that_knows_their_mean():
    real = RealPlant(UNEQUAL)
    reference = sine(20 * DEG, 0.5, K=7.6, duration=4.0)

    def error(model):
        run = simulate(real, TrackingMPC(model, DT), reference, observer=KalmanObserver(model, DT))
        return np.sqrt(np.mean((run.theta - run.theta_ref)[200:] ** 2))

    assert 20 * error(UNEQUAL) < error(replace(UNEQUAL, venting=1.0))


def test_margins_are_those_of_equal_lags():
    with pytest.raises(InvalidInput, match="linear_model"):
        margins(TrackingMPC(UNEQUAL, DT, compiled=False), KalmanObserver(UNEQUAL, DT, compiled=False))
    assert linear_model(UNEQUAL).lags_each_way[0] == pytest.approx(UNEQUAL.lags)
    assert linear_model(Plant()) == Plant()


def test_commands_in_bar_of_the_supply_are_reached_from_both_sides():
    """A step of a bar up and down: 63 % of the way after the lag of that way."""
    plant = replace(UNEQUAL, gas=False)
    (up, _), (down, _) = plant.lags_each_way
    for lag, way in ((up, 1.0), (down, -1.0)):
        step = Buffered(plant.discrete(lag, FINE))
        x = step(np.array([0.0, 0.0, 2 * BAR, 2 * BAR]), np.array([2 + way, 2.0]) * BAR, 0.0)[0][0]
        assert (x[2] / BAR - 2) / way == pytest.approx(1 - np.exp(-1), rel=1e-3)
