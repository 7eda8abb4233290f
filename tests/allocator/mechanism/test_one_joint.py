"""n = 1, m = 2 is the antagonistic joint: the same torque, stiffness and pressures as its closed forms give."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import Limits, Status, Stiffness, allocate
from allocator.mechanism import Mechanism, machines
from allocator.units import BAR

AFFINE = ("mckibben-pulley", "hogan-pulley", "sarosi-pulley", "sarosi-lever", "sarosi-table")
GAS = {"rest_volume": 1.2e-4, "tube_volume": 2e-5}  # [m³]
KINDS = {
    "shut": {"stiffness": Stiffness("shut")},
    "one shut": {"stiffness": Stiffness((True, False))},
    "2 Hz": {"stiffness": Stiffness(frequency=2.0, lag=(0.1, 0.03))},
}


@pytest.fixture(params=AFFINE)
def affine(request, joints):
    return joints[request.param]


def targets(joint, n=60, seed=3):
    rng = np.random.default_rng(seed)
    left, right = joint.angle_range
    theta = rng.uniform(left, right, n)
    P1, P2 = rng.uniform(0, 5, (2, n)) * BAR
    K, T = joint.stiffness(theta, P1, P2), joint.torque(theta, P1, P2)
    half = n // 2
    return theta, np.r_[np.abs(K[:half]) + 0.1, rng.uniform(0.5, 40, n - half)], np.r_[T[:half], 3 * T[half:]]


def test_torque_and_stiffness_are_the_joint_s(joint):
    theta = np.linspace(*joint.angle_range, 7)
    P = np.random.default_rng(0).uniform(1, 5, (7, 2)) * BAR
    mechanism = Mechanism.from_joint(joint)
    assert mechanism.torque(theta[:, None], P)[:, 0] == pytest.approx(joint.torque(theta, *P.T), rel=1e-13, abs=1e-13)
    given = mechanism.stiffness(theta[:, None], P)[:, 0, 0]
    assert given == pytest.approx(joint.stiffness(theta, *P.T), rel=1e-13, abs=1e-13)


@pytest.mark.parametrize(
    ("priority", "weights"),
    [("torque", None), ("stiffness", None), ("weighted", (1.0, 1.0)), ("weighted", (30.0, 0.2))],
)
@pytest.mark.parametrize(
    "limits", [{}, {"limits": Limits(min_force=40.0, max_force=900.0)}, {"limits": Limits(min_force=None)}]
)
def test_the_pressures_are_those_of_allocate(affine, priority, weights, limits):
    theta, K, T = targets(affine)
    one = allocate(theta, K, T, joint=affine, priority=priority, weights=weights, **limits)
    mechanism = Mechanism.from_joint(affine)
    many = allocate(
        theta[:, None], K[:, None], T[:, None], joint=mechanism, priority=priority, weights=weights, **limits
    )
    # a lever whose determinant nearly vanishes determines the pressures to fewer digits than what they give
    assert many.T[:, 0] == pytest.approx(one.T, abs=1e-9 * np.abs(one.T).max())
    assert many.K[:, 0, 0] == pytest.approx(one.K, abs=1e-9 * np.abs(one.K).max())
    assert many.P == pytest.approx(np.stack([one.P1, one.P2], axis=-1), abs=1e-9 * 5 * BAR)
    assert many.kkt_residual.max() < 1e-9
    holds = many.status != Status.UNSTABLE
    assert np.array_equal(many.status[holds], one.status[holds])
    assert (one.K[~holds] <= 1e-9).all()


@pytest.mark.parametrize("priority", ["torque", "stiffness"])
@pytest.mark.parametrize("kind", KINDS.values(), ids=KINDS.keys())
def test_with_trapped_gas_the_pressures_are_those_of_allocate(joints, kind, priority):
    joint = joints["sarosi-lever"]
    joint = replace(joint, **{name: replace(getattr(joint, name), **GAS) for name in ("agonist", "antagonist")})
    theta, K, T = targets(joint, n=20)
    one = allocate(theta, K, T, joint=joint, priority=priority, **kind)
    asked = theta[:, None], K[:, None], T[:, None]
    many = allocate(*asked, joint=Mechanism.from_joint(joint), priority=priority, **kind)
    assert many.P == pytest.approx(np.stack([one.P1, one.P2], axis=-1), abs=1e-8 * 5 * BAR)
    assert many.K[:, 0, 0] == pytest.approx(one.K, rel=1e-8)
    holds = many.status != Status.UNSTABLE
    assert np.array_equal(many.status[holds], one.status[holds])


def test_slew_limits_are_those_of_allocate(affine):
    theta, K, T = targets(affine)
    now = np.random.default_rng(1).uniform(0, 5, (2, theta.size)) * BAR
    one = allocate(theta, K, T, joint=affine, limits=Limits(previous=tuple(now), max_step=0.4 * BAR))
    many = allocate(
        theta[:, None],
        K[:, None],
        T[:, None],
        joint=Mechanism.from_joint(affine),
        limits=Limits(previous=now.T, max_step=0.4 * BAR),
    )
    assert many.P == pytest.approx(np.stack([one.P1, one.P2], axis=-1), abs=1e-9 * 5 * BAR)
    holds = many.status != Status.UNSTABLE
    assert np.array_equal(many.status[holds], one.status[holds])


def test_beyond_the_joint_range_the_nearest_posture_is_answered(affine):
    right = affine.angle_range[1]
    one = allocate(right + 0.2, 8.0, 1.0, joint=affine)
    many = allocate([right + 0.2], 8.0, 1.0, joint=Mechanism.from_joint(affine))
    assert many.P == pytest.approx([one.P1, one.P2], abs=1e-9 * 5 * BAR)
    assert many.status == one.status == Status.OUTSIDE_JOINT_RANGE
    assert "joint 1 range" in many.active
    assert many.q == pytest.approx([right])


def test_a_pull_off_the_targets_is_called_that_of_joint_and_mechanism(joints):
    joint = joints["sarosi-pulley"]
    asked = {"priority": "weighted", "weights": (1.0, 1.0), "pull": (1e-11, np.array([2.0, 2.5]) * BAR)}
    one = allocate(0.2, 5.0, 1.0, joint=joint, **asked)
    many = allocate([0.2], 5.0, 1.0, joint=Mechanism.from_joint(joint), **asked)
    assert many.P == pytest.approx(one.P, rel=1e-9)
    assert one.status == many.status == Status.PULLED
    assert not many.torque_met
    assert not many.stiffness_met


def fitted(muscle, seed):
    """Return the muscle with a covariance: errors of some percent of its parameters, correlated."""
    values = np.array([*muscle.parameters.values()])
    root = 0.03 * values[:, None] * np.random.default_rng(seed).normal(size=(values.size, 3))
    return replace(muscle, covariance=tuple(map(tuple, root @ root.T)))


@pytest.mark.parametrize("alike", [True, False], ids=["one law", "two laws"])
@pytest.mark.parametrize("kind", [{}, KINDS["shut"]], ids=["isobaric", "shut"])
def test_standard_deviations_are_those_of_the_joint(joints, kind, alike):
    joint = joints["sarosi-lever"]
    one = fitted(replace(joint.agonist, **GAS), 1)
    joint = replace(joint, agonist=one, antagonist=one if alike else fitted(one, 2))
    theta, K, T = targets(joint, n=20)
    single = allocate(theta, K, T, joint=joint, **kind)
    many = allocate(theta[:, None], K[:, None], T[:, None], joint=Mechanism.from_joint(joint), **kind)
    assert many.K_std[:, 0, 0] == pytest.approx(single.K_std, rel=1e-6)
    assert many.forces_std == pytest.approx(single.forces_std, rel=1e-6)


def test_standard_deviations_of_an_arm_are_those_of_muscles_moved_along_their_errors():
    arm = machines.arm26()
    laws = [fitted(arm.muscles[0], seed) for seed in (1, 2)]
    arm = replace(arm, muscles=tuple(laws[i] for i in (0, 0, 0, 1, 1, 1)))
    K = [[[10.0, 4.0], [4.0, 9.0]]]
    found = allocate([[0.4, -0.3], [0.1, 0.2]], K, [[9.0, 4.0], [1.0, -2.0]], joint=arm)
    variance = np.zeros((2, 2, 2))
    for law in laws:
        values, vectors = np.linalg.eigh(np.array(law.covariance))
        for size, vector in zip(np.sqrt(np.maximum(values, 0.0)), vectors.T, strict=True):
            ends = []
            for sign in (1e-4, -1e-4):
                numbers = np.array([*law.parameters.values()]) + sign * size * vector
                moved = law.with_parameters(dict(zip(law.parameters, numbers, strict=True)))
                other = replace(arm, muscles=tuple(moved if m is law else m for m in arm.muscles))
                ends.append(other.stiffness(found.q, found.P))
            variance += ((ends[0] - ends[1]) / 2e-4) ** 2
    assert found.K_std == pytest.approx(np.sqrt(variance), rel=1e-4)
    assert allocate([0.4, -0.3], 9.0, joint=machines.arm26()).K_std is None
