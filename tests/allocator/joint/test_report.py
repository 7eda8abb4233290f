"""The report's own numbers (B. Tondu, arXiv 2104.13167) and what mathematics adds to them."""

import numpy as np
import pytest

from allocator import AntagonistJoint, Pulley, allocate, inverse, report_joint
from allocator.muscles import Tondu2021
from allocator.muscles.catalogue import TONDU_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG

JOINT = report_joint()


@pytest.mark.parametrize(
    ("value", "published", "tolerance"),
    [
        pytest.param(TONDU_DMSP_20_400N.d / BAR, -10.5, 1e-12, id="(19): d = -10.5 bar"),
        pytest.param(TONDU_DMSP_20_400N.e / BAR**2, -779.0, 2e-4, id="(19): e = -779 bar2"),
        pytest.param(TONDU_MCKIBBEN.force(5 * BAR, 0.0), 1504.0, 5e-4, id="(7): 1504 N at 5 bar"),
        pytest.param(TONDU_MCKIBBEN.max_contraction, 0.370, 2e-3, id="(7): eps_max = 0.370"),
        pytest.param(TONDU_DMSP_20_400N.force(5 * BAR, 0.0), 1454.0, 5e-4, id="(13): 1454 N at 5 bar"),
        pytest.param(TONDU_DMSP_20_400N.max_pressure / BAR, 5.25, 1e-12, id="max pressure -d/2 = 5.25 bar"),
        pytest.param(JOINT.geometry.initial_contraction, 0.275 / 2, 1e-12, id="(24): eps0 = 0.1375"),
        pytest.param(JOINT.tondu_pulley.K_crit, 15.7, 5e-3, id="K_crit = 15.7 N·m/rad"),
    ],
)
def test_the_report_s_numbers_come_out(value, published, tolerance):
    assert value == pytest.approx(published, rel=tolerance)


def test_the_threshold_alone_allows_129_degrees_as_in_25():
    free = AntagonistJoint(JOINT.geometry, JOINT.agonist, JOINT.antagonist)
    assert np.array(free.angle_range) / DEG == pytest.approx([-128.9, 128.9], abs=0.05)
    assert np.array(JOINT.angle_range) / DEG == pytest.approx([-125, 125])


@pytest.mark.parametrize("c", [0.0, -20 * BAR, 8 * BAR])
def test_identification_19_reproduces_its_two_readings(c):
    muscle = Tondu2021.identify(0.0109, 25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275), c=c)
    assert muscle.force(3 * BAR, 0.225) == pytest.approx(0, abs=1e-9)
    assert muscle.force(5 * BAR, 0.275) == pytest.approx(0, abs=1e-9)


def equation_8(muscle, pulley, theta, P1, P2):
    """The McKibben joint as printed."""
    R, l0, eps0, a, b = pulley.radius, pulley.rest_length, pulley.initial_contraction, muscle.a, muscle.b
    X = R * theta / l0
    difference, total = P1 - P2, P1 + P2
    T = muscle.S * R * ((a * ((1 - eps0) ** 2 + X**2) - b) * difference - 2 * a * (1 - eps0) * X * total)
    K = 2 * a * muscle.S * R**2 / l0 * ((1 - eps0) * total - X * difference)
    return T, K


def equations_9_and_10(muscle, pulley, theta, K, T):
    """The McKibben inverse as printed."""
    R, l0, eps0, a, b = pulley.radius, pulley.rest_length, pulley.initial_contraction, muscle.a, muscle.b
    f = a * ((1 - eps0) ** 2 - (R * theta / l0) ** 2) - b
    A = 2 * a * muscle.S * R**2 * (1 - eps0) / l0
    difference = (T + K * theta) / (muscle.S * R * f)
    total = (K + 2 * a * R**2 * theta / (l0**2 * f) * (T + K * theta)) / A
    return (total + difference) / 2, (total - difference) / 2


def equation_22(muscle, pulley, theta, P1, P2):
    """The Festo joint as printed (c = 0), and with c (K from (21), T from (13) and (18))."""
    R, l0, eps0, S = pulley.radius, pulley.rest_length, pulley.initial_contraction, muscle.S
    a, b, c, d, e = muscle.a, muscle.b, muscle.c, muscle.d, muscle.e
    X = R * theta / l0
    h1, h2 = (c * P1 + e) / (P1 + d), (c * P2 + e) / (P2 + d)
    T = S * R * ((a - b) * (P1 - P2) - eps0 * (h1 - h2) - X * (h1 + h2))
    K = S * R**2 / l0 * (h1 + h2)
    return T, K


