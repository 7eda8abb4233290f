"""The covariance of a joint's fit against brute force, and against joints whose truth is known."""

import numpy as np
import pytest

from allocator import Lever
from allocator.identification.joint.doubt import discrepancy as model
from allocator.identification.joint.doubt.covariance import Effects
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.joint.report import parameter_jacobian
from allocator.identification.joint.samples import JointSamples
from allocator.units import BAR, DEG
from benchmarks.identification.joint_coverage import Covered, campaign


def test_the_discrepancy_is_the_posterior_of_a_linear_gaussian_model():
    """The root of the second moment against the textbook formula: flat unknowns follow c, noise comes on top."""
    rng = np.random.default_rng(3)
    n, m, k = 60, 3, 4
    X, B, N = (rng.standard_normal((n, columns)) for columns in (m, k, 6))
    r = B @ rng.normal(0, 0.5, k) + 0.1 * rng.standard_normal(n)
    X, N = np.vstack([X, np.zeros((6, m))]), np.vstack([N, 1e-3 * np.eye(6)])
    e = model.Evidence(np.append(r, np.zeros(6)), X, np.vstack([B, np.zeros((6, k))]), N, n - m - 6)
    Q = np.linalg.qr(np.hstack([X, N]))[0]
    y, Z = (part - Q @ (Q.T @ part) for part in (e.r, e.B))
    C, tau, sigma = model._field(y, Z, e.free)
    root, found_tau, found_sigma = model._posterior(e)
    assert (found_tau, found_sigma) == pytest.approx((tau, sigma))
    assert 0.08 < sigma < 0.12
    mean = C[1:, 0]
    spread = C[1:, 1:] - np.outer(mean, mean)
    flat = np.hstack([X, N])
    shift = np.linalg.lstsq(flat, e.r - e.B @ mean)[0]
    follow = -np.linalg.lstsq(flat, e.B)[0]
    z = np.concatenate([shift[:m], mean, shift[m:]])
    L = np.vstack([follow[:m], np.eye(k), follow[m:]])
    noise = sigma**2 * np.linalg.inv(flat.T @ flat)
    place = np.append(np.arange(m), m + k + np.arange(6))
    moment = np.outer(z, z) + L @ spread @ L.T
    moment[np.ix_(place, place)] += noise
    np.testing.assert_allclose(root @ root.T, moment, rtol=1e-6, atol=1e-9 * moment.max())


def test_an_error_of_the_law_that_the_angles_show_is_found_again():
    """Errors of a force field through the same equations: its size is found, and noise is not taken for it."""
    rng = np.random.default_rng(1)
    X, B = rng.standard_normal((200, 5)), 0.3 * rng.standard_normal((200, 21))
    N = rng.standard_normal((200, 6))
    for true in (0.0, 0.05):
        r = B @ rng.normal(0, true, 21) + X @ rng.standard_normal(5) + 0.01 * rng.standard_normal(200)
        _, tau, sigma = model._posterior(model.Evidence(r, X, B, N, 189))
        assert sigma == pytest.approx(0.01, rel=0.2)
        assert tau < 0.005 if true == 0 else tau == pytest.approx(true, rel=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["sarosi-pulley", "martens-lever"])
def test_the_change_of_forces_and_stiffness_is_imitated_by_the_unknowns(all_twins, log_maker, name):
    """A change within the law comes back as the unknowns that made it, in K and F; none becomes huge."""
    joint = all_twins[name]
    (theta, P1, P2), given = log_maker(joint, 3, noise=0.1 * DEG).fit_arguments()
    fit = fit_joint(
        theta, P1, P2, **given, geometry=joint.geometry, model=type(joint.agonist), choices=False, leave_one_out=False
    )
    effects = Effects.of(fit.problem, fit.x, np.ones(fit.x.size, bool))
    moved = fit.x * (1 + 1e-5 * np.random.default_rng(0).standard_normal(fit.x.size))
    target = effects.difference(fit.problem, moved)
    change = effects.imitated(target[:, None])[:, 0]
    assert np.linalg.norm(effects.gradient @ change - target) < 0.02 * np.linalg.norm(target)
    anything = np.random.default_rng(1).standard_normal((target.size, 1))
    assert np.linalg.norm(effects.gradient @ effects.imitated(anything)) <= np.linalg.norm(anything)


