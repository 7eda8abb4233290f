"""Logs of many thousand rows, and samples that a force law cannot take."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from allocator import Pulley
from allocator.identification import fit_joint, read_joint_log
from allocator.identification.joint.samples import JointSamples
from allocator.units import BAR, DEG


@pytest.fixture(scope="module")
def repeated(all_twins, log_maker):
    """A joint, and its equilibria written down 200 times, with noise of the angle and of the pressures."""
    joint = all_twins["sarosi-pulley"]
    log, rng, times = log_maker(joint, 3, noise=0), np.random.default_rng(1), 200
    data = {name: np.tile(getattr(log, name), times) for name in ("theta", "P1", "P2", "torque", "direction")}
    data["theta"] = data["theta"] + 0.5 * DEG * rng.standard_normal(data["theta"].size)
    for name in ("P1", "P2"):
        data[name] = data[name] + 0.005 * BAR * rng.standard_normal(data[name].size)
    return joint, data


@pytest.mark.slow
def test_tens_of_thousands_of_equilibria_are_fitted_in_little_memory_and_give_the_joint(repeated):
    joint, data = repeated
    assert data["theta"].size > 10_000
    tracemalloc.start()
    fit = fit_joint(**data, geometry=joint.geometry)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 100e6  # a matrix of the samples by the samples would take 1.5 GB
    assert fit.samples.n <= 1000
    assert fit.samples.measured == data["theta"].size
    K = joint.stiffness(0.1, 3 * BAR, 3 * BAR)
    assert fit.joint.stiffness(0.1, 3 * BAR, 3 * BAR) == pytest.approx(K, rel=0.02)


def test_a_cell_holds_one_direction_and_one_torque_and_its_mean_is_the_mean_of_its_samples(repeated):
    joint, data = repeated
    samples = JointSamples.checked(**data, geometry=joint.geometry)
    binned = samples.binned(100)
    assert binned.n <= 100
    assert binned.cell >= samples.cell
    assert set(binned.torque.round(9)) == set(samples.torque.round(9))
    for i in range(binned.n):
        there = (samples.direction == binned.direction[i]) & np.isclose(samples.torque, binned.torque[i])
        for name in ("P1", "P2"):
            place = np.round(getattr(samples, name) / binned.cell)
            there &= place == np.round(getattr(binned, name)[i] / binned.cell)
        assert binned.theta[i] == pytest.approx(samples.theta[there].mean(), abs=1e-9)


def test_few_samples_are_left_as_they_are(repeated):
    joint, data = repeated
    samples = JointSamples.checked(**data, geometry=joint.geometry)
    assert samples.binned(samples.n) is samples


@pytest.mark.slow
def test_a_raw_log_of_200_000_rows_gives_its_equilibria(tmp_path):
    t = np.arange(200_000) / 100
    step = np.floor(t / 4)
    path = tmp_path / "log.csv"
    table = np.column_stack([t, 5 * (step % 7), 2 + 0.25 * (step % 7), 3 + 0 * t])
    np.savetxt(path, table, "%.6g", ",", header="t,theta_deg,P1_bar,P2_bar", comments="")
    log = read_joint_log(path)
    assert log.rows == 200_000
    assert log.theta.size == 500
    np.testing.assert_allclose(log.theta, 5 * DEG * (np.arange(500) % 7), atol=1e-9)


@pytest.fixture(scope="module")
def stretched(all_twins, log_maker):
    """Equilibria at which a muscle is longer than at rest, which Hildebrandt2005 cannot describe."""
    joint = replace(all_twins["sarosi-pulley"], geometry=Pulley(0.40, 0.02, 0.03), min_contraction=-0.05)
    log = log_maker(joint, 3)
    (theta, P1, P2), given = log.fit_arguments()
    data = {"theta": theta, "P1": P1, "P2": P2, **given, "geometry": joint.geometry}
    eps = [side(theta).contraction for side in (joint.geometry.agonist, joint.geometry.antagonist)]
    return data, int((np.minimum(*eps) < 0).sum())


@pytest.mark.slow
def test_samples_that_the_law_cannot_take_are_left_out_and_counted(stretched):
    data, short = stretched
    assert 0 < short < data["theta"].size / 2
    fit = fit_joint(**data, model="Hildebrandt2005")
    assert fit.samples.dropped == {"a contraction below 0, where Hildebrandt2005 ends": short}


def test_where_no_sample_is_left_the_law_is_named_and_not_the_geometry(stretched):
    data, _ = stretched
    with pytest.raises(ValueError, match=r"no equilibrium is left that Hildebrandt2005 can be fitted to|no start for"):
        fit_joint(**{**data, "geometry": Pulley(0.40, 0.02, -0.15)}, model="Hildebrandt2005")
