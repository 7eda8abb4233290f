"""What every muscle promises, whatever its formula."""

import re

import casadi
import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.muscles import MODELS, Cabled, FunctionMuscle, Hogan1984, Muscle, monotonicity_failure, scaled
from allocator.units import BAR

METHODS = ("force", "gain", "slope", "gain_slope")
BREAKING = ("PolynomialMcKibben", "TonduLopez2000", "Andrikopoulos2016")  # say so themselves, tested below


def close(a, b, scale, tolerance):
    return np.abs(np.asarray(a) - np.asarray(b)).max() <= tolerance * np.abs(scale).max()


@pytest.mark.parametrize("symbol", [casadi.SX, casadi.MX])
@pytest.mark.parametrize("method", METHODS)
def test_numbers_and_symbols_give_the_same(muscle, domain, method, symbol):
    P, eps = symbol.sym("P"), symbol.sym("eps")
    function = casadi.Function("f", [P, eps], [getattr(muscle, method)(P, eps)])
    P, eps = (a.ravel() for a in np.broadcast_arrays(*domain))
    value = getattr(muscle, method)(P, eps)
    symbolic = np.asarray(function.map(P.size)(P[None], eps[None])).ravel()
    np.testing.assert_allclose(symbolic, value, rtol=1e-11, atol=1e-11 * np.abs(value).max())


def test_slope_is_the_central_difference_of_the_force(muscle, domain):
    P, eps = domain
    h = 1e-6
    difference = (muscle.force(P, eps + h) - muscle.force(P, eps - h)) / (2 * h)
    assert close(muscle.slope(P, eps), difference, difference, 1e-7)


def test_force_takes_the_complex_numbers_of_a_complex_step(muscle, domain):
    P, eps = domain
    assert close(np.imag(muscle.force(P, eps + 1e-30j)) / 1e-30, muscle.slope(P, eps), muscle.slope(P, eps), 1e-12)


def test_force_is_the_law_of_lists_and_of_single_numbers(muscle, domain):
    P, eps = (np.ravel(a)[:3] for a in np.broadcast_arrays(*domain))
    np.testing.assert_array_equal(muscle.force(P.tolist(), eps.tolist()), muscle.law(P, eps))
    one = float(P[0]), float(eps[0])
    assert muscle.force(*one) == muscle.law(*one)
    assert isinstance(muscle.force(*one), float)


@pytest.mark.parametrize(
    ("P", "eps", "said"),
    [
        (
            0.1,
            3e5,
            "eps = 300000 is no contraction ratio (l0 - l)/l0; P and eps look swapped, the",
        ),
        (0.0, 3e5, "P and eps look swapped"),
        ([0.1, 0.2], [0.0, 3e5], "eps[1] = 300000 is no contraction ratio (l0 - l)/l0; P and eps look swapped"),
        (0.1, 3, "P and eps look swapped"),
        (3e5, 10, "eps = 10 is no contraction ratio (l0 - l)/l0; if percent was meant, divide by 100"),
        (0.0, 10, "if percent was meant"),
        (3, 0.1, "P = 3 Pa is next to nothing; if bar was meant, multiply by 1e5"),
        (np.nan, 0.1, "P = nan is not finite [Pa]"),
        (3e5, "a lot", "eps = 'a lot' is not a number"),
    ],
)
def test_force_refuses_what_cannot_be_a_pressure_and_a_ratio(muscle, P, eps, said):
    with pytest.raises(InvalidInput, match=re.escape(said)):
        muscle.force(P, eps)


def test_gain_is_the_central_difference_of_the_force(muscle, domain):
    P, eps = domain
    h = 1e-5 * P
    difference = (muscle.force(P + h, eps) - muscle.force(P - h, eps)) / (2 * h)
    assert close(muscle.gain(P, eps), difference, difference, 1e-7)


def test_gain_slope_is_the_central_difference_of_the_slope_over_pressure(muscle, domain):
    P, eps = domain
    h = 1e-5 * P
    difference = (muscle.slope(P + h, eps) - muscle.slope(P - h, eps)) / (2 * h)
    assert close(muscle.gain_slope(P, eps), difference, muscle.slope(P, eps) / P, 1e-7)


