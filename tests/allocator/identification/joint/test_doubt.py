"""The covariance of a joint's fit against brute force, and against joints whose truth is known."""

import numpy as np
import pytest
from scipy.stats import t

from allocator import Lever
from allocator.identification.identifiability import determine
from allocator.identification.joint.dead_band import estimate_dead_band
from allocator.identification.joint.doubt import covariance as doubt
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.joint.samples import JointSamples
from allocator.units import BAR, DEG
from benchmarks.joint_coverage import Covered, campaign


def test_the_robust_covariance_is_that_of_fits_without_each_cluster_in_turn():
    """A linear problem with errors that clusters share: the delete-one-cluster jackknife, by refitting."""
    rng = np.random.default_rng(3)
    label = np.repeat(np.arange(8), 12)
    X = rng.standard_normal((96, 3)) + rng.standard_normal((8, 3))[label]
    beta = np.array([1.0, -2.0, 0.5])
    y = X @ beta + 3.0 * rng.standard_normal(8)[label] + 0.01 * rng.standard_normal(96)
    best = np.linalg.lstsq(X, y)[0]
    without = [np.linalg.lstsq(X[label != g], y[label != g])[0] - best for g in range(8)]
    jackknife = 7 / 8 * sum(np.outer(d, d) for d in without)
    r = y - X @ best
    found = determine(-X, float(r @ r), ("a", "b", "c"), best)
    robust = doubt._clustered(r, -X, found, label)
    root = doubt._root(found.covariance)
    values = np.linalg.eigvalsh(np.linalg.solve(root, np.linalg.solve(root, jackknife).T))  # in units of the formal
    assert values.min() * (t.ppf(0.975, 7) / 1.959964) ** 2 > 1  # so that nothing is raised to the formal one
    np.testing.assert_allclose(robust, jackknife * (t.ppf(0.975, 7) / 1.959964) ** 2, rtol=1e-5)


