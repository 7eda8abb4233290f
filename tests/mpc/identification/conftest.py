"""Logs of joints whose truth is known, and plants fitted to them."""

import pytest

from allocator import fit_motion

from ...rigs.moving_joint import JOINT, slow_joint, swinging_joint


@pytest.fixture(scope="session")
def slow_fit(slow_joint):
    """The fit of the joint without noticeable inertia."""
    return fit_motion(*slow_joint.rows, joint=JOINT)


__all__ = ["slow_fit", "slow_joint", "swinging_joint"]
