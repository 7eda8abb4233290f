"""A table is judged by what its samples leave open of the stiffness."""

import numpy as np
import pytest

from allocator import AntagonistJoint, load_machine, named_muscle
from allocator.errors import InvalidFile
from allocator.joint.geometry import Lever, Table
from allocator.machine_file import save_machine
from allocator.mechanism import Mechanism
from allocator.mechanism.routes import Tables
from allocator.rough_tables import ROUGH, RoughTable, doubt
from allocator.units import BAR

MUSCLE = named_muscle("sarosi-dmsp-20-400n")
LEVER = Lever(0.25, anchor=0.1655, lever=0.0509, offset=0.051)
ANGLES = np.linspace(-0.96, 0.96, 11)


def _table(step):
    """A cam of 21 mm whose lengths are read in steps [m]; 0: exactly."""
    shortened = 0.021 * ANGLES + 0.0025 * ANGLES**2 - 0.002 * ANGLES**3
    lengths = [0.27 - shortened, 0.27 - shortened[::-1]]
    rounded = [np.round(x / step) * step if step else x for x in lengths]
    return Table(0.3, ANGLES, *(1 - x / 0.3 for x in rounded))


def _joint(geometry):
    return AntagonistJoint(geometry, MUSCLE, MUSCLE)


@pytest.mark.parametrize("n", [9, 13, 25])
def test_a_smooth_table_is_not_doubted(n):
    theta = np.linspace(-1, 1, n)
    table = Table(0.25, theta, LEVER.agonist(theta).contraction, LEVER.antagonist(theta).contraction)
    at, P = np.linspace(-0.9, 0.9, 9), 2.5 * BAR
    true = np.abs(_joint(table).stiffness(at, P, P) / _joint(LEVER).stiffness(at, P, P) - 1).max()
    assert true < doubt(_joint(table)) < ROUGH


def test_rounded_lengths_are_doubted_as_much_as_the_stiffness_errs():
    at, P = np.linspace(-0.7, 0.7, 41), 2.5 * BAR
    true = _joint(_table(0)).stiffness(at, P, P)
    for step in (2e-5, 5e-5):
        error = np.abs(_joint(_table(step)).stiffness(at, P, P) / true - 1)
        assert error.max() / 3 < doubt(_joint(_table(step))) < 3 * error.max()


def test_a_file_with_a_rough_table_is_warned_of_or_refused(tmp_path):
    path = tmp_path / "joint.toml"
    save_machine(_joint(_table(6e-5)), path)
    with pytest.raises(InvalidFile, match=r"\[routes\]: the table leaves the stiffness uncertain by \d+ %"):
        load_machine(path)
    save_machine(_joint(_table(5e-5)), path)
    with pytest.warns(RoughTable, match="smooth them"):
        load_machine(path)
    save_machine(_joint(_table(0)), path)
    load_machine(path)


def test_tables_of_a_mechanism_are_judged_alike():
    q = np.linspace(-0.96, 0.96, 11)
    exact = np.stack([0.27 - 0.021 * q - 0.002 * q**2, 0.27 + 0.021 * q - 0.002 * q**2], axis=-1)
    smooth, rounded = (Mechanism(Tables(0.3, [q], x), (MUSCLE, MUSCLE)) for x in (exact, np.round(exact / 5e-5) * 5e-5))
    assert doubt(smooth) < 1e-6
    assert doubt(rounded) > ROUGH
