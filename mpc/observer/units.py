"""Units of readings: pressures that look like bar and angles that look like degrees are pointed out, once.

They are not refused, because the pressures of a vented joint are as low, and a control loop goes on with any numbers.
A joint that starts without pressure does not show its unit, so that readings are checked until one does.
"""

import warnings
from math import isfinite, tau

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput

_NONE = np.empty(0)
_DEGREES = 720.0  # greatest angle [°] of a joint; greater numbers are no readings at all


class BadNumbers(UserWarning):
    """Warning of implausible references, torques or readings. For the first two the controller holds the pressures."""


def units_shown(name: str, pressures: Array, angles: Array = _NONE, stacklevel: int = 3) -> bool:
    """Return whether the `pressures` [Pa] in `name` show their unit, which those of a vented joint do not.

    Warns (`BadNumbers`) of pressures that look like bar and of `angles` [rad] that look like degrees; NaN passes.
    `stacklevel` as in `warnings.warn`, from the function that calls this one.
    """
    low, high = checks.LOOKS_LIKE_BAR
    greatest = max([abs(P) for P in pressures.tolist() if isfinite(P)], default=0.0)
    turned = np.array([theta for theta in angles.tolist() if tau < abs(theta) <= _DEGREES])
    if not (low <= greatest <= high or turned.size):
        return greatest > high
    try:
        checks.angle(f"angles of {name}: θ", turned)
        checks.pressure(f"pressures of {name}: P", pressures[np.isfinite(pressures)])
    except InvalidInput as wrong:
        warnings.warn(str(wrong), BadNumbers, stacklevel=stacklevel + 1)
    return True
