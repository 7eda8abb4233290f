"""Sensitivities to the parameters, and the delta method against a thousand muscles drawn from the covariance."""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.identification import fit, load_dataset
from allocator.muscles import (
    FunctionMuscle,
    Sarosi2012,
    force_gradient,
    force_std,
    parameter_sensitivities,
    slope_std,
    standard_deviation,
)
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR


def moved(muscle, name, by):
    return muscle.unchecked([v + by * (n == name) for n, v in muscle.parameters.items()])


def test_sensitivities_are_central_differences_in_the_parameters(muscle, domain):
    if isinstance(muscle, FunctionMuscle):
        return
    P, eps = domain[0], domain[1][2:]
    names, force, slope = parameter_sensitivities(muscle, P, eps)
    assert names == tuple(muscle.parameters)
    assert force.shape == slope.shape == (12, 23, len(names))
    for i, name in enumerate(names):
        h = 1e-5 * (abs(muscle.parameters[name]) or 1.0)
        if h * np.abs(force[..., i]).max() < 1e-9:
            h = 1.0  # a linear coefficient that happens to be next to zero
        up, down = moved(muscle, name, h), moved(muscle, name, -h)
        for column, law in ((force, "force"), (slope, "slope")):
            difference = (getattr(up, law)(P, eps) - getattr(down, law)(P, eps)) / (2 * h)
            tolerance = 1e-6 * np.abs(difference).max() + 1e-9 * np.abs(getattr(muscle, law)(P, eps)).max() / h
            np.testing.assert_allclose(column[..., i], difference, atol=tolerance)


@pytest.fixture(scope="module")
def fitted_sarosi():
    measured = load_dataset("dmsp-20-300-map")
    return fit(Sarosi2012, measured.contraction, measured.pressure, measured.force).muscle


def test_the_delta_method_is_the_spread_of_muscles_drawn_from_the_covariance(fitted_sarosi):
    P, eps = np.array([1, 3, 5]) * BAR, np.array([0.05, 0.1375, 0.2])
    draws = np.random.default_rng(0).multivariate_normal(
        list(fitted_sarosi.parameters.values()), np.array(fitted_sarosi.covariance), 2000, method="cholesky"
    )
    muscles = [fitted_sarosi.unchecked(row.tolist()) for row in draws]
    np.testing.assert_allclose(
        force_std(fitted_sarosi, P, eps), np.std([m.force(P, eps) for m in muscles], 0), rtol=0.1
    )
    np.testing.assert_allclose(
        slope_std(fitted_sarosi, P, eps), np.std([m.slope(P, eps) for m in muscles], 0), rtol=0.1
    )


def test_two_muscles_of_one_fit_err_together(fitted_sarosi):
    gradient = force_gradient(fitted_sarosi, 3 * BAR, 0.1)
    one, both = standard_deviation(fitted_sarosi, gradient), standard_deviation(fitted_sarosi, 2 * gradient)
    assert both == pytest.approx(2 * one, rel=1e-12)


def test_a_muscle_that_was_not_fitted_has_no_standard_deviation():
    with pytest.raises(InvalidInput, match="has no covariance: it was not fitted"):
        force_std(SAROSI_DMSP_20_400N, 3 * BAR, 0.1)
