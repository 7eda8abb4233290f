"""The axes of a map are checked here, or chosen."""

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.setting import Setting
from allocator.joint.torque_levels import torque_interval

_POINTS = 201
_PADDING = 0.1  # of the range of stiffnesses that exist, shown beyond them
_MOST_STEPS = 10_000_000
_NARROWEST = 1e-6  # range of an axis, in the unit of its user


def map_axis(name: str, asked: object, values: Array) -> Array:
    """Return `values` as an axis: one number, or two or more that increase. `asked` is what the user passed."""
    if values.ndim > 1:
        raise InvalidInput(f"{name} has the shape {values.shape}; an axis of a map is one number or an array (n,)")
    if values.ndim and values.size < 2:
        raise InvalidInput(f"{name} = {asked!r} is an empty range; a map needs two values or more, or one number")
    if values.ndim and (falls := np.nonzero(np.diff(values) <= 0)[0]).size:
        i = int(falls[0])
        raise InvalidInput(
            f"{name} has to increase, but {name}[{i}] = {values[i]:g} and {name}[{i + 1}] = {values[i + 1]:g}"
        )
    return values


def default_torques(setting: Setting, theta: Array) -> Array:
    """Return torques [N·m] from a little below to a little above those that exist at these angles."""
    problem, _ = setting.problem(_few(theta))
    T_min, T_max = torque_interval(problem.sides, problem.box)
    return _around(T_min[~problem.box.empty], T_max[~problem.box.empty])


def default_stiffnesses(setting: Setting, theta: Array, T: Array) -> Array:
    """Return stiffnesses [N·m/rad] from a little below to a little above those that exist at angles and torques."""
    found = setting.columns(_few(theta)[..., None], _few(T))
    axis = _around(found.K_min[found.exists], found.K_max[found.exists])
    return axis[axis > 0]


def _few(axis: Array) -> Array:
    """Return about 41 of the values of an axis, its ends among them."""
    return axis[np.linspace(0, axis.size - 1, min(axis.size, 41)).astype(int)] if axis.ndim else axis


def _around(low: Array, high: Array) -> Array:
    if not low.size:
        raise InvalidInput("none of these angles and torques exist; there is nothing to show")
    padding = _PADDING * (high.max() - low.min()) or _PADDING * abs(high.max())
    return np.linspace(low.min() - padding, high.max() + padding, _POINTS)


def steps(name: str, low: float, high: float, step: float, unit: str) -> Array:
    """Return low, low + step, … up to high, or one clear sentence; the three are in `unit`."""
    if not np.isfinite([low, high, step]).all():
        raise InvalidInput(f"{name} from {low:g} to {high:g} in steps of {step:g} {unit}: these have to be finite")
    if step <= 0:
        raise InvalidInput(f"{name}: a step of {step:g} {unit} does not lead from {low:g} to {high:g} {unit}")
    if high == low:
        raise InvalidInput(f"{name} from {low:g} to {high:g} {unit} is an empty range")
    if 0 < high - low < _NARROWEST:
        raise InvalidInput(f"{name} from {low:g} to {high:g} {unit} is too narrow a range to be shown")
    if high < low:
        raise InvalidInput(f"{name}: the bounds {low:g} and {high:g} {unit} are reversed")
    count = (high - low) / step
    if count > _MOST_STEPS:
        raise InvalidInput(f"{name}: {count:.3g} steps of {step:g} {unit} are too many")
    if count < 1 - 1e-9:
        raise InvalidInput(
            f"{name}: a step of {step:g} {unit} is longer than the range from {low:g} to {high:g} {unit}"
        )
    return np.asarray(low + step * np.arange(int(count + 1e-9) + 1), np.float64)
