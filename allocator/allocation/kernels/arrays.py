"""Arrays of targets through a kernel: memory bounded, in several threads where there are many."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from itertools import repeat, starmap
from math import isnan
from typing import Any, NamedTuple, Self

import numpy as np

from allocator.allocation.assessment import assess
from allocator.allocation.exact import solve
from allocator.allocation.kernels import source as kernels
from allocator.allocation.kernels.choice import Kernel, Law, arrays, coefficients
from allocator.allocation.kernels.compiled import threads
from allocator.allocation.kernels.question import REAL, Question, number, pair
from allocator.calculus import Array, Mask
from allocator.checks import LOOKS_LIKE_BAR, real
from allocator.errors import InvalidInput
from allocator.joint.limits import Limit

_PARALLEL = 500_000  # targets from which on threads are started
_PIECE = 50_000  # targets that a thread takes at a time
_CHUNK = 1 << 14  # affine targets whose coefficients are in memory at a time, a thread
_OUTSIDE = int(Limit.JOINT_RANGE | Limit.CONTRACTION_THRESHOLD)


class Targets(NamedTuple):
    """n targets, each array (n,), copied, in the form that compiled loops take."""

    theta: Array
    K: Array
    T: Array
    P1_now: Array | None
    P2_now: Array | None
    max_step: Array | None
    shape: tuple[int, ...]

    @classmethod
    def of(cls, theta: Any, K: Any, T: Any, previous: Any, max_step: Any) -> Self | None:
        """The targets in their common shape; None where some are no real numbers, or none of them is an array."""
        given = [_array(x) for x in (theta, K, T)]
        if previous is not None or max_step is not None:
            given += _slew(previous, max_step)
        arrays = [x for x in given if x is not None]
        if len(arrays) < len(given) or not (shape := _common_shape(arrays)):
            return None
        flat = [_flat(x, shape) for x in arrays]
        P1_now, P2_now, step = flat[3:] or (None, None, None)
        return cls(flat[0], flat[1], flat[2], P1_now, P2_now, step, shape) if flat[0].size else None

    def of_which(self, question: Question) -> Question:
        """`question` about these targets, whatever becomes of the arrays it was asked with."""
        previous = None if self.P1_now is None else (self.P1_now, self.P2_now)
        return question._replace(theta=self.theta, K=self.K, T=self.T, previous=previous, max_step=self.max_step)


def _slew(previous: Any, max_step: Any) -> list[Array | None]:
    """The slew limit's three arrays; None among them where they are not certainly pressures in Pa."""
    found = [_array(x) for x in (*pair(previous), max_step)]
    if any(x is None or not x.size or not np.isfinite(x).all() for x in found):
        return [None]
    P1, P2, step = (np.abs(x) if i < 2 else x for i, x in enumerate(found) if x is not None)
    greatest = max(P1.max(), P2.max())
    return found if (greatest == 0 or greatest > LOOKS_LIKE_BAR[1]) and step.min() > LOOKS_LIKE_BAR[1] else [None]


def _common_shape(arrays: list[Array]) -> tuple[int, ...] | None:
    shape = arrays[0].shape
    if all(x.shape == shape for x in arrays):  # NumPy takes longer to see it
        return shape
    try:
        return np.broadcast_shapes(*(x.shape for x in arrays))
    except ValueError:
        return None


def _array(x: Any) -> Array | None:
    """`x` as an array of real numbers, None where it is none; the copy that `_flat` makes turns them into floats."""
    if type(x) in (list, tuple) and REAL.issuperset(map(type, x)):  # no masks and units to look for
        x = np.array(x)
    if type(x) is np.ndarray and x.dtype.type in REAL:
        return x
    if not isnan(one := number(x)):
        return np.array(one)
    try:
        return real("targets", x, "")
    except InvalidInput:  # `allocator.allocation.arguments` says what is wrong, and with which argument
        return None


def _flat(x: Array, shape: tuple[int, ...]) -> Array:
    copy = np.empty(shape)  # the caller may change his own
    copy[...] = x
    return copy.ravel()


def run(
    kernel: Kernel, question: Question, targets: Targets, law: Law, stiffness_first: bool | None
) -> tuple[Any, ...] | None:
    """(P1, P2, T, K, status, limits, gap), each (n,); None where a target is odd: not a target at all, or degrees."""
    n = targets.theta.size
    # one block of memory for four arrays: the larger, the sooner it comes in large pages
    out: tuple[Any, ...] = *np.empty((4, n)), np.empty(n, np.int8), np.empty(n, np.int32), np.empty(n, bool)
    forces = tuple(None if F is None else float(F) for F in (question.min_force, question.max_force))

    def piece(i: int, j: int) -> tuple[int, int]:
        parts = out if j - i == n else tuple(x[i:j] for x in out)
        given: list[Any] = [x if x is None or j - i == n else x[i:j] for x in targets[:6]]
        sides: list[Any] = []
        if law.name == "affine":
            sides = [arrays(c, j - i) for c in coefficients(law.joint, np.clip(given[0], law.left, law.right))]
        return kernel(*given[:3], *sides, law.p, *forces, *given[3:], stiffness_first, parts)  # type: ignore[no-any-return]  # compiled

    counts = _pieces(piece, n, _CHUNK if law.name == "affine" else _PIECE)
    if any(strange for strange, _ in counts):
        return None
    gap = np.zeros(n)
    if any(unsure for _, unsure in counts):
        _refer(question, ~out[6], out[:6], gap)
    return (*out[:6], gap)


def one_by_one(exact: Kernel) -> Kernel:
    """The kernel for arrays that calls `exact`, in plain Python, for one target after the other."""

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


def _column(x: Any) -> Iterable[Any]:
    """What `x` is for one target after the other: an array's numbers, the rows of a tuple of arrays, or itself."""
    if isinstance(x, np.ndarray):
        return x.tolist()  # type: ignore[no-any-return]  # a list, as x has one dimension
    if isinstance(x, tuple) and isinstance(x[0], np.ndarray):
        return zip(*(part.tolist() for part in x), strict=True)
    return repeat(x)


def _pieces(work: Callable[[int, int], tuple[int, int]], n: int, size: int) -> list[tuple[int, int]]:
    """`work` on all of 0 … n in pieces; where it pays other threads help, taking pieces as long as there are any."""
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


def _refer(question: Question, where: Mask, found: tuple[Any, ...], gap: Array) -> None:
    """Let the readable implementation answer the targets for which a kernel is not proved."""
    problem = question.problem().take(where)
    P1, P2, gap[where] = solve(problem)
    assessed = assess(problem, P1, P2, found[5][where] & _OUTSIDE)
    for array, values in zip(found, (P1, P2, *assessed), strict=True):
        array[where] = values


__all__ = ["Targets", "one_by_one", "run"]
