"""Allocation under uncertain muscles: what it promises is counted by Monte Carlo."""

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import AntagonistError, AntagonistJoint, Limits, Method, Pulley, Status, allocate
from allocator.allocation.uncertain.chance import chance_box
from allocator.identification import fit, load_dataset
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import Sarosi2012
from allocator.units import BAR

PULLEY = Pulley(rest_length=0.30, radius=0.02, initial_contraction=0.12)
DRAWS = 10_000


@pytest.fixture(scope="module")
def fitted():
    """The Sarosi form fitted to the measured map, its covariance widened to a specimen's ±10 % of full scale."""
    samples = load_dataset("dmsp-20-300-map")
    return fit(Sarosi2012, samples.contraction, samples.pressure, samples.force).muscle


@pytest.fixture(scope="module")
def joint(fitted):
    return AntagonistJoint(PULLEY, fitted, fitted, angle_limits=(-1.0, 1.0))


def covariance(muscle, factor):
    return factor**2 * np.array(muscle.covariance)


def drawn(muscle, matrix, seed):
    """`DRAWS` muscles with parameters drawn from the covariance, as one muscle with arrays for parameters."""
    scale = np.sqrt(np.diag(matrix))  # parameters of very different size: drawn from the correlation
    moves = np.random.default_rng(seed).multivariate_normal(np.zeros(6), matrix / np.outer(scale, scale), DRAWS)
    return muscle.unchecked(list((np.array([*muscle.parameters.values()]) + scale * moves).T))


def violations(joint, matrix, answer, low, high):
    """Share of the draws in which some force limit is broken."""
    one, two = joint.sides(answer.theta)
    F1 = drawn(joint.agonist, matrix, seed=1).force(answer.P1, one.contraction)
    F2 = drawn(joint.antagonist, matrix, seed=2).force(answer.P2, two.contraction)
    return np.mean((F1 < low) | (F2 < low) | (F1 > high) | (F2 > high))


@pytest.mark.parametrize("priority", ["torque", "weighted"])
@pytest.mark.parametrize("risk", [0.10, 0.05, 0.01])
@pytest.mark.parametrize("limits", [(0.0, None), (30.0, 450.0)], ids=["taut", "taut and ceiling"])
def test_the_limits_are_kept_with_the_probability_asked_for(fitted, joint, priority, risk, limits):
    matrix = covariance(fitted, 3.0)
    low, high = limits
    for theta, K, T in ((0.0, 1.5, 0.0), (0.4, 1.5, 0.5), (-0.6, 1.5, -1.0), (0.3, 9.0, 0.5)):
        weights = (1.0, 1.0) if priority == "weighted" else None
        common = {
            "joint": joint,
            "priority": priority,
            "weights": weights,
            "limits": Limits(min_force=low, max_force=high),
        }
        hedged = allocate(theta, K, T, method=Method("convex", uncertainty=matrix, risk=risk), **common)
        nominal = allocate(theta, K, T, **common)
        assert hedged.status in (Status.HEDGED, Status.EXACT)
        broken, broken_nominally = (
            violations(joint, matrix, a, low, np.inf if high is None else high) for a in (hedged, nominal)
        )
        assert broken < risk
        if nominal.forces[0] < low + 1e-6 or (high and max(nominal.forces) > high - 1e-6):
            assert broken_nominally > 3.5 * risk


@pytest.mark.parametrize("widened", [1, 25, 100, 400])
@pytest.mark.parametrize("risk", [0.10, 0.01])
def test_the_risk_is_kept_or_said_not_to_be_where_a_wide_covariance_meets_a_nonlinear_law(fitted, joint, widened, risk):
    """The Sarosi form has exponents: times 400 a quarter of its draws fall with pressure, and no pressure helps."""
    matrix = covariance(fitted, np.sqrt(widened))
    for theta, K, T in ((0.0, 1.5, 0.0), (0.4, 1.5, 0.5), (-0.6, 1.5, -1.0)):
        common = {"joint": joint, "method": Method("convex", uncertainty=matrix, risk=risk)}
        answer = allocate(theta, K, T, **common)
        if answer.status in (Status.HEDGED, Status.EXACT):
            assert widened < 400
            assert violations(joint, matrix, answer, 0.0, np.inf) <= risk
        else:
            assert widened > 25
            assert answer.status is Status.TOO_RISKY
            assert "no pressures keep the force limits with that probability" in answer.message
            supply = SimpleNamespace(theta=theta, P1=5 * BAR, P2=5 * BAR)
            assert violations(joint, matrix, supply, 0.0, np.inf) > risk / 2  # Bonferroni: one limit has half of it


def test_a_ceiling_is_kept_in_draws_of_a_nonlinear_law(fitted, joint):
    matrix = covariance(fitted, 4.0)
    answer = allocate(
        0.0,
        9.0,
        0.0,
        joint=joint,
        method=Method("convex", uncertainty=matrix, risk=0.05),
        limits=Limits(max_force=300.0),
    )
    assert answer.status is Status.HEDGED
    assert violations(joint, matrix, answer, 0.0, 300.0) <= 0.05


