"""Gravity of a link: one law, with its slope, and the equilibrium that balances it."""

import numpy as np
import pytest

from allocator.errors import InvalidFile, InvalidInput
from allocator.files.toml import Table
from allocator.joint.antagonist import report_joint
from allocator.joint.gravity import Gravity
from allocator.units import BAR


def test_its_stiffness_is_the_slope_of_its_moment():
    gravity, theta, h = Gravity(1.7, 0.4), np.linspace(-2, 2, 9), 1e-6
    slope = (gravity.moment(theta + h) - gravity.moment(theta - h)) / (2 * h)
    np.testing.assert_allclose(gravity.stiffness(theta), slope, atol=1e-8)
    assert gravity.moment(0.4) == 0


def test_two_parts_are_an_amplitude_and_an_angle():
    theta = np.linspace(-1, 1, 5)
    np.testing.assert_allclose(Gravity.of_parts(-1.0, 2.0).moment(theta), -np.sin(theta) - 2.0 * np.cos(theta))
    assert Gravity.of_parts(0.0, 0.0) == Gravity()


def test_it_is_printed_with_the_angle_at_which_it_hangs():
    assert (str(Gravity(2.0)), str(Gravity(2.0, 0.2))) == ("2 N·m", "2 N·m of a link that hangs at 11.5°")


def test_muscles_balance_it_at_the_equilibrium():
    joint, gravity = report_joint(), Gravity(2.0, -0.5)
    P1, P2 = np.array([2.0, 3.0]) * BAR, np.array([3.0, 2.5]) * BAR
    theta = joint.equilibrium(P1, P2, 0.3, gravity=gravity)
    np.testing.assert_allclose(joint.torque(theta, P1, P2), 0.3 + gravity.moment(theta), atol=1e-8)
    with pytest.raises(InvalidInput, match="history"):
        joint.equilibrium(P1, P2, history=([], []), gravity=gravity)


def test_a_wrong_number_in_a_file_is_refused():
    with pytest.raises(InvalidFile, match=r"\[plant\]: gravity_torque"):
        Gravity.of_file(Table.parsed("joint.toml", '[plant]\ngravity_torque = "heavy"'))
