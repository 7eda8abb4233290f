"""Muscles from static angles, where the given joint rests far from them."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, AntagonistJoint, Pulley
from allocator.errors import InvalidInput
from allocator.identification.motion.result import _holding
from allocator.identification.motion.static import fit_muscles
from allocator.muscles import Muscle
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.muscles.models.affine import Sarosi2012

ONE = Sarosi2012(c1=-0.010896, c2=-0.019754, c3=0.0043103, c4=-127.05, c5=-72.568, c6=-27.038)


def _joint(agonist: Muscle, antagonist: Muscle) -> AntagonistJoint:
    return AntagonistJoint(Pulley(0.25, 0.02, 0.13), agonist, antagonist)


def test_muscles_are_found_from_a_joint_that_rests_elsewhere() -> None:
    rng = np.random.default_rng(1)
    P1, P2 = rng.uniform(1.5, 4.2, (2, 300)) * BAR
    u = np.asarray(_joint(ONE, ONE).equilibrium(P1, P2))
    others = np.array([*ONE.parameters.values()]) * (1 + 0.15 * rng.standard_normal((13, 2, 6)))
    for given in others[7:]:  # the angles of the second jump where it is soft: a search over them alone got stuck
        one, two = (ONE.with_parameters(dict(zip(ONE.parameters, row.tolist(), strict=True))) for row in given)
        agonist, antagonist, zero = fit_muscles(_joint(one, two), u, P1, P2)
        found = zero + np.asarray(_joint(agonist, antagonist).equilibrium(P1, P2))
        assert np.sqrt(np.mean((found - u) ** 2)) < 0.1 * DEG
        assert abs(zero) < 2 * DEG


def test_a_fitted_stiffness_is_kept_where_angles_are_further_than_it_predicts() -> None:
    """A log of commands moves a joint otherwise than its fit; the stiffness once followed, by 6 %."""
    rng = np.random.default_rng(1)
    P1, P2 = rng.uniform(1.5, 4.2, (2, 300)) * BAR
    numbers = np.tile([*ONE.parameters.values()], 2)
    known = replace(_joint(ONE, ONE), covariance=np.diag((0.01 * numbers) ** 2))
    u = 1.1 * np.asarray(known.equilibrium(P1, P2))
    agonist, antagonist, zero = fit_muscles(known, u, P1, P2)
    found = _joint(agonist, antagonist)
    changed = found.stiffness(u - zero, P1, P2) / known.stiffness(u, P1, P2)
    assert np.quantile(np.abs(changed - 1), 0.9) < 0.02  # the others are beyond the range of the joint
    assert np.sqrt(np.mean((zero + np.asarray(found.equilibrium(P1, P2)) - u) ** 2)) < 0.1 * DEG


def test_gas_that_leaves_none_at_rest_length_is_told() -> None:
    muscle = replace(SAROSI_DMSP_20_400N, rest_volume=2e-5)
    joint = _joint(muscle, muscle)
    assert _holding(muscle, 1e-5, joint).rest_volume == pytest.approx(3e-5)
    with pytest.raises(InvalidInput, match=r"leaves this Sarosi2012 -10 cm³ at rest length.*--no-gas"):
        _holding(muscle, -3e-5, joint)
