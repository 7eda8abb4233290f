"""Machines of n joints and m muscles for controllers and observers: `Plant` (n = 1, m = 2) or `Arm`.

The state is x = (q [rad], ω [rad/s], P [Pa]) ∈ R^(2n+m). Angles, torques and stiffness of a joint are numbers, those of
an arm rows (n,) and matrices (k, k); along a motion they have one row or matrix per sample.
"""

from typing import TypeAlias

from mpc.model.arm.model import Arm
from mpc.model.plant import Plant

Machine: TypeAlias = Plant | Arm
