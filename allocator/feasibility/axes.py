"""The axes of a map."""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.setting import Setting

_POINTS = 201
_PADDING = 0.1  # of the range of stiffnesses that exist, shown beyond them
_MOST_STEPS = 10_000_000


def map_axis(name: str, asked: Any, values: Array) -> Array:
    """`values` as an axis: one number, or two or more that increase. `asked` is what the user passed."""
    if values.ndim > 1:
        raise InvalidInput(f"{name} has the shape {values.shape}; an axis of a map is one number or an array (n,)")
    if values.ndim and values.size < 2:
        raise InvalidInput(f"{name} = {asked!r} is an empty range; a map needs two values or more, or one number")
    if values.ndim and (falls := np.nonzero(np.diff(values) <= 0)[0]).size:
        i = int(falls[0])
        raise InvalidInput(f"{name} has to increase, but {name}[{i}] = {values[i]:g} and {name}[{i + 1}] = {values[i + 1]:g}")
    return values


def default_axis(setting: Setting, theta: Array, T: Array) -> Array:
    """Stiffnesses [N·m/rad] from a little below to a little above those that exist at these angles and torques."""
    few = [axis[np.linspace(0, axis.size - 1, min(axis.size, 41)).astype(int)] if axis.ndim else axis for axis in (theta, T)]
    found = setting.columns(few[0][..., None], few[1])
    if not found.exists.any():
        raise InvalidInput("none of these angles and torques exist; there is no stiffness to show")
    low, high = found.K_min[found.exists].min(), found.K_max[found.exists].max()
    padding = _PADDING * (high - low) or _PADDING * high
    return np.linspace(max(low - padding, 0.01 * high), high + padding, _POINTS)


def steps(name: str, low: float, high: float, step: float, unit: str) -> Array:
    """low, low + step, … up to high, or one clear sentence; the three are in `unit`."""
    if not np.isfinite([low, high, step]).all():
        raise InvalidInput(f"{name} from {low:g} to {high:g} in steps of {step:g} {unit}: these have to be finite")
    if step <= 0:
        raise InvalidInput(f"{name}: a step of {step:g} {unit} does not lead from {low:g} to {high:g} {unit}")
    if high == low:
        raise InvalidInput(f"{name} from {low:g} to {high:g} {unit} is an empty range")
    if high < low:
        raise InvalidInput(f"{name}: the bounds {low:g} and {high:g} {unit} are reversed")
    count = (high - low) / step
    if count > _MOST_STEPS:
        raise InvalidInput(f"{name}: {count:.3g} steps of {step:g} {unit} are too many")
    if count < 1 - 1e-9:
        raise InvalidInput(f"{name}: a step of {step:g} {unit} is longer than the range from {low:g} to {high:g} {unit}")
    return low + step * np.arange(int(count + 1e-9) + 1)


__all__ = ["default_axis", "map_axis", "steps"]
