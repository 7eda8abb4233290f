"""Machines of n joints and m muscles for controllers and observers: `Plant` (n = 1, m = 2) or `Arm`.

The state is x = (q [rad], ω [rad/s], P [Pa]) ∈ R^(2n+m). Angles, torques and stiffness of a joint are numbers, those of
an arm rows (n,) and matrices (k, k); along a motion they have one row or matrix per sample.
"""

from typing import TypeAlias

from allocator import checks
from allocator.errors import InvalidInput
from mpc.model.arm.model import Arm
from mpc.model.plant import Plant

Machine: TypeAlias = Plant | Arm

_SHORTEST = 1e-5  # sample time [s]


def check_machine(plant: object) -> None:
    """Raise `InvalidInput` unless `plant` is a `Machine`."""
    checks.instance("plant", plant, Machine, "a Plant or an Arm; the model of a RealPlant is its nominal")


def sample_time(dt: object) -> float:
    """Return a checked sample time `dt` [s]. Raises `InvalidInput`."""
    found = checks.number("dt", dt, "s")
    if not _SHORTEST <= found < 1:
        raise InvalidInput(f"dt = {found:g} s has to be a sample time from {_SHORTEST:g} s to below 1 s")
    return found
