"""Feasibility maps: the answers of `allocate`, cell by cell, over any two or three of (θ, K, T)."""

from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks, search
from allocator.allocation import allocate
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.feasibility.result import FeasibilityMap
from allocator.feasibility.setting import Setting
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.joint.limits import TAUT, Limits
from allocator.joint.torque_levels import torque_interval

_CELL_BYTES = 8 + 8 + 1 + 4  # P1, P2, status, limits
_WORK_BYTES = 400  # per cell while its chunk is computed
_CHUNK_CELLS = 200_000  # fits caches, and updates a progress bar often enough
_SLOW_CHUNK_CELLS = 10_000  # without a closed form
_POINTS = 201
_PADDING = 0.1  # of the range of feasible stiffnesses, shown beyond them
_MOST_STEPS = 10_000_000
_NARROWEST = 1e-6  # range of an axis, in the unit of its user

Progress: TypeAlias = Callable[[Sequence[int]], Iterable[int]]


def feasibility_map(
    theta: ArrayLike | None = None,
    K: ArrayLike | None = None,
    T: ArrayLike | None = 0.0,
    *,
    joint: AntagonistJoint | None = None,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    gravity: Gravity = NO_GRAVITY,
    max_bytes: float = 1e9,
    progress: Progress = iter,
) -> FeasibilityMap:
    """Map the feasible combinations of angles, stiffnesses and torques, and the limits that exclude the others.

    Parameters
    ----------
    theta, K, T
        Joint angles [rad], stiffnesses [N·m/rad] and torques [N·m]: two or three of them increasing arrays (n,), the
        third a number. None: 201 angles over the joint range, 201 torques or stiffnesses around the feasible ones.
    joint, limits, stiffness
        As in `allocator.allocate`, without a slew limit and a tolerance.
    gravity
        Gravity of the link, which the muscles balance besides the torques T.
    max_bytes
        A map that would need more memory [bytes] than this is refused.
    progress
        Wrapper of the iteration over the chunks, e.g. `tqdm.tqdm` or `rich.progress.track`.

    Returns
    -------
    FeasibilityMap
        Status, limits and pressures of `allocate` in every cell, the edges as curves, `to_csv`, `to_npz` and `plot`.

    Raises
    ------
    InvalidInput
        For an empty or falling range, fewer than two arrays, more memory than allowed, and whatever `allocate` refuses.
    """
    setting = Setting.of(joint, limits, stiffness, gravity)
    theta_axis = _angles(setting, theta)
    T_axis = default_torques(setting, theta_axis) if T is None else map_axis("T", T, checks.real("T", T, "N·m"))
    if K is None:
        K_axis = default_stiffnesses(setting, theta_axis, T_axis)
    else:
        K_axis = map_axis("K", K, checks.stiffness("K", K))
    axes = {"theta": theta_axis, "K": K_axis, "T": T_axis}
    if sum(axis.ndim for axis in axes.values()) < 2:
        raise InvalidInput("a map needs arrays for two or three of theta, K and T; the others are held at one number")
    _check_memory(axes, max_bytes)
    cells = _cells(setting, np.atleast_1d(theta_axis), np.atleast_1d(K_axis), np.atleast_1d(T_axis), progress)
    shape = tuple(axis.size for axis in axes.values() if axis.ndim)
    return FeasibilityMap(setting, theta_axis, K_axis, T_axis, *(array.reshape(shape) for array in cells))


def _angles(setting: Setting, theta: ArrayLike | None) -> Array:
    if theta is None:
        return np.linspace(*setting.joint.angle_range, 201)
    return map_axis("theta", theta, checks.angle("theta", theta))


def _check_memory(axes: dict[str, Array], max_bytes: float) -> None:
    cells = int(np.prod([float(axis.size) for axis in axes.values()]))
    needed = cells * _CELL_BYTES + min(cells, _CHUNK_CELLS) * _WORK_BYTES
    if needed > max_bytes:
        shape = " × ".join(f"{axis.size} {name}" for name, axis in axes.items() if axis.ndim)
        raise InvalidInput(
            f"a map of {shape} needs {needed / 1e9:.3g} GB, max_bytes = {max_bytes / 1e9:.3g} GB; "
            "take fewer points or raise max_bytes"
        )


def _cells(setting: Setting, theta: Array, K: Array, T: Array, progress: Progress) -> list[NDArray[Any]]:
    """Return status, limits, P1, P2 and the state of free valves in all cells, chunk after chunk of angles."""
    shape, joint, free = (theta.size, K.size, T.size), setting.joint, len(setting.states) > 1
    out = [np.empty(shape, kind) for kind in (np.int8, np.int32, float, float, *([np.int8] if free else []))]
    closed = joint.affine or (joint.tondu_pulley is not None and setting.kind.isobaric)
    step = max(1, (_CHUNK_CELLS if closed else _SLOW_CHUNK_CELLS) // (K.size * T.size))
    asked: dict[str, Any] = {"joint": joint, "limits": setting.limits, "stiffness": Stiffness(setting.kind)}
    for start in progress(range(0, theta.size, step)):
        if start == 0 and not closed:  # so that progress is visible
            search.prepare(int(np.prod(shape)) * len(setting.states))
        part = slice(start, start + step)
        at = theta[part, None, None]
        a = allocate(at, K[:, None], T + setting.gravity.moment(at), **asked)
        answers = a.status, a.limits, a.P1, a.P2, *((2 * a.valves[0] + a.valves[1],) if free else ())
        for target, array in zip(out, answers, strict=True):
            target[part] = array
    return out


def map_axis(name: str, asked: object, values: Array) -> Array:
    """Return `values` as an axis: one number, or two or more that increase. `asked` is the user's argument."""
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
    """Return torques [N·m] from slightly below to slightly above the feasible ones at these angles."""
    few = _few(theta)
    problem, _ = setting.problem(few)
    T_min, T_max = (end - setting.gravity.moment(few) for end in torque_interval(problem.sides, problem.box))
    return _around(T_min[~problem.box.empty], T_max[~problem.box.empty])


def default_stiffnesses(setting: Setting, theta: Array, T: Array) -> Array:
    """Return stiffnesses [N·m/rad] from slightly below to slightly above the feasible ones at angles and torques."""
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
    """Return low, low + step, … up to high, all in `unit`. Raises `InvalidInput`."""
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
