"""Limits between models, and literature values with their source in the test id."""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import load_dataset
from allocator.muscles import (
    Andrikopoulos2016,
    ChouHannaford1996,
    FunctionMuscle,
    Hildebrandt2005,
    KazemipourKatzschmann2025,
    MartensBoblan2017,
    PolynomialMcKibben,
    TableMuscle,
    Tondu2021,
    TonduLopez1995,
    TonduLopez2000,
    Wickramatunge2010,
)
from allocator.muscles.catalogue import (
    MARTENS_DMSP_20_300,
    SAROSI_DMSP_20_400N,
    TONDU_DMSP_20_400N,
    TONDU_LOPEZ_LAAS_ARM,
    TONDU_MCKIBBEN,
)
from allocator.units import BAR, DEG

P = np.linspace(0.5, 6, 12)[:, None] * BAR
EPS = np.linspace(0.0, 0.3, 13)


def same_force(one, other, rtol=1e-12):
    F = other.force(P, EPS)
    np.testing.assert_allclose(one.force(P, EPS), F, rtol=rtol, atol=rtol * np.abs(F).max())
    np.testing.assert_allclose(one.slope(P, EPS), other.slope(P, EPS), rtol=1e-9)


# --- limits between models ----------------------------------------------------------------------------------------


def test_tondu_lopez_2000_with_k_1_is_tondu_lopez_1995():
    same_force(TonduLopez2000.with_constant_k(0.01, 23.5 * DEG, 1.0), TONDU_MCKIBBEN)


def test_andrikopoulos_2016_with_q_1_is_tondu_lopez_2000():
    braid = (0.0109, 25.5 * DEG, 1.3, 0.8, 1.5 * BAR)
    same_force(Andrikopoulos2016(*braid, q=1.0), TonduLopez2000(*braid))


def test_chou_hannaford_1996_without_wall_is_tondu_lopez_1995():
    thread = ChouHannaford1996(rest_length=0.25, b=0.28, n=1.5, t=0.0)
    angle = np.arccos(0.25 / 0.28)
    same_force(thread, TonduLopez1995(thread.D0 * np.sin(angle) / 2, angle))
    assert thread.max_contraction == pytest.approx(TonduLopez1995(0.01, angle).max_contraction, rel=1e-12)


def test_chou_hannaford_1996_is_the_virtual_work_of_its_volume():
    muscle = ChouHannaford1996(rest_length=0.25, b=0.28, n=1.5, t=0.0012)

    def volume(L):
        diameter = muscle.D0 * np.sqrt(1 - (L / muscle.b) ** 2) - 2 * muscle.t
        return np.pi / 4 * diameter**2 * L

    L, h = 0.25 * (1 - EPS), 1e-6
    work = -(volume(L + h) - volume(L - h)) / (2 * h)
    np.testing.assert_allclose(muscle.A(EPS), work, rtol=1e-6)


def test_martens_boblan_2017_is_the_virtual_work_of_its_volume():
    m = MARTENS_DMSP_20_300

    def volume(L):  # π D²/4 L with the fibres wound n times
        return (m.fibre_length**2 - L**2) * L / (4 * np.pi * m.turns**2)

    L, h = m.L0 * (1 - EPS), 1e-6
    np.testing.assert_allclose(m.A(EPS), -(volume(L + h) - volume(L - h)) / (2 * h), rtol=1e-6)


def test_martens_boblan_2017_without_rubber_is_tondu_lopez_1995():
    bare = MartensBoblan2017(0.3, 0.02, 0.0018, 25 * DEG, 0.0, 0.0, 0.0, 0.0)
    same_force(bare, TonduLopez1995(r0=0.01, alpha0=25 * DEG))


def test_the_polynomial_through_readings_has_its_zeros_there():
    pressure, eps_max = np.array([1, 2, 3, 4, 5]) * BAR, np.array([0.09, 0.17, 0.225, 0.253, 0.275])
    for n in range(1, 6):
        muscle = PolynomialMcKibben.identify(0.0109, 25.5 * DEG, pressure[-n:], eps_max[-n:])
        assert len(muscle.coefficients) == n
        full_scale = muscle.force(5 * BAR, 0.0)
        np.testing.assert_allclose(muscle.force(pressure[-n:], eps_max[-n:]), 0, atol=1e-9 * full_scale)


def test_the_polynomial_with_one_coefficient_is_a_straight_isobar_of_hogan_s_kind():
    muscle = PolynomialMcKibben(0.0109, 25.5 * DEG, (20 * BAR,))
    np.testing.assert_allclose(muscle.force(P, EPS), muscle.S * ((muscle.a - muscle.b) * P - 20 * BAR * EPS), rtol=1e-9)


