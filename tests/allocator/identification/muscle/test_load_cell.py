"""A load cell has zero noise, an offset and a sign of its own, and the fit finds the muscle all the same.

The truth is Sarosi2012 (DMSP-20-400N) at 26 contractions × 5 pressures, each force with 2 % noise and 2 N of the cell.
"""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import Samples, fit, rank_models
from allocator.identification.muscle.load_cell import find_zero, reading_variance, zeroed
from allocator.muscles import Hildebrandt2005, MartensBoblan2017, Sarosi2012, TableMuscle
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR

P, EPS = (a.ravel() for a in np.meshgrid(np.arange(1, 6) * BAR, np.arange(26) / 100, indexing="ij"))
TRUE = SAROSI_DMSP_20_400N.force(P, EPS)
ZERO_NOISE = 2.0  # [N]


def readings(seed, *, cut=False, offset=0.0):
    """What the cell shows [N]; one that is `cut` shows no negative force."""
    share, zero = np.random.default_rng(seed).standard_normal((2, P.size))
    F = np.maximum(TRUE, 0.0) * (1 + 0.02 * share) + ZERO_NOISE * zero
    return (np.maximum(F, 0.0) if cut else F) + offset


def deviations(found):
    """How many standard deviations each parameter is off."""
    std = found.standard_deviations
    return np.array([abs(found.muscle.parameters[n] - v) / std[n] for n, v in SAROSI_DMSP_20_400N.parameters.items()])


@pytest.mark.slow
@pytest.mark.parametrize("cut", [False, True], ids=["both signs", "cut off at zero"])
def test_every_parameter_is_within_three_standard_deviations(cut):
    inside = [(deviations(fit(Sarosi2012, EPS, P, readings(seed, cut=cut), folds=0)) <= 3).all() for seed in range(100)]
    assert sum(inside) >= 95


@pytest.mark.slow
@pytest.mark.parametrize("cut", [False, True], ids=["both signs", "cut off at zero"])
def test_the_true_model_is_ranked_first_or_second_among_those_that_come_near(cut):
    rivals = (Sarosi2012, TableMuscle, MartensBoblan2017, Hildebrandt2005)
    for seed in range(8):
        ranking = rank_models(Samples.checked(EPS, P, readings(seed, cut=cut)), rivals)
        assert "Sarosi2012" in [found.model for found in ranking.fits[:2]]


@pytest.mark.parametrize("cut", [False, True], ids=["both signs", "cut off at zero"])
def test_the_zero_noise_is_estimated_without_bias(cut):
    zeros = [find_zero(Samples.checked(EPS, P, readings(seed, cut=cut))) for seed in range(100)]
    assert {zero.cut for zero in zeros} == {cut}
    assert {zero.offset for zero in zeros} == {0.0}
    assert np.sqrt(np.mean([zero.noise**2 for zero in zeros])) == pytest.approx(ZERO_NOISE, rel=0.06)


def test_the_variance_of_the_readings_is_that_of_the_cell():
    ratio = []
    for seed in range(50):
        samples = zeroed(Samples.checked(EPS, P, readings(seed)))
        ratio.append(reading_variance(samples) / (ZERO_NOISE**2 + (0.02 * np.maximum(TRUE, 0)) ** 2))
    assert (np.abs(np.log(np.median(ratio, axis=0))) < 0.3).all()


def test_a_zero_noise_that_is_given_draws_the_line_of_slack():
    found = fit(Sarosi2012, EPS, P, readings(0), zero_noise=5.0, folds=0)
    np.testing.assert_array_equal(found.slack, readings(0) <= 15.0)


@pytest.mark.parametrize("noise", [-1.0, float("nan"), [1.0, 2.0]])
def test_a_zero_noise_that_is_none_is_refused(noise):
    with pytest.raises(InvalidInput, match="zero_noise"):
        fit(Sarosi2012, EPS, P, readings(0), zero_noise=noise)


def test_noisy_forces_at_one_pressure_are_refused_by_a_sentence():
    with pytest.raises(InvalidInput, match="all taut samples are at one pressure, 3 bar"):
        fit(Sarosi2012, EPS[:26], 3 * BAR, readings(0)[52:78], zero_noise=ZERO_NOISE)


@pytest.mark.parametrize("offset", [-15.0, 5.0, 40.0])
def test_an_offset_is_subtracted_and_said(offset):
    found = fit(Sarosi2012, EPS, P, readings(1, offset=offset), folds=0)
    assert (deviations(found) <= 3).all()
    (note,) = found.samples.notes
    assert note.startswith("slack readings lie round ")
    assert float(note.split()[4]) == pytest.approx(offset, abs=3 * ZERO_NOISE / np.sqrt(24))


def test_negative_tension_is_the_same_muscle_and_said():
    here, there = (fit(Sarosi2012, EPS, P, sign * readings(2), folds=0) for sign in (1, -1))
    assert there.muscle == here.muscle
    assert there.samples.notes == ("the forces are negative where the muscle pulls: taken with the other sign",)
    assert here.samples.notes == ()


def test_negative_tension_is_seen_at_one_pressure_too():
    once = P == 3 * BAR
    for seed in range(20):
        samples = Samples.checked(EPS[once], P[once], readings(seed)[once])
        turned = zeroed(Samples.checked(EPS[once], P[once], -readings(seed)[once]))
        assert zeroed(samples).notes == ()
        assert turned.notes == ("the forces are negative where the muscle pulls: taken with the other sign",)
        assert (turned.force == samples.force).all()


def test_extension_given_for_contraction_is_pointed_out():
    with pytest.raises(InvalidInput, match=r"sample 25: the force falls as the muscle is stretched; is it contraction"):
        fit(Sarosi2012, -EPS, P, readings(0))


def test_forces_that_are_all_taut_show_no_zero():
    taut = TRUE > 100
    for seed in range(20):
        assert find_zero(Samples.checked(EPS[taut], P[taut], readings(seed)[taut])) is None


def test_the_slope_of_the_residual_is_its_central_difference():
    F = np.linspace(-10, 10, P.size)
    for cut in (False, True):
        samples = zeroed(Samples.checked(EPS, P, readings(0, cut=cut)))
        for slack in (np.ones(P.size, bool), np.zeros(P.size, bool)):
            h = 1e-5
            difference = (samples.residual(F + h, slack) - samples.residual(F - h, slack)) / (2 * h)
            np.testing.assert_allclose(samples.residual_slope(F, slack), difference, atol=1e-6)


def test_the_mean_residual_of_the_truth_is_zero():
    """Also near zero force, where a cell that cuts its readings off shows too much on average."""
    samples = [zeroed(Samples.checked(EPS, P, readings(seed, cut=True)), ZERO_NOISE) for seed in range(400)]
    mean = np.mean([s.residual(TRUE, np.ones(P.size, bool)) for s in samples], axis=0)
    spread = np.sqrt(ZERO_NOISE**2 + (0.02 * np.maximum(TRUE, 0)) ** 2) / np.sqrt(400)
    assert (np.abs(mean) < 4.5 * spread).all()
