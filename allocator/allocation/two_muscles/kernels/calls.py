"""Kernels behind `allocate`: one target in a few microseconds, arrays at the speed of compiled loops.

They are a fast path for the ordinary problem (method "exact", a lexicographic priority, no pull, no co-contraction
floor, no tolerance) of a joint that has a kernel. For all other problems and possibly invalid arguments the answer is
None: `allocator.allocation.arguments` then checks the arguments, and the readable implementation solves the problem.

Number types make no difference: all scalars become Python floats, all arrays NumPy arrays.

No call waits for a compiler: `warm_up` compiles beforehand. Until then the kernels solve single targets and short
arrays as plain Python, and longer arrays as NumPy operations, at about 0.2 µs per target. The exception is an array so
large that compiled code pays: it is loaded from disk in 0.7 s, or compiled in 3 s once after installation, and saves
0.05 s per 300 000 targets.
"""

from math import inf, isnan, pi
from typing import Any

import numpy as np

from allocator import search
from allocator.allocation.result import from_fields, shaped
from allocator.allocation.status import PRIORITIES, Priority
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.kernels import kernel
from allocator.allocation.two_muscles.kernels import source as kernels
from allocator.allocation.two_muscles.kernels.arrays import Targets, at_once, one_by_one, run
from allocator.allocation.two_muscles.kernels.choice import JointKernel, Kernel, Kind, coefficients, kernel_of
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.two_muscles.result import PairAllocation, single
from allocator.checks import LOOKS_LIKE_BAR, float_or_nan, one_of, pair_or_nan
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import HELD, StiffnessKind
from allocator.joint.limits import Limits

_TURN = 2 * pi
_HUGE = 1e300
_LIKE_BAR = LOOKS_LIKE_BAR[1]
_PAYS = 300_000  # targets in one array for which compiled code, once loaded, saves about 0.05 s over NumPy
_FEW = 200  # targets in one array that plain Python solves before the NumPy form is made
_FIRST: dict[str, bool | None] = {"torque": None, "stiffness": True}  # priority → `stiffness_first` of the kernels

_PLAIN: dict[str, Kernel] = {"tondu": kernels.tondu_exact, "affine": kernels.affine_exact}
_LOOPS: dict[str, Kernel] = {name: one_by_one(exact) for name, exact in _PLAIN.items()}

_scalars: dict[Kind, Kernel] = {}  # compiled
_batches: dict[Kind, Kernel] = {}  # compiled


def answer(
    joint: Any, theta: Any, K: Any, T: Any, priority: Any, limits: Limits, kind: StiffnessKind = HELD
) -> PairAllocation | None:
    """Return the allocation, or None outside the fast path; arguments as of `allocate`."""
    chosen = kernel_of(joint)
    _, name, p, left, right = chosen
    min_force, max_force, floor, previous, max_step = limits
    first = _FIRST.get(priority, False) if type(priority) is str else False
    if not name or first is False or floor is not None:
        return None
    if kind is not HELD and (name != "affine" or kind.shares is None or kind.amplitude is not None):
        return None
    if not (max_force is None and type(min_force) is float and 0 <= min_force < inf):
        if (checked := _forces(limits)) is None:
            return None
        limits = checked
        min_force, max_force = limits.min_force, limits.max_force
    key = name, min_force is not None, max_force is not None, max_step is not None, first
    if not (type(theta) is type(K) is type(T) is float and previous is max_step is None):
        if (target := _in_floats(theta, K, T, limits)) is None:
            return _batch(chosen, theta, K, T, priority, limits, key, kind)
        theta, K, T, limits = target
        previous, max_step = limits.previous, limits.max_step
    if not (-_TURN <= theta <= _TURN and 0 < K < _HUGE and -_HUGE < T < _HUGE):
        return None
    P1_now, P2_now = previous or (None, None)
    exact = _scalars.get(key) or _PLAIN[name]
    if name == "affine":
        shares = None if kind is HELD else kind.fixed
        one, two = (tuple(map(float, c)) for c in coefficients(joint, min(max(theta, left), right), shares))
        found = exact(theta, K, T, one, two, p, min_force, max_force, P1_now, P2_now, max_step, first)
    else:
        found = exact(theta, K, T, p, min_force, max_force, P1_now, P2_now, max_step, first)
    return single(joint, priority, limits, theta, K, T, found, kind) if found[6] else None


