"""A fit recovers every model from its own samples: 200 points, 2 % noise, 100 seeds."""

import numpy as np
import pytest
from scipy.special import fdtri

from allocator.identification import fit
from allocator.muscles import (
    MODELS,
    AffinePolynomial,
    Andrikopoulos2016,
    ChouHannaford1996,
    Hildebrandt2005,
    Hogan1984,
    KazemipourKatzschmann2025,
    PolynomialMcKibben,
    TableMuscle,
    ThresholdPolynomial,
    TonduLopez2000,
    Wickramatunge2010,
    slope_std,
)
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG

BRAID = (0.0109, 25.5 * DEG)
KNOTS = np.linspace(0, 0.25, 5)
TRUTHS = {  # a muscle, and what has to be held so that forces determine the rest
    "hogan": (Hogan1984(1500.0, 0.3, 5 * BAR), {"P_max": 5 * BAR}),
    "tondu-lopez-1995": (TONDU_MCKIBBEN, {}),
    "chou-hannaford": (ChouHannaford1996(0.3, 0.34, 1.6, 0.0008), {"rest_length": 0.3}),
    "tondu-lopez-2000": (TonduLopez2000(*BRAID, 1.3, 1.5, 1.5 * BAR), {}),
    "hildebrandt": (Hildebrandt2005(2.75e-3, -1.02e-2, 6.8e-3, -150.0, -11000.0, -7300.0, 59000.0, 7300.0), {}),
    "wickramatunge": (
        Wickramatunge2010(0.3, 0.17, -6000.0, 3.5e5, 0.12, 2.1e-8, 7.1e-9, 2.5 * BAR),
        {"rest_length": 0.3, "P_switch": 2.5 * BAR},
    ),
    "sarosi": (SAROSI_DMSP_20_400N, {}),
    "andrikopoulos": (Andrikopoulos2016(*BRAID, 1.3, 1.5, 1.5 * BAR, 0.8), {"r0": BRAID[0]}),
    "martens-boblan": (MARTENS_DMSP_20_300, {"L0": 0.3, "H0": 0.0018}),
    "polynomial": (
        PolynomialMcKibben.identify(*BRAID, (3 * BAR, 4 * BAR, 5 * BAR), (0.225, 0.253, 0.275)),
        {"r0": BRAID[0]},
    ),
    "tondu-2021": (TONDU_DMSP_20_400N, {"r0": BRAID[0]}),
    "kazemipour": (KazemipourKatzschmann2025(1500.0, -2800.0, -11000.0, 4.7, 5 * BAR), {"P_max": 5 * BAR}),
    "affine-polynomial": (AffinePolynomial((2.8e-3, -1.2e-2, 1.9e-2), (-130.0, -1570.0)), {}),
    "threshold": (ThresholdPolynomial((2.8e-3, -1.2e-2, 1.9e-2), (-10.0, -1570.0), 0.3 * BAR), {"P_t": 0.3 * BAR}),
    "table": (TableMuscle(KNOTS, SAROSI_DMSP_20_400N.A(KNOTS), SAROSI_DMSP_20_400N.B(KNOTS)), {}),
}
COLLINEAR = {  # left free: what forces cannot tell apart
    "andrikopoulos": {"r0", "q"},
    "polynomial": {"r0", "alpha0", "coefficients[0]", "coefficients[1]", "coefficients[2]"},
    "tondu-2021": {"r0", "alpha0", "c", "e"},
}


def sampled(muscle, seed, noise=0.02, n=200):
    """Contractions, pressures [Pa] and forces [N] (n,) of a taut muscle, with noise in parts of full scale."""
    rng = np.random.default_rng(seed)
    P, eps = rng.uniform(0.5, 5, 20 * n) * BAR, rng.uniform(0.005, 0.25, 20 * n)
    F = np.where(muscle.covers(P, eps), muscle.force(P, eps), -1.0)
    full = F.max()
    taut = np.flatnonzero(F > 3 * noise * full)[:n]  # noise alone makes none of them slack
    assert taut.size == n
    return eps[taut], P[taut], F[taut] + noise * full * rng.standard_normal(n)


