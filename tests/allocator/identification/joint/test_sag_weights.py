"""Sag rows at low pressures share what a law without a threshold pressure gets wrong there."""

import numpy as np
import pytest

from allocator.identification import fit_joint
from allocator.identification.joint.samples import THRESHOLD, JointSamples, SlackReadings, weighed
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Lever
from allocator.muscles import ThresholdPolynomial
from allocator.units import BAR, DEG

GEOMETRY = Lever(0.25, 0.1655, 0.05094, 0.051)


def readings(P, noise):
    ones = np.ones(P.size)
    samples = JointSamples.checked(0 * P, P, 2 * BAR * ones, geometry=GEOMETRY)
    return SlackReadings(samples, ones.astype(bool), noise)


def test_the_sum_of_squares_is_that_of_correlated_readings():
    P, noise = np.array([0.05, 0.2, 0.4, 1.2]) * BAR, 0.03 * BAR
    b = THRESHOLD * np.exp(-P / THRESHOLD)
    C = noise**2 * np.eye(4) + np.outer(b, b)
    error = np.random.default_rng(1).normal(0, 0.1 * BAR, 4)
    found = weighed(readings(P, noise), error, has_threshold=False)
    assert found @ found / noise**2 == pytest.approx(error @ np.linalg.solve(C, error))


def test_readings_far_above_any_threshold_and_laws_that_have_one_keep_their_weight():
    error = np.array([1.0, -2.0]) * 0.01 * BAR
    high = readings(np.array([5.0, 6.0]) * BAR, 0.05 * BAR)
    np.testing.assert_allclose(weighed(high, error, has_threshold=False), error, rtol=1e-5)
    low = readings(np.array([0.1, 0.2]) * BAR, 0.05 * BAR)
    np.testing.assert_array_equal(weighed(low, error, has_threshold=True), error)


@pytest.mark.slow
def test_a_sag_test_of_a_home_made_muscle_does_not_spoil_the_stiffness():
    """Twins with a threshold of 0.2 bar, of which Sarosi's law knows nothing; the truth is another law."""
    true = ThresholdPolynomial((2.2e-3, -1.1e-2, 6e-3), (4.0, -90.0), 0.2 * BAR)
    joint = AntagonistJoint(GEOMETRY, true, true, (0, 6 * BAR), min_contraction=-0.05)
    rng = np.random.default_rng(0)
    P1, P2 = (P.ravel() for P in np.meshgrid(*[np.array([1.0, 1.5, 2, 3, 4, 5]) * BAR] * 2))
    T = np.tile([0.0, 1.0], 18)
    theta = joint.equilibrium(P1, P2, T)
    there = np.isfinite(theta)
    rows = np.stack([theta + rng.normal(0, 0.1 * DEG, theta.size), P1, P2, T, 0 * T])[:, there]
    held = np.linspace(0, 0.5, 6)
    slack = true.pressure(0.0, GEOMETRY.agonist(held).contraction) + rng.normal(0, 0.02 * BAR, 6)
    sag = np.stack([held, slack, np.full(6, 2 * BAR), np.zeros(6), np.ones(6)])

    def error(table):
        theta, P1, P2, T, which = table
        found = fit_joint(
            theta,
            P1,
            P2,
            geometry=GEOMETRY,
            torque=T,
            friction=False,
            ratio=False,
            zero=0.0,
            slack=which,
            slack_noise=0.02 * BAR,
            leave_one_out=False,
            choices=False,
        )
        at = np.array([-0.2, 0.0, 0.2]), np.full(3, 2 * BAR), np.full(3, 3 * BAR)
        return np.sqrt(np.mean((found.joint.stiffness(*at) / joint.stiffness(*at) - 1) ** 2))

    without, with_sag = error(rows), error(np.concatenate([rows, sag], axis=1))
    assert with_sag < 1.2 * without