def _in_floats(theta: object, K: object, T: object, limits: Limits) -> tuple[float, float, float, Limits] | None:
    """Return the target as floats, or None if it is not one target or its slew limit may not be in Pa."""
    if not type(theta) is type(K) is type(T) is float:
        theta, K, T = float_or_nan(theta), float_or_nan(K), float_or_nan(T)
        if isnan(theta + K + T):
            return None
    min_force, max_force, _, previous, max_step = limits
    if previous is max_step is None:
        return theta, K, T, limits
    P1, P2 = now = pair_or_nan(previous)
    if not type(P1) is type(P2) is type(max_step) is float:
        now, max_step = (float_or_nan(P1), float_or_nan(P2)), float_or_nan(max_step)
    P1, P2 = abs(now[0]), abs(now[1])
    if not (P1 + P2 == 0 or P1 > _LIKE_BAR or P2 > _LIKE_BAR) or not (P1 + P2 < inf and _LIKE_BAR < max_step < inf):
        return None
    same = now is previous and max_step is limits.max_step
    return theta, K, T, limits if same else Limits(min_force, max_force, None, now, max_step)


def _forces(limits: Limits) -> Limits | None:
    """Return the limits with force limits as floats, or None if they are not numbers."""
    low, high = limits.min_force, limits.max_force
    low, high = low if low is None else float_or_nan(low), high if high is None else float_or_nan(high)
    if not ((low is None or 0 <= low < _HUGE) and (high is None or (low or 0.0) < high < _HUGE)):
        return None
    same = low is limits.min_force and high is limits.max_force
    return limits if same else limits._replace(min_force=low, max_force=high)


def _batch(
    chosen: JointKernel, theta: Any, K: object, T: object, priority: Any, limits: Limits, key: Kind, kind: StiffnessKind
) -> PairAllocation | None:
    targets = Targets.of(theta, K, T, limits)
    if targets is None:
        return None
    found = run(_loop(key, targets.theta.size), chosen, targets, priority, kind.fixed)
    if found is None:
        return None
    fields = ("theta", "T_target", "K_target", "P1", "P2", "T", "K", "status", "limits", "_gap")
    flat = (targets.theta, targets.T, targets.K, *found)
    asked = {"joint": chosen.joint, "priority": priority, "_within": targets.limits, "kind": kind}
    asked["_shape"] = targets.shape
    given = {name: shaped(array, targets.shape) for name, array in zip(fields, flat, strict=True)}
    allocation: PairAllocation = from_fields(PairAllocation, given | asked)
    return allocation


def _loop(kind: Kind, n: int) -> Kernel:
    """Return the compiled loop if it is ready or pays for `n` targets; else plain Python for a few, or NumPy."""
    if (compiled := _batches.get(kind)) is not None:
        return compiled
    if n >= _PAYS and (compiled := kernel(f"{kind[0]}_batch")) is not None:
        return _batches.setdefault(kind, compiled)
    return _LOOPS[kind[0]] if n <= _FEW else at_once(kind[0])


def warm_up(joint: AntagonistJoint, priority: Priority, limits: Limits, slew: bool, gas: bool) -> bool:
    """Compile the code for these options, as `allocator.allocation.warm_up` says."""
    min_force, max_force = limits.min_force, limits.max_force
    chosen = kernel_of(joint)
    one_of("priority", priority, PRIORITIES)
    if _forces(limits) is None:
        raise InvalidInput(f"there are no questions with {min_force=} N, {max_force=} N")
    if not chosen.name or priority not in _FIRST or (gas and chosen.name != "affine"):
        return not joint.affine and _search_ready(joint)
    kind = chosen.name, min_force is not None, max_force is not None, slew, _FIRST[priority]
    one, many = kernel(f"{chosen.name}_exact"), kernel(f"{chosen.name}_batch")
    if one is None or many is None:
        return False
    _scalars[kind], _batches[kind] = one, many
    theta = sum(joint.angle_range) / 2
    if slew:
        limits = limits._replace(previous=(2e5, 2e5), max_step=1e5)
    for angle in (theta, np.full(2, theta)):
        answer(joint, angle, 1.0, 0.0, priority, limits)
    return True


def _search_ready(joint: AntagonistJoint) -> bool:
    """Compile or load the search of the optimum now; return False if it cannot be compiled."""
    if not search.ready():
        return False
    zero = np.zeros(1)
    exact.solve(Problem(joint, zero + sum(joint.angle_range) / 2, zero + 1, zero))
    return True
