"""Force surfaces: shape, agreement with a known law, other lengths."""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import ForceSurface
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N as MUSCLE
from allocator.units import BAR

P, EPS = (a.ravel() for a in np.meshgrid(np.linspace(1, 6, 40) * BAR, np.linspace(0.0, 0.2, 9)))
FINE_P, FINE = np.meshgrid(np.linspace(1, 6, 57) * BAR, np.linspace(0.0, 0.2, 57))


def surface(noise=0.0, seed=1):
    force = MUSCLE.force(P, EPS) + np.random.default_rng(seed).normal(0, 1, P.size) * noise
    return ForceSurface.fit(EPS, P, force, pressures=12, contractions=6)


def test_a_noisy_surface_keeps_the_shape_of_a_muscle():
    """Force grows with pressure and falls with contraction; stiffness grows with pressure where the muscle pulls."""
    for seed in range(1, 6):
        found = surface(60.0, seed)
        F, slope = found.force(FINE_P, FINE), found.slope(FINE_P, FINE)
        assert (np.diff(F, axis=1) >= -1e-6).all()
        assert (np.diff(F, axis=0) <= 1e-6).all()
        pulls = F[:, :-1] > 0.25 * F.max()  # at all splines of a cell
        assert pulls.mean() > 0.45
        assert (np.diff(slope, axis=1)[pulls] <= 1e-4).all()


def test_a_muscle_that_is_slack_below_a_pressure_that_grows_with_contraction_is_followed():
    """At this threshold the slope over an interval with a slack end falls with pressure, as on measured muscles."""
    P, eps = (a.ravel() for a in np.meshgrid(np.linspace(0, 6, 61) * BAR, np.array([0.0, 0.05, 0.1, 0.15])))
    force = np.maximum(70 * (P / BAR - 40 * eps), 0.0) * (1 + 6 * eps)
    found = ForceSurface.fit(eps, P, force, pressures=16)
    assert found.rms < 14  # 15.3 N if the slope had to grow from no pressure on


def test_a_surface_comes_near_the_law_that_made_its_table():
    error = surface().force(FINE_P, FINE) - MUSCLE.force(FINE_P, FINE)
    assert np.sqrt(np.mean(error**2)) < 0.01 * np.ptp(MUSCLE.force(P, EPS))


def test_the_slope_is_the_derivative_of_the_force():
    found = surface().at_length(0.2, 0.3, 0.04)
    at, h = np.linspace(0.03, 0.13, 7), 1e-6
    difference = (found.force(3 * BAR, at + h) - found.force(3 * BAR, at - h)) / (2 * h)
    np.testing.assert_allclose(found.slope(3 * BAR, at), difference, rtol=1e-5)


def test_the_force_at_no_contraction_grows_with_length_as_measured():
    """Festo muscles of 10 mm at 6 bar, 10 to 40 cm long: 304, 366, 422, 439 N."""
    of = [float(surface().at_length(0.4, length, 0.04).force(6 * BAR, 0.0)) for length in (0.1, 0.2, 0.3, 0.4)]
    np.testing.assert_allclose(np.array(of) / of[-1], np.array([304, 366, 422, 439]) / 439, atol=0.06)


def test_one_reading_tells_the_strength_of_another_muscle():
    found = surface().at_length(0.2, 0.3, 0.04)
    other = found.calibrated(6 * BAR, 0.0, 400.0)
    assert float(other.force(6 * BAR, 0.0)) == pytest.approx(400.0)
    at = np.linspace(0.0, 0.13, 7)
    ratio = 400.0 / float(found.force(6 * BAR, 0.0))
    np.testing.assert_allclose(other.force(3 * BAR, at), ratio * found.force(3 * BAR, at))
    np.testing.assert_allclose(other.slope(3 * BAR, at), ratio * found.slope(3 * BAR, at))
    assert surface().std == pytest.approx(surface().rms)
    assert 0.023 * 400 < other.std < found.std
    with pytest.raises(InvalidInput, match="a muscle of -1 N: both have to pull"):
        found.calibrated(6 * BAR, 0.0, -1.0)
    with pytest.raises(InvalidInput, match="force"):
        found.calibrated(6 * BAR, 0.0, np.nan)
    with pytest.raises(InvalidInput, match="if bar was meant"):
        found.calibrated(6.0, 0.0, 400.0)


def test_what_tells_no_surface_is_refused():
    with pytest.raises(InvalidInput, match="360 samples do not tell 40 × 20 coefficients"):
        ForceSurface.fit(EPS, P, P * 0, pressures=40, contractions=20)
    with pytest.raises(InvalidInput, match=r"end length 0\.3 has to be less than both lengths, 0\.2 and 0\.3"):
        surface().at_length(0.2, 0.3, 0.3)
