"""A raw force log becomes few samples, in bounded memory, and tells no more about the muscle than it knows."""

import tracemalloc

import numpy as np
import pytest

from allocator.identification import Samples, fit
from allocator.identification.least_squares import determine
from allocator.identification.muscle.samples import MOST_ROWS, thinned
from allocator.muscles import Sarosi2012
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR


def log(rows, seed=0):
    """Contraction, pressure [Pa] and force [N] at 100 Hz: sweeps of a minute, at 1 … 5 bar in turn.

    2 N of zero noise, 3 % of hysteresis, and 2 % of an error that lasts (as friction and creep do) 1 s.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(rows) / 100
    phase = t % 60 / 60
    eps = 0.25 * (1 - np.abs(2 * phase - 1))
    P = (1 + t // 60 % 5) * BAR + rng.normal(0, 300, rows)
    seconds = np.arange(int(t[-1]) + 2)
    lasting = np.interp(t, seconds, rng.standard_normal(seconds.size))
    F = np.maximum(SAROSI_DMSP_20_400N.force(P, eps), 0) * (1 + 0.03 * np.sign(0.5 - phase) + 0.02 * lasting)
    return eps + rng.normal(0, 2e-4, rows), P, F + rng.normal(0, 2, rows)


def test_ten_minutes_at_100_hz_are_fitted_in_bounded_memory():
    samples = log(60_000)
    tracemalloc.start()
    found = fit(Sarosi2012, *samples)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 200e6  # bytes
    assert found.samples.n <= MOST_ROWS
    said = f"60000 rows became {found.samples.n} samples, means over cells"
    assert any(note.startswith(said) for note in found.samples.notes)


@pytest.mark.slow
def test_the_parameters_of_a_log_are_within_three_standard_deviations():
    for seed in range(8):
        found = fit(Sarosi2012, *log(30_000, seed), folds=0)
        for name, value in SAROSI_DMSP_20_400N.parameters.items():
            assert abs(found.muscle.parameters[name] - value) <= 3 * found.standard_deviations[name]


def test_rows_said_again_make_nothing_more_certain():
    once = [a[::10] for a in log(30_000)]
    often = [np.repeat(a, 5) for a in once]
    here, there = fit(Sarosi2012, *once, folds=0), fit(Sarosi2012, *often, folds=0)
    for name, std in here.standard_deviations.items():
        assert there.standard_deviations[name] == pytest.approx(std, rel=0.05)


def test_the_scatter_of_a_cell_is_that_about_its_plane():
    """Of a force that is a plane over contraction and pressure, with normal noise, only the noise is left."""
    rng = np.random.default_rng(3)
    eps, P = rng.uniform(0, 0.2, 100_000), rng.uniform(1, 5, 100_000) * BAR
    cells = thinned(Samples.checked(eps, P, 500 - 1500 * eps + 2e-3 * P + rng.normal(0, 3.0, eps.size)))
    assert cells.n == 64 * 32
    assert np.sqrt(np.mean(cells.scatter**2)) == pytest.approx(3.0, rel=0.05)


def test_a_row_of_weight_zero_is_in_no_cell():
    eps, P, F = log(6000)
    out = np.arange(6000) % 2 == 0
    spoilt = np.where(out, F + 500, F)
    cells = thinned(Samples.checked(eps, P, spoilt, weights=np.where(out, 0.0, 1.0)))
    kept = thinned(Samples.checked(eps[~out], P[~out], F[~out]))
    np.testing.assert_allclose(np.sort(cells.force), np.sort(kept.force), rtol=1e-9)


def test_a_table_stays_as_it_is():
    eps, P, F = (a[:MOST_ROWS] for a in log(3000))
    samples = Samples.checked(eps, P, F)
    assert thinned(samples) is samples


def test_a_tall_jacobian_is_determined_in_memory_of_its_size():
    rng = np.random.default_rng(0)
    J = rng.standard_normal((60_000, 6))
    tracemalloc.start()
    found = determine(J, 60_000.0, tuple("abcdef"), np.ones(6))
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 5 * J.nbytes
    expected = np.linalg.inv(J.T @ J) * 60_000 / (60_000 - 6)
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-8, atol=1e-16)