def test_kazemipour_without_denominator_is_hildebrandt_without_passive_part():
    pade = KazemipourKatzschmann2025(1500.0, -6000.0, 2000.0, 0.0, 5 * BAR)
    c = np.array([1500.0, -6000.0, 2000.0]) / (5 * BAR)
    polynomial = Hildebrandt2005(*c, 0.0, 0.0, 0.0, 0.0, 0.0)
    np.testing.assert_allclose(pade.force(P, EPS), polynomial.force(P, EPS), rtol=1e-12, atol=1e-9)


def test_a_table_of_a_model_follows_the_model():
    knots = np.linspace(0.0, 0.3, 25)
    table = TableMuscle(knots, SAROSI_DMSP_20_400N.A(knots), SAROSI_DMSP_20_400N.B(knots))
    between = np.linspace(0.02, 0.29, 50)
    np.testing.assert_allclose(table.force(P, between), SAROSI_DMSP_20_400N.force(P, between), atol=0.1)


def test_two_functions_of_a_model_are_the_model():
    same_force(FunctionMuscle(SAROSI_DMSP_20_400N.A, SAROSI_DMSP_20_400N.B), SAROSI_DMSP_20_400N)
    same_force(FunctionMuscle(TONDU_MCKIBBEN.A), TONDU_MCKIBBEN)


# --- literature -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bars", "eps_max"), [(3, 0.225), (5, 0.275)], ids=["Tondu-2021-3bar", "Tondu-2021-5bar"])
def test_tondu_2021_contracts_as_read_off(bars, eps_max):
    muscle = TONDU_DMSP_20_400N
    assert muscle.force(bars * BAR, eps_max) == pytest.approx(0, abs=1e-9 * muscle.force(5 * BAR, 0.0))
    assert muscle.force(bars * BAR, eps_max - 0.001) > 0


@pytest.mark.parametrize(
    ("bars", "force"),
    list(zip(range(1, 6), (315, 613, 911, 1209, 1507), strict=True)),
    ids=[f"Sarosi-2015-{i}bar" for i in range(1, 6)],
)
def test_sarosi_400n_without_contraction(bars, force):
    assert SAROSI_DMSP_20_400N.force(bars * BAR, 0.0) == pytest.approx(force, abs=0.5)


@pytest.mark.parametrize(("bars", "eps_max"), [(3, 0.231), (5, 0.269)], ids=["Sarosi-3bar", "Sarosi-5bar"])
def test_sarosi_400n_contracts_as_published(bars, eps_max):
    eps = np.linspace(0.1, 0.3, 2001)
    assert eps[SAROSI_DMSP_20_400N.force(bars * BAR, eps) > 0].max() == pytest.approx(eps_max, abs=0.001)


def test_martens_boblan_2017_reproduces_its_own_measurements():
    measured = load_dataset("dmsp-20-300-map")
    taut = measured.force > 0
    error = (MARTENS_DMSP_20_300.force(measured.pressure, measured.contraction) - measured.force)[taut]
    assert taut.sum() == 60
    assert np.sqrt(np.mean(error**2)) == pytest.approx(14.6, abs=0.2)


def test_the_laas_arm_contracts_by_its_k():
    ideal = TonduLopez1995(0.0085, 20 * DEG)
    for bars in (1, 5):
        assert TONDU_LOPEZ_LAAS_ARM.contraction_limit(bars * BAR) == pytest.approx(ideal.max_contraction / 1.25)
    assert TONDU_LOPEZ_LAAS_ARM.force(5 * BAR, 0.0) == pytest.approx(ideal.force(5 * BAR, 0.0), rel=1e-12)


# --- particulars ----------------------------------------------------------------------------------------------------

WICKRAMATUNGE = Wickramatunge2010(0.3, 0.17, -6000.0, 3.5e5, 0.12, 2.1e-8, 7.1e-9, 2.5 * BAR)


def test_the_two_ranges_of_wickramatunge_meet_without_a_jump():
    below, above = (WICKRAMATUNGE.force(2.5 * BAR * (1 + s), EPS) for s in (-1e-12, 1e-12))
    np.testing.assert_allclose(below, above, rtol=1e-9, atol=1e-6)