def random_states(seed, size=10_000):
    rng = np.random.default_rng(seed)
    return rng.uniform(-125, 125, size) * DEG, *rng.uniform(0, 5 * BAR, (2, size))


def test_8_to_10_the_mckibben_inverse_is_the_affine_one():
    pulley = Pulley(0.40, 0.02, TONDU_MCKIBBEN.max_contraction / 2)
    joint = AntagonistJoint(pulley, TONDU_MCKIBBEN, TONDU_MCKIBBEN)
    theta, P1, P2 = random_states(1)
    T, K = equation_8(TONDU_MCKIBBEN, pulley, theta, P1, P2)
    assert joint.torque(theta, P1, P2) == pytest.approx(T, rel=1e-9, abs=1e-9)
    assert joint.stiffness(theta, P1, P2) == pytest.approx(K, rel=1e-9)
    found = inverse(theta, K, T, joint=joint)
    assert np.array(found) == pytest.approx(np.array([P1, P2]), rel=1e-6, abs=1e-3)
    assert np.array(found) == pytest.approx(np.array(equations_9_and_10(TONDU_MCKIBBEN, pulley, theta, K, T)), rel=1e-6)


@pytest.mark.parametrize("c", [0.0, 5 * BAR, -20 * BAR, 20 * BAR], ids=lambda c: f"c = {c / BAR:g} bar")
def test_22_the_festo_inverse_recovers_ten_thousand_random_pressures(c):
    muscle = Tondu2021.identify(0.0109, 25.5 * DEG, low=(3 * BAR, 0.225), high=(5 * BAR, 0.275), c=c)
    joint = AntagonistJoint(JOINT.geometry, muscle, muscle)
    theta, P1, P2 = random_states(2)
    T, K = equation_22(muscle, joint.geometry, theta, P1, P2)
    assert joint.torque(theta, P1, P2) == pytest.approx(T, rel=1e-9, abs=1e-9)
    assert joint.stiffness(theta, P1, P2) == pytest.approx(K, rel=1e-9)
    assert np.array(inverse(theta, K, T, joint=joint)) == pytest.approx(np.array([P1, P2]), rel=1e-6, abs=1e-3)


def test_23_the_closed_form_equilibrium_is_the_report_s():
    muscle, pulley = JOINT.agonist, JOINT.geometry
    _, P1, P2 = random_states(3, 1000)
    ratio = (P1 - P2) / (P1 + P2 + 2 * muscle.d)
    bracket = pulley.initial_contraction + (muscle.a - muscle.b) * (P1 + muscle.d) * (P2 + muscle.d) / muscle.e
    theta = pulley.rest_length / pulley.radius * ratio * bracket
    inside = np.abs(theta) <= 125 * DEG
    assert inside.sum() > 500
    assert JOINT.equilibrium(P1, P2)[inside] == pytest.approx(theta[inside], rel=1e-9, abs=1e-12)
    assert np.isnan(JOINT.equilibrium(P1, P2)[~inside]).all()


@pytest.mark.parametrize(
    ("degrees", "least", "greatest"),
    [(0, 6.49, 10.57), (30, 6.51, 9.53), (60, 6.58, 8.98), (90, 6.72, 8.61), (125, 7.03, 8.29)],
    ids="mathematics.md section 1: {}°".format,
)
def test_only_these_stiffnesses_exist_without_torque_and_with_taut_muscles(degrees, least, greatest):
    low, high = (allocate(degrees * DEG, K, 0.0) for K in (1.0, 20.0))
    assert (low.K, high.K) == pytest.approx((least, greatest), abs=0.006)
    assert low.status.name == high.status.name == "STIFFNESS_LIMITED"


def test_fig_8_asks_for_slack_muscles():
    """K = 6 N·m/rad at θ = 0 without torque needs 0.81 bar, where the model's force is -178 N: it cannot exist."""
    asked = allocate(0.0, 6.0, method="analytic")
    assert asked.P1 == asked.P2 == pytest.approx(0.81 * BAR, rel=5e-3)
    assert np.array(asked.forces) == pytest.approx([-178, -178], abs=0.2)
    assert asked.active == ("agonist slack", "antagonist slack")
    assert not asked.success
    taut = allocate(0.0, 6.0)
    assert taut.P1 == pytest.approx(1.53 * BAR, rel=5e-3)
    assert np.array(taut.forces) == pytest.approx([0, 0], abs=1e-9)
