"""Simulated joints: the stiffness that a fit gives against the truth, which the fit has not seen."""

import numpy as np
import pytest

from allocator import allocate
from allocator.identification.joint.fit import fit_joint
from allocator.units import DEG

pytestmark = pytest.mark.slow  # fits 16 logs

SEEDS = range(2)  # `benchmarks.identification.joint_coverage` has more


def recovered(joint, simulated, truth, weights, seed):
    """(relative error, error in standard deviations) of K at the samples, and the fit."""
    log = simulated(joint, weights, seed)
    (theta, P1, P2), given = log.fit_arguments()
    law = {"model": type(joint.agonist).__name__, "choices": False}  # the law is the true one: nothing to choose
    fit = fit_joint(theta, P1, P2, **given, **law, geometry=joint.geometry)
    angle = truth(joint, P1, P2, log.torque, log.direction)
    K, found = joint.stiffness(angle, P1, P2), fit.stiffness().value
    return found / K - 1, (found - K) / fit.stiffness_std(), fit


@pytest.fixture(scope="module")
def recoveries(all_twins, log_maker, truth_of):
    """Errors by (twin, weights a side); each seed has a noise of its own."""
    return {
        (name, weights): [recovered(joint, log_maker, truth_of, weights, [number, weights, seed]) for seed in SEEDS]
        for number, (name, joint) in enumerate(all_twins.items())
        for weights in (1, 3)
    }


@pytest.mark.parametrize(("weights", "most"), [(3, 0.05), (1, 0.12)])
def test_stiffness_is_known_to_5_percent_with_three_weights_a_side_and_12_with_one(
    recoveries, all_twins, weights, most
):
    for name in all_twins:
        errors = np.concatenate([error for error, _, _ in recoveries[name, weights]])
        assert np.sqrt(np.mean(errors**2)) < most, name


@pytest.mark.parametrize("weights", [1, 3])
def test_the_stated_standard_deviation_covers_the_truth_in_90_percent_and_is_not_twice_too_wide(
    recoveries, all_twins, weights
):
    sigmas = np.concatenate([sigmas for name in all_twins for _, sigmas, _ in recoveries[name, weights]])
    assert (np.abs(sigmas) < 1.96).mean() >= 0.90
    assert 0.5 < np.sqrt(np.mean(sigmas**2)) < 1.25  # few groups have a weight if there is one: they count for less


def test_friction_and_the_equal_strength_of_the_muscles_are_found(recoveries):
    for fits in recoveries.values():
        assert np.mean([fit.friction for *_, fit in fits]) == pytest.approx(0.13, abs=0.005)
        assert np.mean([fit.ratio for *_, fit in fits]) == pytest.approx(1.0, abs=0.01)
        assert np.mean([fit.zero for *_, fit in fits]) == pytest.approx(0.0, abs=0.6 * DEG / np.sqrt(len(SEEDS)))


def test_the_scatter_of_the_angles_is_the_noise_that_was_put_in(recoveries):
    rms = [fit.rms for fits in recoveries.values() for *_, fit in fits]
    assert np.sqrt(np.mean(np.square(rms))) == pytest.approx(0.5 * DEG, rel=0.1)


def test_the_uncertainty_of_the_scale_reaches_the_allocation(recoveries, all_twins):
    *_, fit = recoveries["sarosi-pulley", 1][0]
    answer = allocate(0.1, 5.0, 0.2, joint=fit.joint)
    assert answer.success
    assert 0.3 * fit.scale_std < answer.K_std / answer.K < 3 * fit.scale_std
