"""Feasibility maps: the answers of `allocate`, cell by cell, over any two or three of (θ, K, T).

A map consists of columns (θ, T): the ends of the stiffness interval decide for every K of the column whether it is
feasible, and which limits bind if it is not. Only feasible cells need the inverse: along the level of affine muscles
the pressures are linear in K, two equal Tondu2021 on a pulley have a closed form, others require root finding.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks, search
from allocator.allocation import Status, allocate
from allocator.allocation.status import CLOSED_FORM
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.certificate import assess
from allocator.calculus import Array, Mask
from allocator.closed_form import solve_inverse
from allocator.errors import InvalidInput
from allocator.feasibility.result import FeasibilityMap
from allocator.feasibility.setting import Columns, Setting, columns
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.joint.torque_levels import Pair, torque_interval

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
    max_bytes
        A map that would need more memory [bytes] than this is refused.
    progress
        Wrapper of the iteration over the chunks, e.g. `tqdm.tqdm` or `rich.progress.track`.

    Returns
    -------
    FeasibilityMap
        Status, limits and pressures of `allocate` in every cell (equal up to 1e-9 of the supply range), the edges as
        curves, `to_csv`, `to_npz` and `plot`.

    Raises
    ------
    InvalidInput
        For an empty or falling range, fewer than two arrays, more memory than allowed, and whatever `allocate` refuses.
    """
    setting = Setting.of(joint, limits, stiffness)
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
    return FeasibilityMap(setting, theta_axis, K_axis, T_axis, *(array.reshape(shape) for array in cells.arrays))


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


class Cells(NamedTuple):
    """Answers in (θ, K, T) cells."""

    status: NDArray[np.int8]
    limits: NDArray[np.int32]
    P1: Array  # [Pa]
    P2: Array  # [Pa]
    state: NDArray[np.int8] | None = None  # of free valves: 1 antagonist shut, 2 agonist, 3 both

    @property
    def arrays(self) -> tuple[NDArray[Any], ...]:
        """Status, limits, P1, P2 and the state of free valves."""
        return tuple(array for array in self if array is not None)

    def formed(self, function: Callable[[NDArray[Any]], NDArray[Any]]) -> "Cells":
        """Return a copy with `function` applied to every array."""
        return Cells(*map(function, self.arrays))


def _cells(setting: Setting, theta: Array, K: Array, T: Array, progress: Progress) -> Cells:
    """Return all cells, chunk after chunk of angles."""
    shape = theta.size, K.size, T.size
    out = _nothing(shape, setting)
    closed = setting.joint.affine or (setting.joint.tondu_pulley is not None and setting.kind.isobaric)
    step = max(1, (_CHUNK_CELLS if closed else _SLOW_CHUNK_CELLS) // (K.size * T.size))
    for start in progress(range(0, theta.size, step)):
        if start == 0 and not closed:  # so that progress is visible
            search.prepare(theta.size * K.size * T.size * len(setting.states))
        part = slice(start, start + step)
        for target, array in zip(out.arrays, _chunk(setting, theta[part], K, T).arrays, strict=True):
            target[part] = array
    return out


def _chunk(setting: Setting, theta: Array, K: Array, T: Array) -> Cells:
    """Return the cells (θ, K, T) of some angles."""
    problem, asked = setting.problem(theta[:, None], T[None, :])
    if len(setting.states) > 1:
        cells = _nothing((problem.T.size, K.size), setting)
        _answered(setting, cells, np.ones(problem.T.shape, bool), asked.ravel(), problem.T, K)
        return cells.formed(lambda array: array.reshape(theta.size, T.size, K.size).swapaxes(1, 2))
    signs = exact.determinant_signs(setting.problem(theta)[0])
    found = columns(problem, np.repeat(signs, T.size))
    cells = _filled(setting, found, asked.ravel(), K)  # (columns, K)
    curved = not setting.joint.affine or problem.felt is not None  # along a torque level K is not linear
    if (several := (found.signs == 0) & curved).any():
        _answered(setting, cells, several, asked.ravel(), problem.T, K)
    return cells.formed(lambda array: array.reshape(theta.size, T.size, K.size).swapaxes(1, 2))


def _nothing(shape: tuple[int, ...], setting: Setting) -> Cells:
    """Return empty cells."""
    empty = np.empty(shape, np.int8), np.empty(shape, np.int32), np.empty(shape), np.empty(shape)
    return Cells(*empty, np.empty(shape, np.int8) if len(setting.states) > 1 else None)


def _filled(setting: Setting, found: Columns, asked: Array, K: Array) -> Cells:
    """Return the cells (n, K.size) of n columns: its ends below and above a column, the inverse between them."""
    outside = setting.joint.outside_range(asked)
    low, high = (assess(found.problem, *pair, outside) for pair in (found.low, found.high))
    tolerance = CLOSED_FORM.met * found.problem.scales[1][:, None]
    K_min, K_max = found.K_min[:, None], found.K_max[:, None]
    below, above = K <= K_min + tolerance, K >= K_max - tolerance
    missed = (K < K_min - tolerance) | (K > K_max + tolerance)
    overruled = low.status > Status.BOTH_LIMITED  # the joint range or the box leaves no choice
    status = np.where(overruled, low.status, low.status & Status.TORQUE_LIMITED)[:, None] + np.where(
        overruled[:, None], 0, missed * np.int8(Status.STIFFNESS_LIMITED)
    )
    P1, P2 = (np.where(below, lo[:, None], hi[:, None]) for lo, hi in zip(found.low, found.high, strict=True))
    between = ~(below | above)
    if between.any():
        P1[between], P2[between] = _inverse(found, K, *np.nonzero(between))
    limits = np.where(below, low.limits[:, None], np.where(above, high.limits[:, None], outside[:, None]))
    return Cells(status.astype(np.int8), limits.astype(np.int32), P1, P2)


def _inverse(found: Columns, K: Array, column: NDArray[np.intp], row: NDArray[np.intp]) -> Pair:
    """Return the pressures of cells between the ends of their columns."""
    if found.problem.joint.affine and found.problem.felt is None:  # the level is a straight line, and K linear along it
        share = (K[row] - found.K_min[column]) / (found.K_max - found.K_min)[column]
        P1, P2 = (lo[column] + share * (hi - lo)[column] for lo, hi in zip(found.low, found.high, strict=True))
        return P1, P2
    problem = replace(found.problem.take(column), K=K[row])
    if problem.tondu_pulley:
        return solve_inverse(problem.joint, problem.theta, problem.K, problem.T)
    P1, P2, _ = exact.solve(problem)
    return P1, P2


def _answered(setting: Setting, cells: Cells, where: Mask, theta: Array, T: Array, K: Array) -> None:
    """Solve columns that may have several pairs per cell by `allocate` itself."""
    asked: dict[str, Any] = {"joint": setting.joint, "limits": setting.limits, "stiffness": Stiffness(setting.kind)}
    a = allocate(theta[where, None], K, T[where, None], **asked)
    found = a.status, a.limits, a.P1, a.P2, *((2 * a.valves[0] + a.valves[1],) if len(setting.states) > 1 else ())
    for target, array in zip(cells.arrays, found, strict=True):
        target[where] = array


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
    problem, _ = setting.problem(_few(theta))
    T_min, T_max = torque_interval(problem.sides, problem.box)
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
