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

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import repeat, starmap
from math import inf, isnan, pi
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import search
from allocator.allocation.arguments import problem_from
from allocator.allocation.result import from_fields, shaped
from allocator.allocation.status import PRIORITIES, Priority
from allocator.allocation.two_muscles import exact
from allocator.allocation.two_muscles.certificate import assess
from allocator.allocation.two_muscles.exact import solve
from allocator.allocation.two_muscles.kernels import kernel, threads
from allocator.allocation.two_muscles.kernels import source as kernels
from allocator.allocation.two_muscles.kernels.choice import JointKernel, Kernel, Kind, arrays, coefficients, kernel_of
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.two_muscles.result import PairAllocation, single
from allocator.calculus import Array, Mask
from allocator.checks import LOOKS_LIKE_BAR, REAL, float_or_nan, one_of, pair_or_nan, real
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import HELD, Shares, StiffnessKind
from allocator.joint.limits import Limit, Limits

_PARALLEL = 500_000  # least number of targets for several threads
_PIECE = 50_000  # targets that a thread takes at a time
_CHUNK = 1 << 14  # affine targets with coefficients in memory at a time, per thread
_OUTSIDE = int(Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD)


class Targets(NamedTuple):
    """n targets with their limits, each array (n,), copied for compiled loops."""

    theta: Array
    K: Array
    T: Array
    limits: Limits
    shape: tuple[int, ...]

    @classmethod
    def of(cls, theta: object, K: object, T: object, limits: Limits) -> Self | None:
        """Return the flat targets; None if some are not real numbers, or none is an array."""
        given = [_array(x) for x in (theta, K, T)]
        slewed = limits.previous is not None or limits.max_step is not None
        if slewed:
            given += _slew(limits)
        arrays = [x for x in given if x is not None]
        if len(arrays) < len(given) or not (shape := _common_shape(arrays)):
            return None
        flat = _flat(arrays, shape)
        if slewed:
            limits = limits._replace(previous=(flat[3], flat[4]), max_step=flat[5])
        return cls(flat[0], flat[1], flat[2], limits, shape) if flat[0].size else None

    def take(self, part: slice) -> Self:
        """Return some of the targets."""
        return self._replace(
            theta=self.theta[part], K=self.K[part], T=self.T[part], limits=self.limits.take(part), shape=()
        )


def _slew(limits: Limits) -> list[Array | None]:
    """Return the slew limit's three arrays, with None among them if they may not be pressures in Pa."""
    found = [_array(x) for x in (*pair_or_nan(limits.previous), limits.max_step)]
    if any(x is None or not x.size or not np.isfinite(x).all() for x in found):
        return [None]
    P1, P2, step = (np.abs(x) if i < 2 else x for i, x in enumerate(found) if x is not None)
    greatest = max(P1.max(), P2.max())
    return found if (greatest == 0 or greatest > LOOKS_LIKE_BAR[1]) and step.min() > LOOKS_LIKE_BAR[1] else [None]


def _common_shape(arrays: list[Array]) -> tuple[int, ...] | None:
    shape = arrays[0].shape
    if all(x.shape == shape for x in arrays):  # NumPy's own check takes longer
        return shape
    try:
        return np.broadcast_shapes(*(x.shape for x in arrays))
    except ValueError:
        return None


def _array(x: Any) -> Array | None:
    """Return `x` as an array of real numbers, or None if it is not one; `_flat` converts to floats."""
    if type(x) in (list, tuple) and REAL.issuperset(map(type, x)):  # no masks or units to check
        x = np.array(x)
    if type(x) is np.ndarray and x.dtype.type in REAL:
        return x
    if not isnan(one := float_or_nan(x)):
        return np.array(one)
    try:
        return real("targets", x, "")
    except InvalidInput:  # `allocator.allocation.arguments` reports the faulty argument
        return None


def _flat(arrays: list[Array], shape: tuple[int, ...]) -> Array:
    """Return copies of the arrays as rows of one block (large pages), since the caller may change the originals."""
    copies = np.empty((len(arrays), *shape))
    for copy, x in zip(copies, arrays, strict=True):
        copy[...] = x
    return copies.reshape(len(arrays), -1)