def test_more_pressure_pulls_more_and_stiffens_where_nothing_else_is_said(muscle, taut):
    P, eps = taut
    failure = monotonicity_failure(muscle, P.max(), (eps.min(), eps.max()))
    if type(muscle).__name__ not in BREAKING:
        assert failure == ""
    if failure == "":
        assert (muscle.gain(P, eps) > 0).all()
        assert (muscle.gain_slope(P, eps) < 0).all()


def test_a_muscle_that_says_it_breaks_monotonicity_does(muscle, taut):
    if muscle.limitation:
        P, eps = taut
        kept = (muscle.gain(P, eps) > 0) & (muscle.gain_slope(P, eps) < 0)
        assert not kept.any()


def test_without_pressure_only_the_passive_force_is_left(muscle, domain):
    _, eps = domain
    F = muscle.force(0.0, eps)
    assert F.shape == eps.shape
    assert (F <= 0.15 * muscle.force(5 * BAR, eps).max()).all()
    np.testing.assert_allclose(muscle.force(1e-6, eps), F, atol=1e-6)  # and the law is continuous there


@pytest.mark.parametrize("method", METHODS)
def test_pressures_and_contractions_broadcast(muscle, domain, method):
    P, eps = domain
    law = getattr(muscle, method)
    grid = law(P, eps)
    assert grid.shape == (12, 25)
    assert np.shape(law(float(P[3, 0]), float(eps[7]))) == ()
    for i, j in ((0, 0), (3, 7), (11, 24)):
        one = law(float(P[i, 0]), float(eps[j]))
        np.testing.assert_allclose(one, grid[i, j], rtol=1e-12)


def test_pressure_for_a_force_inverts_the_force(muscle, taut):
    P, eps = taut
    np.testing.assert_allclose(muscle.pressure(muscle.force(P, eps), eps), P, rtol=1e-7)


def test_no_pressure_gives_an_impossible_force(muscle):
    assert not np.isfinite(muscle.pressure(np.nan, 0.1))


def test_the_citation_names_authors_and_year(muscle):
    name = type(muscle).__name__
    expected = (
        "of the user"
        if name in ("FunctionMuscle", "TableMuscle", "AffinePolynomial", "ThresholdPolynomial")
        else name[-4:]
        if name[-4:].isdigit()
        else "2021"
    )
    assert expected in muscle.citation
    assert type(muscle).__doc__


def test_saved_and_loaded_it_is_the_same_muscle(muscle, tmp_path):
    if isinstance(muscle, FunctionMuscle):
        with pytest.raises(ValueError, match="cannot be written to a file; sample them into a TableMuscle"):
            muscle.save(tmp_path / "muscle.toml")
        return
    muscle.save(tmp_path / "muscle.toml", source={"about": 'a "test"', "n": 3, "x": 0.5})
    for reader in (Muscle, type(muscle)):
        loaded = reader.load(tmp_path / "muscle.toml")
        assert type(loaded) is type(muscle)
        assert loaded == muscle
        assert hash(loaded) == hash(muscle)
        assert loaded.covariance == muscle.covariance
    others = [model for model in MODELS.values() if model is not type(muscle)]
    with pytest.raises(InvalidFile, match=f"holds a {type(muscle).__name__}, not a {others[0].__name__}"):
        others[0].load(tmp_path / "muscle.toml")


def test_a_muscle_is_a_value(muscle):
    with pytest.raises(AttributeError):
        muscle.citation = "mine"
    assert muscle.with_parameters({}).parameters == muscle.parameters


def test_the_list_of_models_names_them_all():
    def final(cls):
        below = cls.__subclasses__()
        return {cls} if not below else {f for each in below for f in final(each)}

    in_package = {cls for cls in final(Muscle) if cls.__module__.startswith("allocator.")}
    assert in_package - set(MODELS.values()) == {Cabled, FunctionMuscle}
    assert all(name == model.__name__ for name, model in MODELS.items())


def test_a_model_of_one_s_own_scales_as_its_class_says():
    class Twice(Hogan1984):
        pass

    class Silent(FunctionMuscle):
        pass

    pull = Twice(1000.0, 0.3, 5 * BAR)
    assert scaled(pull, 1.5).force(2 * BAR, 0.1) == pytest.approx(1.5 * pull.force(2 * BAR, 0.1), rel=1e-12)
    with pytest.raises(InvalidInput, match="how the force of a Silent scales is not known"):
        scaled(Silent(lambda eps: 0.01 * (1 - eps), lambda eps: 0 * eps), 1.5)