def test_the_cone_s_answer_lies_in_the_box_found_by_root_finding(joint, fitted):
    """Each force limit bounds one pressure: where a limit binds the answer is that bound."""
    matrix = covariance(fitted, 3.0)
    a = allocate(
        0.2, 1.5, 0.0, joint=joint, method=Method("convex", uncertainty=matrix, risk=0.05), priority="stiffness"
    )
    box = chance_box(a._problem, 0.05)
    assert a.active == ("agonist slack", "antagonist slack")
    assert (a.P1, a.P2) == pytest.approx((box.agonist.lo[0], box.antagonist.lo[0]), abs=1.0)
    nominal = allocate(0.2, 1.5, 0.0, joint=joint, priority="stiffness")
    assert a.P1 > nominal.P1


def test_the_expected_squared_error_is_least(joint, fitted):
    """Against a fine grid, with the expectation counted over draws of the parameters."""
    matrix, target = covariance(fitted, 0.5), (0.1, 5.0, 1.0)  # small: first order in the parameters
    a = allocate(
        *target, joint=joint, method=Method("convex", uncertainty=matrix), priority="weighted", weights=(1.0, 2.0)
    )
    muscles = drawn(fitted, matrix, seed=3)
    sides = [OneMuscle(muscles, side.name, side.rest_length, *side.arrays) for side in joint.sides(target[0])]

    def expected(P1, P2):
        T = sides[0].torque(P1) + sides[1].torque(P2)
        K = sides[0].stiffness(P1) + sides[1].stiffness(P2)
        return np.mean((T - target[2]) ** 2 + 2 * (K - target[1]) ** 2)

    mine = expected(a.P1, a.P2)
    for step in (0.02 * BAR, 0.1 * BAR):
        for angle in np.linspace(0, 2 * np.pi, 12, endpoint=False):
            assert expected(a.P1 + step * np.cos(angle), a.P2 + step * np.sin(angle)) > mine * (1 - 1e-3)


def test_without_uncertainty_nothing_is_hedged(joint):
    matrix = np.zeros((6, 6))
    a = allocate(0.2, 5.0, 1.0, joint=joint, method=Method("convex", uncertainty=matrix))
    exact = allocate(0.2, 5.0, 1.0, joint=joint)
    assert (a.P1, a.P2) == pytest.approx((exact.P1, exact.P2), abs=1.0)
    assert a.status is Status.EXACT


def test_a_risk_that_cannot_be_had_is_said(joint, fitted):
    a = allocate(1.0, 5.0, 0.0, joint=joint, method=Method("convex", uncertainty=covariance(fitted, 60.0), risk=1e-4))
    assert a.status is Status.TOO_RISKY
    assert np.isfinite([a.P1, a.P2]).all()


def test_k_std_is_the_spread_of_the_stiffness(fitted):
    """With a tenth of the fitted standard deviations, where the delta method's first order is all there is."""
    matrix = covariance(fitted, 0.1)
    muscle = replace(fitted, covariance=tuple(map(tuple, matrix.tolist())))
    joint = AntagonistJoint(PULLEY, muscle, muscle, angle_limits=(-1.0, 1.0))
    a = allocate(np.array([0.0, 0.4]), 5.0, 0.5, joint=joint)
    muscles = drawn(fitted, matrix, seed=4)
    for i in range(2):
        sides = [OneMuscle(muscles, s.name, s.rest_length, *s.arrays) for s in joint.sides(float(a.theta[i]))]
        K = sides[0].stiffness(a.P1[i]) + sides[1].stiffness(a.P2[i])
        assert a.K_std[i] == pytest.approx(np.std(K), rel=0.03)


def test_there_is_no_k_std_without_a_covariance():
    assert allocate(0.0, 7.5).K_std is None


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"method": Method("convex", uncertainty=np.eye(5))}, "covariance has to be 6 rows of 6"),
        (
            {"method": Method("convex", uncertainty=np.ones((6, 5)))},
            "square matrix of finite numbers, got shape (6, 5)",
        ),
        ({"method": Method("convex", uncertainty=-np.eye(6))}, "negative eigenvalue"),
        ({"method": Method("convex", uncertainty=np.triu(np.ones((6, 6))))}, "symmetric"),
        ({"method": Method("convex", uncertainty=np.full((6, 6), np.nan))}, "finite"),
        ({"method": Method("convex", uncertainty="large")}, "is no covariance, a square matrix"),
        ({"method": Method("convex", uncertainty=np.eye(6), risk=0.0)}, "risk = 0.0 has to be a probability"),
        ({"method": Method("convex", uncertainty=np.eye(6), risk=5)}, "risk = 5 has to be a probability"),
        ({"method": Method("qp", uncertainty=np.eye(6))}, "belongs to method='convex'"),
    ],
)
def test_wrong_uncertainty_is_named(joint, arguments, said):
    with pytest.raises(AntagonistError, match=re.escape(said)):
        allocate(0.2, 5.0, 1.0, joint=joint, **({"method": "convex"} | arguments))


def test_uncertainty_needs_affine_muscles_and_their_covariance(joints):
    with pytest.raises(AntagonistError, match="affine in pressure"):
        allocate(0.2, 7.5, 1.0, method=Method("convex", uncertainty=np.eye(5)))
    with pytest.raises(AntagonistError, match="no covariance: fit them"):
        allocate(0.2, 5.0, 1.0, joint=joints["sarosi-pulley"], method=Method("convex", uncertainty=True))