@pytest.mark.parametrize(("bars", "c3"), [(1.5, 2.1e-8), (4.0, 7.1e-9)], ids=["low-range", "high-range"])
def test_wickramatunge_is_equation_20_in_each_range(bars, c3):
    ls, p = WICKRAMATUNGE.stretched_length(0.1), bars * BAR
    c0 = -6000.0 + (0 if bars < 2.5 else (2.1e-8 - 7.1e-9) * (2.5 * BAR) ** 2)
    stiffness = c3 * p**2 + 0.12 * p * ls + 3.5e5 * ls**2 + c0
    assert WICKRAMATUNGE.force(p, 0.1) == pytest.approx(stiffness * ls, rel=1e-12)


def test_wickramatunge_says_when_a_force_is_out_of_reach():
    folding = Wickramatunge2010(0.3, 0.17, 0.0, 0.0, 0.12, -1e-8, -1e-8, 2.5 * BAR)
    assert folding.pressure(1e6, 0.05) == np.inf


def test_a_mckibben_whose_contraction_depends_on_pressure_pulls_from_there_on():
    muscle = TonduLopez2000(0.0109, 25.5 * DEG, 1.4, 2.0, 1.2 * BAR)
    limit = muscle.contraction_limit(2 * BAR)
    assert muscle.pressure(0.0, limit) == pytest.approx(2 * BAR, rel=1e-9)
    assert muscle.pressure(0.0, muscle.max_contraction + 0.01) == np.inf
    assert muscle.pressure(10.0, 0.0) == pytest.approx(10.0 / (muscle.S * (muscle.a - muscle.b)), rel=1e-9)


def test_a_little_less_than_no_force_asks_for_a_little_less_than_the_taut_pressure():
    muscle = TonduLopez2000(0.0109, 25.5 * DEG, 1.4, 2.0, 1.2 * BAR)
    for eps in (0.05, 0.2):
        taut, slack = muscle.pressure([0.0, -0.01], eps)
        assert taut - 100 < slack < taut
        assert muscle.law(slack, eps) == pytest.approx(-0.01, rel=1e-6)
    assert muscle.pressure(-1e6, 0.2) == -np.inf


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: TonduLopez2000(0.01, 0.4, -1.0, 0.0, 1e5), "needs k_inf > 0"),
        (lambda: TonduLopez2000(0.01, 0.4, 1.0, 0.0, float("nan")), "P_k = nan is not a finite number"),
        (lambda: TonduLopez2000(0.01, 25.0, 1.0, 0.0, 1e5), "degrees?"),
        (lambda: Andrikopoulos2016(0.01, 0.4, 1.0, 0.0, 1e5, 1.2), "q = 1.2 has to lie in (0, 1]"),
        (lambda: Wickramatunge2010(0.2, 0.3, 0, 0, 0, 0, 0, 2e5), "0 < min_length < rest_length"),
        (lambda: ChouHannaford1996(0.3, 0.2, 1.5, 0.0), "0 < rest_length < b"),
        (lambda: KazemipourKatzschmann2025(1.0, 1.0, 1.0, 1.0, 0.0), "P_max = 0 Pa has to be positive"),
        (lambda: MartensBoblan2017(0.3, 0.02, 0.0018, 28.6, 0, 0, 0, 0), "theta0 between 0 and π/2 rad"),
        (
            lambda: PolynomialMcKibben(0.01, 0.4, [[1.0, 2.0], *map(float, range(100, 140))]),
            "coefficients = [[1.0, 2.0], 100.0, 101.0, 102.0, 103.0, 104.0, 105.0, 1 … is not a row of finite numbers",
        ),
        (lambda: PolynomialMcKibben(0.01, 0.4, 3.0), "coefficients = 3.0 is not a row of finite numbers"),
        (lambda: PolynomialMcKibben.identify(0.01, 0.4, (1e5, 2e5), (0.1, 0.1)), "positive and all different"),
        (lambda: TableMuscle((0, 0.1), (1, 2), (1, 2)), "at least 3 samples"),
        (lambda: TableMuscle((0, 0.1, 0.2, 0.3), (1, 2, 3), (1, 2, 3, 4)), "as many values in area and passive"),
        (lambda: Tondu2021(0.01, 0.4, 0.0, 1e5, -1e12), "Tondu2021 needs d < 0"),
        (lambda: TONDU_MCKIBBEN.with_parameters({"r1": 3}), "has no parameter 'r1'; it has r0, alpha0"),
        (lambda: TonduLopez1995(0.01, 0.4, covariance=((1.0,),)), "2 rows of 2 finite numbers, got shape (1, 1)"),
    ],
)
def test_parameters_that_make_no_sense_are_refused_with_a_reason(make, said):
    with pytest.raises(InvalidInput) as refusal:
        make()
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)
