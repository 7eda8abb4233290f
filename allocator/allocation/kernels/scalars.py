"""What a caller takes for a number, or for a pair of them, is turned into Python's floats here."""

from math import nan
from typing import Any

import numpy as np

REAL = frozenset((int, float, *(np.dtype(code).type for code in np.typecodes["AllInteger"] + np.typecodes["Float"])))
"""The types of real numbers: Python's and NumPy's, truth values not among them."""
_SEQUENCES = frozenset((tuple, list, np.ndarray))


def number(x: Any) -> float:
    """Return `x` as a float where it is one real number of Python's or NumPy's, a 0-d array included; else NaN.

    No range includes NaN, so that whoever looks whether a number lies in its range need not look at its type as well.
    """
    if type(x) is float:
        return x
    kind = type(x)
    if kind in REAL or (kind is np.ndarray and not x.ndim and x.dtype.type in REAL):
        try:
            return float(x)
        except OverflowError:  # an integer of more than 308 digits
            return nan
    return nan


def pair(x: Any) -> tuple[Any, Any]:
    """Return both pressures in a tuple, list or array of two; NaN for what is none."""
    if type(x) is tuple and len(x) == 2:
        return x
    if type(x) not in _SEQUENCES or getattr(x, "shape", None) == (2, 2):  # which are pairs or rows
        return nan, nan
    try:
        P1, P2 = x
    except (TypeError, ValueError):  # of no length, of another length
        return nan, nan
    return P1, P2
