"""The Jacobian of a mechanism's allocation is the slope of its answer, while the active set stays."""

import numpy as np
import pytest

from allocator import InvalidInput, Limits, Stiffness, allocate
from allocator.mechanism import Endpoint, Mechanism, machines
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR

ARM = machines.arm26()
ROWS, COLUMNS = np.triu_indices(2)
VARIANTS = {
    "torque": {},
    "stiffness": {"priority": "stiffness"},
    "weighted": {"priority": "weighted", "weights": (1.0, 2.0)},
    "pulled": {"priority": "weighted", "weights": (1.0, 2.0), "pull": (1e-12, np.full(6, 2e5))},
    "forces": {"limits": Limits(min_force=60.0, max_force=400.0)},
    "slew": {"limits": Limits(previous=np.full(6, 2.5 * BAR), max_step=0.7 * BAR)},
}


def answer(x, options):
    """The allocation of x = (q1, q2, K11, K12, K22, T1, T2)."""
    K = np.array([[x[2], x[3]], [x[3], x[4]]])
    return allocate(x[:2], K, x[5:], joint=ARM, **options)


@pytest.mark.parametrize("stretch", [1.0, 1.6], ids=["within reach", "beyond"])
@pytest.mark.parametrize("options", VARIANTS.values(), ids=VARIANTS.keys())
def test_the_jacobian_is_the_slope_of_the_answer(options, stretch):
    rng, checked = np.random.default_rng(5), 0
    for _ in range(6):
        q, P = rng.uniform(-0.5, 0.5, 2), rng.uniform(1.5, 3.5, 6) * BAR
        x = np.r_[q, stretch * ARM.stiffness(q, P)[ROWS, COLUMNS], ARM.torque(q, P)]
        a = answer(x, options)
        J = a.jacobian()
        for column, h in enumerate([1e-4] * 2 + [1e-3] * 5):
            near = [answer(x + k * h * np.eye(7)[column], options) for k in (-2, -1, 1, 2)]
            if any((b.active, b.status) != (a.active, a.status) for b in near):
                continue  # the active set changes here: the slope is one-sided
            p2m, p1m, p1, p2 = (b.P for b in near)
            slope = (8 * (p1 - p1m) - (p2 - p2m)) / (12 * h)
            assert J[:, column] == pytest.approx(slope, rel=1e-4, abs=20.0)
            checked += 1
    assert checked > 20


def test_many_targets_have_the_jacobians_of_single_ones_in_the_same_order():
    q, P = np.array([[0.1, 0.2], [-0.3, 0.4]]), np.random.default_rng(1).uniform(1.5, 3.5, (2, 6)) * BAR
    T, K = ARM.torque(q, P), ARM.stiffness(q, P)
    many = allocate(q, K, T, joint=ARM).jacobian()
    assert many.shape == (2, 6, 7)
    for i in range(2):
        assert many[i] == pytest.approx(allocate(q[i], K[i], T[i], joint=ARM).jacobian(), rel=1e-9, abs=1e-3)


@pytest.mark.parametrize("name", ["mckibben-pulley", "sarosi-lever", "sarosi-table"])
@pytest.mark.parametrize("limits", [Limits(), Limits(40.0, 400.0)], ids=["taut", "forces"])
def test_one_joint_has_the_jacobian_of_its_closed_form(joints, name, limits):
    joint = joints[name]
    left, right = joint.angle_range
    for theta in np.linspace(0.9 * left, 0.9 * right, 4):
        for K, T in ((4.0, 0.5), (9.0, 1.0), (30.0, 1.0), (9.0, 80.0)):
            one = allocate(theta, K, T, joint=joint, limits=limits)
            many = allocate([theta], K, T, joint=Mechanism.from_joint(joint), limits=limits)
            assert many.jacobian() == pytest.approx(one.jacobian(), rel=1e-6, abs=1.0)


def test_beyond_the_joint_range_the_posture_makes_no_difference():
    beyond = ARM.angle_limits[0][1] + 0.1
    a = allocate([beyond, 0.2], 9.0, 1.0, joint=ARM)
    assert (a.jacobian()[:, 0] == 0).all()
    assert np.abs(a.jacobian()[:, 1]).max() > 0


def test_what_has_no_jacobian_says_so():
    with pytest.raises(InvalidInput, match=r"jacobian\(\) is for affine muscles only"):
        allocate([0.1, 0.2], 5.0, 1.0, joint=ARM.with_muscles(TONDU_DMSP_20_400N)).jacobian()
    mixed = ARM.with_muscles([TONDU_DMSP_20_400N, *[SAROSI_DMSP_20_400N] * (ARM.m - 1)])
    with pytest.raises(InvalidInput, match=r"not affine in the pressure \(Tondu2021\)"):
        allocate([0.1, 0.2], 5.0, 1.0, joint=mixed).jacobian()
    hand = Stiffness(endpoint=Endpoint.planar([0.3, 0.25]))
    with pytest.raises(InvalidInput, match="an endpoint was given"):
        allocate([0.1, 0.8], 100.0, 1.0, joint=ARM, stiffness=hand).jacobian()
