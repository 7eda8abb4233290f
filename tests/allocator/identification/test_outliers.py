"""Outliers of tables: those that were put in are left out and listed, and clean tables keep all their samples."""

import numpy as np
import pytest

from allocator.identification import fit, fit_joint, load_dataset
from allocator.identification.muscle.reading import DATASETS
from allocator.identification.outliers import outlying
from allocator.muscles import Sarosi2012
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

from ...rigs.moving_joint import JOINT

RNG = np.random.default_rng(11)
EPS, P = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.25, 26), np.arange(1, 6) * BAR))
FORCE = np.maximum(SAROSI_DMSP_20_400N.force(P, EPS), 0.0) * (1 + 0.02 * RNG.normal(size=P.size))
FORCE = FORCE + 2 * RNG.normal(size=P.size)
WRONG = np.array([3, 40, 77, 101])


def spoiled():
    force = FORCE.copy()
    force[WRONG] += np.array([400.0, -350.0, 250.0, -500.0])
    return force


def test_wrong_forces_are_listed_and_do_not_move_the_parameters():
    clean, found = (fit(Sarosi2012, EPS, P, force, folds=0) for force in (FORCE, spoiled()))
    (said,) = found.samples.dropped
    assert found.samples.dropped[said] == WRONG.size
    assert said.startswith("force apart from those at like contractions and pressures: ")
    assert all(f"{force:.4g} N at" in said for force in spoiled()[WRONG])
    for name, std in clean.standard_deviations.items():
        assert abs(found.muscle.parameters[name] - clean.muscle.parameters[name]) <= 1.96 * std
        assert found.standard_deviations[name] == pytest.approx(std, rel=0.2)


@pytest.mark.parametrize("name", DATASETS)
def test_no_sample_of_a_measured_table_stands_apart(name):
    samples = load_dataset(name)
    assert samples.without_outliers() is samples


def test_many_strange_values_are_no_outliers():
    strange = FORCE + np.where(np.arange(P.size) % 10 == 0, 600.0, 0.0)
    assert not outlying(np.stack([EPS, P], axis=1), strange).any()


def test_wrong_equilibria_of_a_joint_are_listed_and_do_not_move_it():
    theta, P1, P2 = equilibria()
    wrong = theta.copy()
    wrong[[7, 60]] += np.array([25.0, -20.0]) * DEG
    clean, found = (
        fit_joint(a, P1, P2, geometry=JOINT.geometry, leave_one_out=False, choices=False) for a in (theta, wrong)
    )
    (said,) = found.samples.dropped
    assert said.startswith("angle apart from those at like pressures: ")
    assert found.samples.dropped[said] == 2
    for name in ("zero", "log_ratio"):
        assert clean.standard_deviations[name] > 0
    assert abs(found.zero - clean.zero) <= 1.96 * clean.standard_deviations["zero"]
    assert abs(np.log(found.ratio / clean.ratio)) <= 1.96 * clean.standard_deviations["log_ratio"]


def equilibria():
    """Angles [rad] with 0.1° of noise on a grid of pressures [Pa]."""
    P1, P2 = (a.ravel() for a in np.meshgrid(np.arange(1.5, 4.6, 0.3) * BAR, np.arange(1.5, 4.6, 0.3) * BAR))
    kept = np.abs(P1 - P2) < 1.6 * BAR
    P1, P2 = P1[kept], P2[kept]
    theta = np.array([JOINT.equilibrium(a, b) for a, b in zip(P1, P2, strict=True)])
    return theta + 0.1 * DEG * np.random.default_rng(3).normal(size=P1.size), P1, P2
