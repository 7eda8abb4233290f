"""Kernels for arrays of targets, with bounded memory and several threads for many targets."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from itertools import repeat, starmap
from math import isnan
from typing import Any, NamedTuple, Self

import numpy as np

from allocator.allocation.arguments import problem_from
from allocator.allocation.status import Priority
from allocator.allocation.two_muscles.certificate import assess
from allocator.allocation.two_muscles.exact import solve
from allocator.allocation.two_muscles.kernels import source as kernels
from allocator.allocation.two_muscles.kernels import threads
from allocator.allocation.two_muscles.kernels.choice import JointKernel, Kernel, arrays, coefficients
from allocator.calculus import Array, Mask
from allocator.checks import LOOKS_LIKE_BAR, REAL, float_or_nan, pair_or_nan, real
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import Shares
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
    from allocator.compilation.printer import Source, array_functions

    exact, odd = array_functions(Source.of(kernels), f"{name}_exact", "odd")

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
