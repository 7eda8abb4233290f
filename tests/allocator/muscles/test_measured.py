"""Fitted muscles know where they were measured, and stay sane beyond it."""

from dataclasses import replace

import casadi
import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.identification import fit
from allocator.muscles import MODELS, AffinePolynomial, Muscle, TableMuscle, force_gradient
from allocator.muscles.catalogue import MUSCLES, SAROSI_DMSP_20_400N
from allocator.muscles.measured import MeasuredRegion
from allocator.units import BAR

SQUARE = MeasuredRegion((0.02, 0.14, 0.14, 0.02), (1 * BAR, 1 * BAR, 5 * BAR, 5 * BAR))
LAWS = {
    **MUSCLES,
    "polynomial": AffinePolynomial((3e-3, -1.2e-2, 8e-3), (-5.0, -300.0)),
    "wickramatunge": MODELS["Wickramatunge2010"](0.3, 0.2, -1e3, 1e5, 0.6, 1e-7, 2e-7, 2.5 * BAR),
    "tondu-lopez": MODELS["TonduLopez2000"](0.01, 0.4, 1.1, 0.6, 0.8 * BAR),
}
AFFINE = ("sarosi-dmsp-20-400n", "polynomial", "martens-dmsp-20-300", "tondu-mckibben")


@pytest.fixture(params=LAWS)
def pair(request):
    law = LAWS[request.param]
    return law, replace(law, measured=SQUARE)


def test_the_law_is_the_formula_where_it_was_measured(pair):
    law, measured = pair
    P, eps = np.meshgrid(np.linspace(1, 5, 5) * BAR, np.linspace(0.02, 0.14, 9))
    for name in ("force", "gain", "slope", "gain_slope", "gain_integral"):
        mine, theirs = getattr(measured, name)(P, eps), getattr(law, name)(P, eps)
        if name == "gain_integral":  # counted from ε = 0, which was not measured
            mine, theirs = mine - mine[0], theirs - theirs[0]
        np.testing.assert_allclose(mine, theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())


@pytest.mark.parametrize("edge", SQUARE.contractions)
def test_beyond_it_the_force_goes_on_along_its_tangent(pair, edge):
    law, measured = pair
    outwards = -1 if edge == min(SQUARE.contractions) else 1
    P, away = np.meshgrid(np.linspace(1.2, 5, 5) * BAR, outwards * np.linspace(0, 0.1, 6))
    h = 1e-6
    tangent = (law.force(P, edge + h) - law.force(P, edge - h)) / (2 * h)
    expected = law.force(P, edge) + tangent * away
    np.testing.assert_allclose(measured.force(P, edge + away), expected, rtol=1e-6, atol=1e-6 * np.abs(expected).max())


def test_gain_slope_and_volume_are_those_of_the_continued_force(pair):
    """Central differences and a trapezoid sum, on both sides of either edge."""
    _, muscle = pair
    P, eps, dP, h = 3.1 * BAR, np.array([-0.02, 0.01, 0.08, 0.15, 0.22]), 10.0, 1e-6
    gain = (muscle.force(P + dP, eps) - muscle.force(P - dP, eps)) / (2 * dP)
    np.testing.assert_allclose(muscle.gain(P, eps), gain, rtol=1e-6)
    slope = (muscle.force(P, eps + h) - muscle.force(P, eps - h)) / (2 * h)
    np.testing.assert_allclose(muscle.slope(P, eps), slope, rtol=1e-6)
    change = (muscle.gain(P, eps + h) - muscle.gain(P, eps - h)) / (2 * h)
    np.testing.assert_allclose(muscle.gain_slope(P, eps), change, rtol=1e-5, atol=1e-9)
    fine = np.linspace(0, 0.22, 20001)
    area = np.trapezoid(muscle.gain(P, fine), fine)
    assert muscle.gain_integral(P, 0.22) == pytest.approx(area, rel=1e-6)


def test_a_pressure_beyond_the_measured_contractions_gives_the_force_asked(pair):
    _, muscle = pair
    eps = np.array([-0.01, 0.01, 0.08, 0.15, 0.17])
    F = np.maximum(muscle.force(4 * BAR, eps), 1.0)
    P = muscle.pressure(F, eps)
    reached = np.isfinite(P)
    assert reached[:4].all()
    np.testing.assert_allclose(muscle.law(P, eps)[reached], F[reached], rtol=1e-6)


@pytest.mark.parametrize("symbol", [casadi.SX, casadi.MX])
def test_symbols_and_numbers_agree_beyond_the_edges(pair, symbol):
    _, muscle = pair
    P, eps = symbol.sym("P"), symbol.sym("eps")
    for name in ("force", "gain", "slope", "gain_slope", "gain_integral"):
        function = casadi.Function("f", [P, eps], [getattr(muscle, name)(P, eps)])
        for e in (-0.01, 0.02, 0.08, 0.14, 0.2):
            value = getattr(muscle, name)(3 * BAR, e)
            assert float(function(3 * BAR, e)) == pytest.approx(value, rel=1e-8, abs=1e-12), (name, e)