def test_no_direction_is_known_better_than_by_the_formal_covariance():
    rng = np.random.default_rng(0)
    X, r = rng.standard_normal((60, 4)), rng.standard_normal(60)
    r -= X @ np.linalg.lstsq(X, r)[0]
    found = determine(X, float(r @ r), ("a", "b", "c", "d"), np.ones(4))
    for label in (np.zeros(60, int), np.arange(60) % 2, np.arange(60) // 3):
        gap = np.linalg.eigvalsh(doubt._clustered(r, X, found, label) - found.covariance)
        assert gap.min() > -1e-12


@pytest.fixture(scope="module")
def wrong(all_twins, log_maker):
    """A fit of another law than the true one."""
    joint = all_twins["martens-pulley"]
    (theta, P1, P2), given = log_maker(joint, 3, noise=0.1 * DEG).fit_arguments()
    return fit_joint(theta, P1, P2, **given, geometry=joint.geometry, model="AffinePolynomial", leave_one_out=False)


def test_other_choices_are_named_with_what_they_change(wrong):
    kinds = {choice.kind for choice in wrong.doubt.choices}
    assert kinds == {"dead band", "law"}
    assert {"MartensBoblan2017"} <= {choice.name for choice in wrong.doubt.choices}
    assert "AffinePolynomial" not in {choice.name for choice in wrong.doubt.choices}
    assert max(choice.stiffness for choice in wrong.doubt.choices) > 0.01


def test_the_change_of_the_unknowns_has_the_effect_of_the_choice_on_stiffness(wrong):
    """`change` to first order moves K at the samples as the other law does, most of the way."""
    law = next(c for c in wrong.doubt.choices if c.name == "MartensBoblan2017")
    x, problem = wrong.x, wrong.problem
    samples = problem.samples

    def K(x):
        u = problem.unknowns(x)
        (eps1, a1, da1), (eps2, a2, da2), l0 = samples.routes(samples.theta - u.zero)
        F1, F2 = u.muscle.law(samples.P1, eps1), u.ratio * u.muscle.law(samples.P2, eps2)
        slopes = u.muscle.slope(samples.P1, eps1), u.ratio * u.muscle.slope(samples.P2, eps2)
        return -(a1**2 * slopes[0] + a2**2 * slopes[1]) / l0 - (da1 * F1 - da2 * F2)

    moved = (K(x + 1e-4 * law.change) - K(x)) / 1e-4 / K(x)
    assert np.sqrt(np.mean(moved**2)) == pytest.approx(law.stiffness, rel=0.35)


def test_standard_deviations_grow_by_what_is_not_noise(wrong):
    formal = np.sqrt(np.diag(wrong.doubt.formal))
    stated = np.array([*wrong.standard_deviations.values()])
    assert (stated >= formal * (1 - 1e-9)).all()
    assert np.median(stated / formal) > 1.5


def test_a_prediction_says_how_far_it_may_be_off(wrong, all_twins, truth_of):
    joint = all_twins["martens-pulley"]
    P1, P2 = np.array([2.6, 3.1, 3.4]) * BAR, np.array([3.2, 2.9, 2.5]) * BAR
    s = np.array([1.0, -1.0, 1.0])
    told = wrong.predict(P1, P2, torque=0.4, direction=s)
    error = truth_of(joint, P1, P2, np.full(3, 0.4), s) - told.theta
    assert (np.abs(error) < 1.96 * told.std).all()
    assert (told.std < 1 * DEG).all()
    assert (wrong.angle_std() >= wrong.rms).all()
    assert np.median(wrong.angle_std()) < 1.5 * wrong.rms
    with pytest.raises(ValueError, match="no group was left out in turn"):
        wrong.predict(P1, P2, geometry=Lever(0.30, 0.25, 0.03, 0.0175))


def test_the_dead_band_is_found_where_muscles_begin_to_act(all_twins, log_maker):
    """Rows with a pressure below 1.7 bar are 6° off, as where a muscle does not act yet."""
    joint = all_twins["martens-pulley"]
    log = log_maker(joint, 3, noise=0.1 * DEG)
    (theta, P1, P2), given = log.fit_arguments()
    dull = np.minimum(P1, P2) < 1.7 * BAR
    shown = theta + np.where(dull, 6 * DEG * np.sign(P1 - P2), 0.0)
    options = {"geometry": joint.geometry, "model": joint.agonist, **given}
    assert estimate_dead_band(shown, P1, P2, **options) == pytest.approx(1.75 * BAR)
    assert estimate_dead_band(theta, P1, P2, **options) == 0


@pytest.mark.slow
def test_the_stated_interval_of_the_stiffness_holds_under_hysteresis_and_a_wrong_law():
    """Three joints of `python -m benchmarks.joint_coverage`; two hundred are counted there."""
    found = [each for each in campaign(range(3, 6)) if isinstance(each, Covered)]
    assert len(found) == 3
    assert np.concatenate([c.inside for c in found]).mean() >= 0.9
    formal = np.concatenate([np.abs(c.error) <= 1.96 * c.formal for c in found])
    assert formal.mean() < 0.8  # what it was, and why
    width = np.concatenate([c.std / c.true for c in found])
    assert np.median(width) < 0.1  # an interval that says nothing would hold as well


@pytest.mark.slow
def test_a_muscle_length_left_out_is_predicted_within_the_stated_interval(shared):
    log = read_joint_log(shared("data/joint_angle_grid.csv"), {1: -1.0, 2: 1.0})
    label = np.array([f"{length * 1e3:.0f}" for length in log.rest_length])
    geometry = {mm: Lever(float(mm) / 1000, 0.1655, 0.05094, 0.051) for mm in np.unique(label).tolist()}

    arrays = {"theta": log.theta, "P1": log.P1, "P2": log.P2, "direction": log.direction, "group": label}

    def some(keep):
        return {name: array[keep] for name, array in arrays.items()}

    law = {"model": "AffinePolynomial", "average": True, "dead_band": 2 * BAR, "choices": False}
    errors, inside = [], []
    for mm, mechanism in geometry.items():
        acting = (label == mm) & (np.minimum(log.P1, log.P2) >= 2 * BAR)
        rows = JointSamples.checked(**some(acting), geometry=geometry).averaged()
        told = fit_joint(**some(label != mm), geometry=geometry, **law).predict(rows.P1, rows.P2, geometry=mechanism)
        errors.append(rows.theta - told.theta)
        inside.append(np.abs(errors[-1]) < 1.96 * told.std)
        assert np.median(told.std) < 5 * DEG
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 1.6 * DEG
    assert np.concatenate(inside).mean() >= 0.9
