"""A muscle whose bladder has to reach its braid before it pulls."""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import fit
from allocator.muscles import AffinePolynomial, ThresholdPolynomial
from allocator.units import BAR

AREA, PASSIVE = (3e-3, -1.2e-2, 8e-3), (-5.0, -200.0)
MUSCLE = ThresholdPolynomial(AREA, PASSIVE, 0.2 * BAR)


def test_far_above_the_threshold_it_lacks_the_threshold_and_far_below_all_pressure():
    eps = np.linspace(0, 0.2, 5)
    plain = AffinePolynomial(AREA, PASSIVE)
    np.testing.assert_allclose(MUSCLE.force(4 * BAR, eps), plain.force((3.8 + 0.04 / 4.2) * BAR, eps), rtol=1e-12)
    np.testing.assert_allclose(MUSCLE.force(0.0, eps), plain.force(0.0, eps))
    assert MUSCLE.effective_pressure(0.02 * BAR) == pytest.approx(0.02 * BAR * 0.02 / 0.2, rel=0.11)  # P²/P_t


def test_without_a_threshold_it_is_the_plain_polynomial():
    P, eps = np.linspace(0.5, 5, 7) * BAR, np.linspace(0, 0.2, 5)[:, None]
    nearly = ThresholdPolynomial(AREA, PASSIVE, 1e-3)
    np.testing.assert_allclose(nearly.force(P, eps), AffinePolynomial(AREA, PASSIVE).force(P, eps), rtol=1e-6)


def test_the_inverse_is_exact_down_to_the_slack_limit():
    eps, F = np.linspace(0, 0.2, 6), np.array([0.0, 1e-3, 1.0, 100.0])[:, None]
    P = MUSCLE.pressure(F, eps)
    np.testing.assert_allclose(MUSCLE.law(P, eps), np.broadcast_to(F, P.shape), atol=1e-7)
    assert (MUSCLE.pressure(-300.0, eps) == -np.inf).all()


def test_a_fit_finds_the_threshold_and_the_plain_polynomial_does_not_follow():
    rng = np.random.default_rng(6)
    P, eps = (a.ravel() for a in np.meshgrid(np.array([0.1, 0.2, 0.4, 0.8, 1.5, 3, 5]) * BAR, np.linspace(0, 0.2, 9)))
    F = np.maximum(MUSCLE.force(P, eps), 0.0) + rng.normal(0, 1.0, P.size)
    found = fit(ThresholdPolynomial, eps, P, F, folds=0)
    assert abs(found.muscle.P_t - 0.2 * BAR) < 4 * found.standard_deviations["P_t"]
    assert found.standard_deviations["P_t"] < 0.02 * BAR
    assert fit(AffinePolynomial, eps, P, F, folds=0).rms > 2 * found.rms


def test_a_threshold_of_another_form_is_followed_better_than_without_one():
    """The truth is P - P_t (1 - exp(-P/P_t))."""
    rng, P_t = np.random.default_rng(8), 0.2 * BAR
    P, eps = (a.ravel() for a in np.meshgrid(np.array([0.1, 0.2, 0.4, 0.8, 1.5, 3, 5]) * BAR, np.linspace(0, 0.2, 9)))
    F = AffinePolynomial(AREA, PASSIVE).force(P - P_t * (1 - np.exp(-P / P_t)), eps)
    F = np.maximum(F, 0.0) + rng.normal(0, 1.0, P.size)
    found = fit(ThresholdPolynomial, eps, P, F, folds=0)
    assert 0.1 * BAR < found.muscle.P_t < 0.4 * BAR
    assert found.rms < fit(AffinePolynomial, eps, P, F, folds=0).rms / 2


@pytest.mark.parametrize(
    ("area", "P_t", "said"), [((), 1e4, "at least one"), (AREA, 0.0, "positive pressure"), (AREA, -1.0, "positive")]
)
def test_what_is_no_threshold_is_refused(area, P_t, said):
    with pytest.raises(InvalidInput, match=said):
        ThresholdPolynomial(area, PASSIVE, P_t)