@pytest.mark.parametrize("name", AFFINE)
def test_gradients_by_the_parameters_are_differences_beyond_the_edges(name):
    muscle = replace(LAWS[name], measured=SQUARE)
    eps = np.array([0.0, 0.08, 0.2])
    found = force_gradient(muscle, 3 * BAR, eps)
    for i, (parameter, value) in enumerate(muscle.parameters.items()):
        h = 1e-5 * abs(value) or 1e-8
        more, less = (muscle.with_parameters({parameter: value + d}).law(3 * BAR, eps) for d in (h, -h))
        np.testing.assert_allclose(found[:, i], (more - less) / (2 * h), rtol=1e-4, atol=1e-7 * np.abs(found).max())


def test_an_affine_muscle_stays_affine_in_the_pressure():
    muscle = replace(SAROSI_DMSP_20_400N, measured=SQUARE)
    P, eps = np.array([1.0, 2.0, 3.0]) * BAR, np.array([-0.03, 0.2])[:, None]
    F = muscle.law(P, eps)
    np.testing.assert_allclose(F[:, 2] - F[:, 1], F[:, 1] - F[:, 0], rtol=1e-12)


def test_a_fit_to_few_contractions_stays_near_a_muscle_that_goes_slack():
    """A muscle that pulls nothing beyond ε = 0.17, fitted up to 0.134: no model claims to hold there."""

    rng = np.random.default_rng(3)
    P, eps = (a.ravel() for a in np.meshgrid(np.linspace(0.5, 6, 8) * BAR, np.linspace(0, 0.134, 9)))
    F = 3e-3 * P * (1 - eps / 0.17) ** 1.2 + rng.normal(0, 5.0, P.size)
    for model in (AffinePolynomial, TableMuscle, MODELS["Sarosi2012"], MODELS["PolynomialMcKibben"]):
        muscle = fit(model, eps, P, F, folds=0).muscle
        assert muscle.max_contraction == pytest.approx(0.134)
        reach = np.abs(muscle.slope(6 * BAR, 0.134)) * (0.179 - 0.134)
        assert np.abs(muscle.force(6 * BAR, 0.179) - muscle.force(6 * BAR, 0.134)) <= 1.001 * reach


def test_the_hull_holds_its_samples_and_no_more():
    eps, P = np.array([0.0, 0.1, 0.0]), np.array([1.0, 1.0, 5.0]) * BAR
    triangle = MeasuredRegion.of(eps, P)
    assert triangle.contains(eps, P).all()
    assert triangle.contains(0.02, 2 * BAR)
    assert not triangle.contains(0.09, 4 * BAR)  # within both ranges, but not in the hull
    assert not triangle.contains(0.11, 1 * BAR)
    assert not triangle.contains(np.nan, 1 * BAR)
    assert triangle.contains(-0.0005, 2 * BAR)  # less than 1 % outside


def test_a_hull_of_one_contraction_or_one_point_is_a_line_or_a_point():
    line = MeasuredRegion.of([0.1, 0.1, 0.1], [1 * BAR, 3 * BAR, 5 * BAR])
    assert line.contains(0.1, 4 * BAR)
    assert not line.contains(0.12, 4 * BAR)
    assert not line.contains(0.1, 6 * BAR)
    point = MeasuredRegion.of(0.1, 1 * BAR)
    assert point.contains(0.1, 1 * BAR)
    assert not point.contains(0.1, 2 * BAR)


def test_a_hull_is_the_one_of_qhull():
    from scipy.spatial import ConvexHull

    rng = np.random.default_rng(1)
    eps, P = rng.uniform(0, 0.3, 200), rng.uniform(0, 6, 200) * BAR
    corners = ConvexHull(np.stack([eps / 0.3, P / (6 * BAR)], axis=1)).vertices
    found = MeasuredRegion.of(eps, P)
    assert sorted(found.contraction) == pytest.approx(sorted(eps[corners]))
    assert sorted(found.pressure) == pytest.approx(sorted(P[corners]))


def test_a_file_keeps_the_region(tmp_path):
    muscle = replace(SAROSI_DMSP_20_400N, measured=SQUARE)
    muscle.save(tmp_path / "m.toml")
    assert Muscle.load(tmp_path / "m.toml") == muscle


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ("contraction = [0.1]", "needs pressure"),
        ("contraction = [0.1]\npressure = [1e5, 2e5]", "one shape"),
        ('contraction = ["a"]\npressure = [1e5]', "contraction"),
        ("contraction = []\npressure = []", "one shape"),
        ("contraction = [5, 20, 20]\npressure = [1e5, 1e5, 5e5]", "percent"),
        ("contraction = [0.05, 0.2, 0.2]\npressure = [1, 1, 5]", "bar was meant"),
        ("contraction = [0.05, nan]\npressure = [1e5, 5e5]", "not finite"),
    ],
)
def test_a_region_that_is_none_is_refused(tmp_path, table, said):
    SAROSI_DMSP_20_400N.save(tmp_path / "m.toml")
    with (tmp_path / "m.toml").open("a", encoding="utf-8") as file:
        file.write(f"\n[measured]\n{table}\n")
    with pytest.raises(InvalidFile, match=said):
        Muscle.load(tmp_path / "m.toml")


def test_a_region_of_another_kind_is_refused():
    with pytest.raises(InvalidInput, match="MeasuredRegion"):
        replace(SAROSI_DMSP_20_400N, measured=(0.0, 0.1))