@pytest.mark.slow
def test_readings_of_a_few_setpoints_never_state_absurd_intervals(all_twins, log_maker):
    """As many equilibria as unknowns and a few: an encoder is set to better than 30°, a ratio known to a factor."""
    joint = all_twins["sarosi-pulley"]
    (theta, P1, P2), given = log_maker(joint, 3, noise=0.1 * DEG).fit_arguments()
    some = np.append(np.arange(0, theta.size - 12, 9), np.arange(theta.size - 6, theta.size))
    given = {key: value[some] for key, value in given.items()}
    options = {"geometry": joint.geometry, "choices": False, "leave_one_out": False}
    fit = fit_joint(theta[some], P1[some], P2[some], **given, **options)
    assert fit.standard_deviations["zero"] < 30 * DEG
    assert fit.standard_deviations["log_ratio"] < 1


@pytest.fixture(scope="module")
def wrong(all_twins, log_maker):
    """A fit of another law than the true one."""
    joint = all_twins["martens-pulley"]
    (theta, P1, P2), given = log_maker(joint, 3, noise=0.1 * DEG).fit_arguments()
    return fit_joint(theta, P1, P2, **given, geometry=joint.geometry, model="AffinePolynomial", leave_one_out=False)


@pytest.mark.slow
def test_other_choices_are_named_with_what_they_change(wrong):
    kinds = {choice.kind for choice in wrong.doubt.choices}
    assert kinds == {"dead band", "law"}
    assert {"MartensBoblan2017"} <= {choice.name for choice in wrong.doubt.choices}
    assert "AffinePolynomial" not in {choice.name for choice in wrong.doubt.choices}
    assert max(choice.stiffness for choice in wrong.doubt.choices) > 0.01


@pytest.mark.slow
def test_standard_deviations_grow_by_what_is_not_noise(wrong):
    K, J = wrong.stiffness(), parameter_jacobian(wrong.problem, wrong.problem.unknowns(wrong.x))
    assert np.median(wrong.stiffness_std() / K.std(J @ wrong.doubt.formal @ J.T)) > 1.5


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


@pytest.mark.slow
@pytest.mark.parametrize("foreign", [False, True])
def test_the_stated_interval_of_the_stiffness_holds_under_hysteresis_and_a_wrong_law(foreign):
    """Three joints of `python -m benchmarks.identification.joint_coverage`, whose report has 56."""
    found = [each for each in campaign(range(3, 6), foreign) if isinstance(each, Covered)]
    assert len(found) == 3
    assert np.concatenate([c.inside for c in found]).mean() >= 0.9
    formal = np.concatenate([np.abs(c.error) <= 1.96 * c.formal for c in found])
    assert formal.mean() < 0.85  # errors are not independent
    error = np.concatenate([c.error / c.true for c in found])
    width = np.concatenate([c.std / c.true for c in found])
    assert np.median(width) < 2 * np.sqrt(np.mean(error**2))  # an interval that says nothing would hold as well


@pytest.mark.slow
@pytest.mark.parametrize(("model", "most"), [("AffinePolynomial", 1.6 * DEG), ("Sarosi2012", 4 * DEG)])
def test_a_muscle_length_left_out_is_predicted_within_the_stated_interval(shared, model, most):
    """240 mm lies outside the lengths fitted, where Sarosi2012 is 5° off."""
    log = read_joint_log(shared("data/joint_angle_grid.csv"), {1: -1.0, 2: 1.0})
    label = np.array([f"{length * 1e3:.0f}" for length in log.rest_length])
    geometry = {mm: Lever(float(mm) / 1000, 0.1655, 0.05094, 0.051) for mm in np.unique(label).tolist()}

    arrays = {"theta": log.theta, "P1": log.P1, "P2": log.P2, "direction": log.direction, "group": label}

    def some(keep):
        return {name: array[keep] for name, array in arrays.items()}

    law = {"model": model, "average": True, "dead_band": 2 * BAR, "choices": False}
    errors, inside = [], []
    for mm, mechanism in geometry.items():
        acting = (label == mm) & (np.minimum(log.P1, log.P2) >= 2 * BAR)
        rows = JointSamples.checked(**some(acting), geometry=geometry).averaged()
        told = fit_joint(**some(label != mm), geometry=geometry, **law).predict(rows.P1, rows.P2, geometry=mechanism)
        errors.append(rows.theta - told.theta)
        inside.append(np.abs(errors[-1]) < 1.96 * told.std)
        assert inside[-1].mean() >= 0.9
        assert np.median(told.std) < 10 * DEG
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < most