def run(
    loop: Kernel, kernel: JointKernel, targets: Targets, priority: Priority, shares: Shares | None
) -> tuple[Any, ...] | None:
    """Return (P1, P2, T, K, status, limits, gap), each (n,); None if a target is invalid, or may be in degrees."""
    n, stiffness_first = targets.theta.size, True if priority == "stiffness" else None
    # one block of memory for four arrays: a larger block is more likely to have large pages
    out: tuple[Any, ...] = *np.empty((4, n)), np.empty(n, np.int8), np.empty(n, np.int32), np.empty(n, bool)

    def piece(i: int, j: int) -> tuple[int, int]:
        part, parts = (targets, out) if j - i == n else (targets.take(slice(i, j)), tuple(x[i:j] for x in out))
        theta, K, T, (least, greatest, _, previous, max_step), _ = part
        sides: list[Any] = []
        if kernel.name == "affine":
            inside = np.clip(theta, kernel.left, kernel.right)
            sides = [arrays(c, j - i) for c in coefficients(kernel.joint, inside, shares)]
        limits = least, greatest, *(previous or (None, None)), max_step
        return loop(theta, K, T, *sides, kernel.p, *limits, stiffness_first, parts)  # type: ignore[no-any-return]  # compiled

    counts = _pieces(piece, n, _CHUNK if kernel.name == "affine" else _PIECE)
    if any(strange for strange, _ in counts):
        return None
    gap = np.zeros(n)
    if any(unsure for _, unsure in counts):
        _refer(kernel.joint, targets, priority, shares, ~out[6], out[:6], gap)
    return (*out[:6], gap)


def one_by_one(exact: Kernel) -> Kernel:
    """Return the kernel for arrays that calls `exact` in plain Python, target by target."""

    def batch(*arguments: Any) -> tuple[int, int]:
        *given, out = arguments
        columns = [_column(x) for x in given]
        if strange := sum(map(kernels.odd, *columns[:3])):
            return strange, 0
        answers = starmap(exact, zip(*columns, strict=False))  # the shortest are the targets
        for array, values in zip(out, zip(*answers, strict=True), strict=True):
            array[:] = values
        return 0, int(np.count_nonzero(~out[6]))

    return batch


def _column(x: object) -> Iterable[Any]:
    """Return the values of `x` target by target: numbers of an array, rows of a tuple of arrays, or `x` itself."""
    if isinstance(x, np.ndarray):
        return x.tolist()  # type: ignore[no-any-return]  # a list, as x has one dimension
    if isinstance(x, tuple) and isinstance(x[0], np.ndarray):
        return zip(*(part.tolist() for part in x), strict=True)
    return repeat(x)


def _pieces(work: Callable[[int, int], tuple[int, int]], n: int, size: int) -> list[tuple[int, int]]:
    """Do `work` on 0 … n in pieces; if that pays, several threads take pieces until none are left."""
    starts = iter(range(0, n, size))

    def drain() -> list[tuple[int, int]]:
        return [work(i, min(i + size, n)) for i in starts]

    helpers = threads() - 1 if n >= _PARALLEL else 0
    if helpers < 1:
        return drain()
    with ThreadPoolExecutor(helpers) as pool:
        waiting = [pool.submit(drain) for _ in range(helpers)]
        counts = drain()
        return counts + [count for other in waiting if not other.cancel() for count in other.result()]


def _refer(
    joint: AntagonistJoint,
    targets: Targets,
    priority: Priority,
    shares: Shares | None,
    where: Mask,
    found: tuple[Any, ...],
    gap: Array,
) -> None:
    """Solve the targets for which the kernel is not proved by the readable implementation."""
    problem, _ = problem_from(joint, *targets[:3], limits=targets.limits, priority=priority, shares=shares)
    problem = problem.take(where)
    P1, P2, gap[where] = solve(problem)
    assessed = assess(problem, P1, P2, found[5][where] & _OUTSIDE)
    for array, values in zip(found, (P1, P2, *assessed), strict=True):
        array[where] = values


@cache
def at_once(name: str) -> Callable[..., tuple[int, int]]:
    """Return the NumPy equivalent of `source`'s loop `<name>_batch`, equal digit for digit.

    It is made once, in about 20 ms.
    """
    from allocator.compilation.printer import array_functions

    exact, odd = array_functions(getattr(kernels, f"{name}_exact"), kernels.odd)

    def batch(*arguments: Any) -> tuple[int, int]:
        *given, out = arguments
        with np.errstate(all="ignore"):  # warnings of branches not taken
            if strange := int(np.sum(odd(*given[:3]))):
                return strange, 0
            answers = exact(*given)
        for array, values in zip(out, answers, strict=True):
            array[...] = values
        return 0, int(np.count_nonzero(~out[6]))

    return batch


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