def fit_truth(name, seed, **options):
    truth, hold = TRUTHS[name]
    start = truth if name == "table" else None  # the knots are not fitted
    return fit(type(truth), *sampled(truth, seed, **options), hold=hold, folds=0, start=start)


def test_every_model_has_a_truth():
    assert {type(truth) for truth, _ in TRUTHS.values()} == set(MODELS.values())


def in_confidence_region(found, muscle, level):
    """Whether the samples are compatible with another `muscle` of the same kind at this level of confidence.

    The region {p: (S(p) - S_min)/r ≤ s² F_level(r, n - r)}, S the sum of squares, r the rank, s² the variance of the
    residuals (Bates & Watts 1988, section 6.1), does not depend on the parametrisation of the law.
    """
    samples, freedom = found.samples, found.samples.n - found.rank

    def cost(muscle):
        F = muscle.law(samples.pressure, samples.contraction)
        return samples.weights @ samples.residual(F, found.slack) ** 2

    least = cost(found.muscle)
    return cost(muscle) - least <= found.rank * least / freedom * fdtri(found.rank, freedom, level)


@pytest.mark.slow
@pytest.mark.parametrize("name", TRUTHS)
def test_the_truth_is_inside_the_99_percent_region_and_its_stiffness_inside_the_band(name):
    truth, _ = TRUTHS[name]
    P, eps = np.array([2.5, 4.0]) * BAR, 0.1375
    inside, covered = 0, np.zeros(2, int)
    for seed in range(40):
        found = fit_truth(name, seed)
        assert found.collinear == ()
        inside += in_confidence_region(found, truth, 0.99)
        error = np.abs(found.muscle.slope(P, eps) - truth.slope(P, eps))
        covered += error <= 2.6 * slope_std(found.muscle, P, eps)  # 99 % of a normal distribution
    assert inside >= 38
    assert (covered >= 38).all()


@pytest.mark.parametrize("name", TRUTHS)
def test_without_noise_the_force_is_recovered_exactly(name):
    found = fit_truth(name, seed=0, noise=0.0)
    assert found.rms < 1e-5 * found.samples.full_scale


@pytest.mark.parametrize("name", ["hogan", "tondu-lopez-1995", "sarosi", "hildebrandt", "kazemipour", "polynomial"])
def test_without_noise_the_parameters_are_recovered_exactly(name):
    truth, _ = TRUTHS[name]
    found = fit_truth(name, seed=0, noise=0.0)
    for parameter, value in truth.parameters.items():
        assert found.muscle.parameters[parameter] == pytest.approx(value, rel=1e-5)


@pytest.mark.parametrize("name", COLLINEAR)
def test_what_forces_cannot_tell_apart_is_reported_as_collinear(name):
    truth, _ = TRUTHS[name]
    found = fit(type(truth), *sampled(truth, 1), folds=0)
    assert found.rank == len(found.free) - 1
    (direction,) = found.collinear
    changes = {part.split()[0]: float(part.split()[1]) / 100 for part in direction.split(", ")}
    assert set(changes) == set(COLLINEAR[name])
    assert any("changes no force" in warning for warning in found.warnings)
    if name == "andrikopoulos":  # r0² q is all that can be seen
        assert changes["r0"] / changes["q"] == pytest.approx(-0.5, abs=0.01)


@pytest.mark.parametrize("name", COLLINEAR)
def test_moving_along_a_collinear_direction_changes_no_force(name):
    truth, _ = TRUTHS[name]
    found = fit(type(truth), *sampled(truth, 1), folds=0)
    P, eps = found.samples.pressure, found.samples.contraction
    step = {part.split()[0]: 1e-4 * float(part.split()[1]) for part in found.collinear[0].split(", ")}
    p = found.muscle.parameters
    moved = found.muscle.unchecked([v + step.get(n, 0.0) * abs(v) for n, v in p.items()])
    alone = found.muscle.unchecked([v + step.get(n, 0.0) * abs(v) * (n == "r0") for n, v in p.items()])
    F = found.muscle.force(P, eps)
    assert np.abs(moved.force(P, eps) - F).max() < 0.05 * np.abs(alone.force(P, eps) - F).max()
