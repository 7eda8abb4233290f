"""The ranking of models by cross-validation, on the samples that all of them take."""

import numpy as np
import pytest

from allocator import AntagonistJoint, Pulley, allocate
from allocator.identification import DATASETS, Samples, load_dataset, rank_models
from allocator.muscles import MODELS, AffinePolynomial, Hildebrandt2005, Hogan1984, TableMuscle, TonduLopez2000
from allocator.units import BAR

WORKING = {"pressure_range": (0.95 * BAR, 7 * BAR), "contraction_range": (0.0, 0.3)}
OPTIONS = {name: {} if name == "dmsp-20-300-map" else WORKING for name in DATASETS}


@pytest.mark.parametrize("name", DATASETS)
def test_every_model_is_ranked_on_every_table(name):
    ranking = rank_models(load_dataset(name), **OPTIONS[name])
    assert {f.model for f in ranking.fits} == set(MODELS)
    assert ranking.failures == {}
    errors = [f.cross_validated for f in ranking.fits]
    assert errors == sorted(errors)
    assert ranking.best.monotone
    assert ranking.best.closed_form


@pytest.mark.slow
def test_all_models_are_judged_as_if_there_were_only_the_samples_that_all_take():
    """The sheet has stretched samples, which Hildebrandt2005 cannot take. (The knots of a table follow the range.)"""
    sheet = load_dataset("dmsp-20-sheet")
    models = [model for model in MODELS.values() if model is not TableMuscle]
    everything, contracted = (rank_models(sheet, models, contraction_range=(low, 0.3)) for low in (-0.1, 0.0))
    assert (everything.samples, everything.judged) == (58, 39)
    assert (contracted.samples, contracted.judged) == (39, 39)
    assert {f.model: f.samples.n for f in everything.fits} == {m.__name__: 58 for m in models} | {"Hildebrandt2005": 39}
    expected = {f.model: f.cross_validated for f in contracted.fits}
    for found in everything.fits:
        assert found.cross_validated == pytest.approx(expected[found.model], rel=1e-4)


def test_a_model_that_leaves_out_more_than_a_tenth_is_not_the_best():
    """A law that only Hildebrandt2005 can follow, with a third of the samples where that does not exist."""
    P, eps = (a.ravel() for a in np.meshgrid(np.arange(1, 6) * BAR, np.linspace(-0.05, 0.1, 16)))
    contracted = np.maximum(eps, 0)
    law = Hildebrandt2005(2.75e-3, -1.02e-2, 6.8e-3, -150.0, -11000.0, -7300.0, 59000.0, 7300.0)
    F = law.force(P, contracted) + 2000 * np.minimum(eps, 0)
    ranking = rank_models(Samples.checked(eps, P, F), (Hogan1984, AffinePolynomial, Hildebrandt2005))
    assert ranking.fits[0].model == "Hildebrandt2005"
    assert ranking.fits[0].monotone
    assert ranking.best.model != "Hildebrandt2005"


def test_the_best_affine_law_and_its_cost_are_named():
    """Forces that grow with the square of the pressure, which no affine law follows."""
    P, eps = (a.ravel() for a in np.meshgrid(np.arange(1, 6) * BAR, np.linspace(0.0, 0.2, 12)))
    F = 300 * (P / BAR) ** 2 * (1 - 4 * eps)
    models = (Hogan1984, AffinePolynomial, TonduLopez2000, TableMuscle)
    ranking = rank_models(Samples.checked(eps, P, F), models)
    others = [f for f in ranking.fits if f.model in ("Hogan1984", "AffinePolynomial", "TableMuscle") and f.monotone]
    assert ranking.affine is others[0]
    assert ranking.cost_of_affine == ranking.affine.cross_validated / ranking.fits[0].cross_validated
    assert ranking.cost_of_affine >= 1
    alone = rank_models(Samples.checked(eps, P, F), (TonduLopez2000,))
    assert alone.affine is None
    assert np.isnan(alone.cost_of_affine)


def test_without_cross_validation_models_are_ranked_on_the_same_samples_too():
    sheet = load_dataset("dmsp-20-sheet")
    ranking = rank_models(sheet, folds=0)
    use = sheet.where((sheet.contraction >= 0) & (sheet.force > 0))
    errors = [np.sum((f.muscle.force(use.pressure, use.contraction) - use.force) ** 2) for f in ranking.fits]
    assert errors == sorted(errors)


@pytest.mark.slow
def test_a_model_that_cannot_be_fitted_is_ranked_with_the_reason():
    measured = load_dataset("dmsp-20-300-map")
    few = measured.where(np.isin(np.arange(measured.n), [30, 40, 60, 100, 110]) | (measured.pressure > 6.7 * BAR))
    ranking = rank_models(few)
    assert "taut samples cannot determine the 10 parameters of TableMuscle" in ranking.failures["TableMuscle"]
    assert len(ranking.fits) + len(ranking.failures) == len(MODELS)


@pytest.mark.slow
@pytest.mark.parametrize("name", DATASETS)
def test_a_joint_of_fitted_muscles_is_allocated_exactly(name):
    theta, P1, P2 = np.array([-0.5, 0.0, 0.7]), np.array([3.5, 4.0, 4.5]) * BAR, np.array([4.2, 4.0, 3.8]) * BAR
    for found in rank_models(load_dataset(name), folds=0, **OPTIONS[name]).fits:
        if not found.monotone:
            continue
        joint = AntagonistJoint(Pulley(0.40, 0.02, 0.1375), found.muscle, found.muscle)
        assert (np.array(joint.forces(theta, P1, P2)) > 0).all()
        answer = allocate(theta, joint.stiffness(theta, P1, P2), joint.torque(theta, P1, P2), joint=joint)
        assert answer.success.all()
        np.testing.assert_allclose(answer.P1, P1, rtol=1e-6)
        np.testing.assert_allclose(answer.P2, P2, rtol=1e-6)
