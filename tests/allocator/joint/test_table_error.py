"""Tables state their own error, and refuse what they cannot draw."""

import numpy as np
import pytest

from allocator.errors import InvalidInput
from allocator.joint.geometry import Lever, Table
from allocator.mechanism.routes import Tables

LEVER = Lever(0.25, anchor=0.1655, lever=0.0509, offset=0.051)


def lever_table(n, span=1.0):
    angles = np.linspace(-span, span, n)
    return Table(0.25, angles, LEVER.agonist(angles).contraction, LEVER.antagonist(angles).contraction)


def lifted(n, jump=0.03, at=0.213):
    """A cable on a pulley of 20 mm that leaves it at an angle: its bend jumps there, as of any post or stop."""
    q = np.linspace(-1, 1, n)
    return q, 0.3 - (0.02 * q + np.where(q > at, jump * (q - at) ** 2 / 2, 0.0))


@pytest.mark.parametrize("n", [9, 13, 19])
def test_the_stated_error_of_a_smooth_table_bounds_the_true_one(n):
    table, fine = lever_table(n), np.linspace(-1, 1, 3001)
    for which, route in enumerate((table.agonist, table.antagonist)):
        true = (LEVER.agonist, LEVER.antagonist)[which](fine)
        found = route(fine)
        assert table.error.length[which] > 0.25 * np.abs(found.contraction - true.contraction).max()
        assert table.error.arm[which] >= np.abs(found.arm - true.arm).max()
        assert table.error.bend[which] >= np.abs(found.arm_slope - true.arm_slope).max()


def test_the_error_falls_as_samples_are_added():
    coarse, fine = lever_table(13).error, lever_table(25).error
    assert (fine.length < coarse.length / 6).all()
    assert (fine.bend < coarse.bend / 2).all()
    assert "bend" in str(fine)


@pytest.mark.parametrize("n", [11, 41, 161])
def test_a_cable_that_lifts_off_is_refused_however_fine_the_table(n):
    """The bend of the spline rings by half of the jump; at 800 N that would be 12 N·m/rad."""
    q, length = lifted(n)
    with pytest.raises(InvalidInput, match=r"muscle 1 .*bend .*lifts off"):
        Tables(0.3, [q], length[:, None])
    rising = (0.3 - length) / 0.3
    with pytest.raises(InvalidInput, match="lifts off"):
        Table(0.3, q, 0.1 + rising, 0.1 - q * 0.02 / 0.3)


def test_the_refusal_names_the_muscle_and_the_posture():
    q, length = lifted(41)
    both = np.stack([0.3 + 0.02 * q, length], axis=1)
    with pytest.raises(InvalidInput, match=r"muscle 2 .* near 0\.2"):
        Tables(0.3, [q], both)


def test_noise_of_a_hundredth_of_a_millimetre_is_too_much_for_samples_three_degrees_apart():
    q = np.linspace(-0.8, 0.8, 33)
    noisy = 0.3 - 0.03 * q + np.random.default_rng(0).normal(0, 1e-5, q.size)
    with pytest.raises(InvalidInput, match="noisy"):
        Tables(0.3, [q], noisy[:, None])


def test_tables_over_two_joints_state_the_error_of_each_muscle():
    grid = np.linspace(-1.2, 1.2, 25), np.linspace(-1.0, 1.0, 21)
    a, b = np.meshgrid(*grid, indexing="ij")
    tables = Tables(0.4, grid, np.stack([0.35 - 0.02 * a + 0.01 * a * b, 0.3 + 0.03 * np.sin(b)], -1))
    assert tables.error.bend[0] < 1e-9  # a polynomial that a cubic spline draws exactly
    q = np.random.default_rng(1).uniform(-1, 1, (200, 2))
    true = 0.03 * np.sin(q[:, 1])  # l'' = -0.03 sin b
    assert 0 < np.abs(tables.at(q).bend[:, 1, 1, 1] + true).max() <= tables.error.bend[1]
    assert tables.error.posture.shape == (2, 2)


def test_few_samples_are_taken_as_they_are():
    assert lever_table(5).error.bend.max() > 1e-3
    q = np.linspace(-1, 1, 4)
    assert Tables(0.3, [q], (0.3 - 0.02 * q)[:, None]).error.bend.max() < 1e-9
