"""The benchmark on real measurements: scores, splits, the shipped sample and folders of one's own."""

import numpy as np
import pytest

from allocator.errors import InvalidFile
from allocator.units import DEG
from benchmarks.real.__main__ import section
from benchmarks.real.arm import compare, table
from benchmarks.real.arm_log import folder, mpi_arm, splits, windows_of
from benchmarks.real.arm_models import ArmModel, hold, stack
from benchmarks.real.scores import Score
from benchmarks.real.sources import ARM, FORCES


def test_scores_are_those_of_known_errors():
    rng = np.random.default_rng(5)
    episode = np.repeat(np.arange(50).astype(str), 4)
    truth = rng.normal(0, 2, (200, 30))
    noise = rng.normal(0, 1, truth.shape)
    score = Score.of(truth + noise, np.full(truth.shape, 1.96), truth, episode)
    assert score.rms == pytest.approx(1, abs=0.03)
    assert score.nrmse == pytest.approx(0.5, abs=0.03)
    assert score.coverage == pytest.approx(0.95, abs=0.01)
    assert score.rms_interval[0] < score.rms < score.rms_interval[1]


def test_intervals_are_wide_if_the_error_is_one_episode():
    error = np.where(np.arange(40) < 4, 5.0, 0.1)[:, None]
    episode = np.repeat(np.arange(10).astype(str), 4)
    truth = np.arange(40.0)[:, None]
    score = Score.of(truth + error, None, truth, episode)
    low, high = score.rms_interval
    assert low < 0.2
    assert high > 1.5
    assert score.median == pytest.approx(0.1)


def test_the_shipped_sample_is_the_one_of_the_scores():
    assert ARM.find(None) == ARM.path
    episodes = mpi_arm()
    assert len({e.name for e in episodes}) == 100
    out = splits(episodes)
    assert out["last fifth in time"].sum() >= 20
    assert not (
        out["last fifth in time"] & ~np.isin([e.name for e in episodes], [e.name for e in episodes][-22:])
    ).any()


def test_the_linear_model_has_its_known_error():
    """6.9, 3.8, 9.8, 6.4° was found by others with other starts of the runs; staying is far worse at joint 3."""
    hold, arx = compare(mpi_arm(), ["hold", "ARX"])[:2]
    np.testing.assert_allclose([j.rms for j in arx.joints], [6.9, 3.8, 9.8, 6.4], rtol=0.2)
    assert hold.joints[2].rms > 2 * arx.joints[2].rms
    assert "**" in "\n".join(table([hold, arx]))


def test_the_stack_weighs_models_by_the_errors_of_left_out_episodes():
    """Errors of 1 and 2 degrees that are independent: the best weights are 0.8 and 0.2, with an error of 0.9."""
    episodes = mpi_arm()[:12]
    windows, past, past_p = windows_of(episodes)
    truth, rng = windows.future, np.random.default_rng(2)
    runs = [truth + rng.normal(0, size * DEG, truth.shape) for size in (1, 2)]
    models = [ArmModel(lambda *_, run=run: (run, None), run) for run in runs]
    mean, half = stack([hold(episodes), *models], episodes).predict(windows, past, past_p)
    np.testing.assert_allclose(mean, 0.8 * runs[0] + 0.2 * runs[1], atol=0.1 * DEG)
    assert np.mean(np.abs(mean - truth) < half) == pytest.approx(0.95, abs=0.01)


def test_a_folder_of_ones_own_is_read(tmp_path):
    e = mpi_arm()[0]
    names = "time_s," + ",".join(f"q{i}_rad" for i in range(1, 5)) + "," + ",".join(f"p{i}" for i in range(1, 9))
    rows = np.concatenate([0.0104 * np.arange(len(e.q))[:, None], e.q, e.p], axis=1)
    for k in range(10):
        np.savetxt(tmp_path / f"{k}.csv", rows, delimiter=",", header=names, comments="", fmt="%.12g")
    own = folder(tmp_path)
    assert [one.name for one in own] == [str(k) for k in range(10)]
    np.testing.assert_allclose(own[0].q, e.q)
    assert windows_of(own)[0].future.shape[1:] == (40, 4)
    (tmp_path / "9.csv").unlink()
    with pytest.raises(InvalidFile, match=r"9 \*.csv in this folder, 10 or more"):
        folder(tmp_path)
    (tmp_path / "9.csv").write_text("time_s,q1_rad,p1\n0,0,0\n")
    with pytest.raises(InvalidFile, match=r"9\.csv: has no column for pressure2 among time_s, q1_rad, p1"):
        folder(tmp_path)


def test_data_that_may_not_be_shipped_are_named_and_other_data_refused(tmp_path):
    assert "Not run: `festo_isometric" in "\n".join(section("a", None, []))
    (tmp_path / FORCES.path.parent).mkdir()
    (tmp_path / FORCES.path).write_text("other")
    with pytest.raises(InvalidFile, match="other data than the benchmark's"):
        FORCES.find(tmp_path)
