"""Golden section for many functions at once, and the changes of sampled functions."""

import numpy as np
from scipy.ndimage import maximum_filter1d

GOLDEN = (np.sqrt(5) - 1) / 2
STEPS = 18  # the bracket shrinks to 2e-4, and the function's change in it to 1e-8


def golden_section(function, low, high):
    """Return all trial points (s, c) of the functions, the ends first; `function` takes (c,) and is called s times.

    The least value among them is that of a minimum, up to the second order of STEPS.
    """
    tried = [low, high, high - GOLDEN * (high - low), low + GOLDEN * (high - low)]
    values = [function(x) for x in tried]
    points, values = tried[2:], values[2:]
    for _ in range(STEPS):
        left = values[0] < values[1]
        low, high = np.where(left, low, points[0]), np.where(left, points[1], high)
        new = np.where(left, high - GOLDEN * (high - low), low + GOLDEN * (high - low))
        value = function(new)
        tried.append(new)
        points = [np.where(left, new, points[1]), np.where(left, points[0], new)]
        values = [np.where(left, value, values[1]), np.where(left, values[0], value)]
    return np.stack(tried)


def change(samples):
    """Return the greatest change (r, n - 1) between neighbours in rows of samples, in and near every cell, without NaN.

    Near means four cells, because cells at special points have no width.
    """
    steps = np.nan_to_num(np.abs(np.diff(samples, axis=1)), posinf=0.0)
    return maximum_filter1d(steps, size=9, axis=1)


def pick(array, index):
    """Return array[index[i], i] of every column i."""
    return np.take_along_axis(array, index[None], 0)[0]
