"""Search for arrays of targets: NumPy in, NumPy out.

Compiled code is used where it is there (`ready`), or for so many targets that it pays to make it; else the loops run as
plain Python.
"""

from functools import cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.compilation import jit
from allocator.joint.limits import PressureBox
from allocator.joint.torque_levels import BothMuscles, Pair
from allocator.search import arcs, curves, loops, pairs, stretches
from allocator.search.curves import CHEBYSHEV, K_T
from allocator.search.loops import LOOPS, MOST
from allocator.search.rows import rows

_PAYS = 30_000  # targets that take plain Python as long as a compilation
_PAYS_SERIES = 600  # the same where curves are Chebyshev series, which take some thirty times as long to cut
_ROOM = 2 * MOST + 1  # numbers of a target that has several pairs or intervals

_PRIORITIES = ("torque", "stiffness", "weighted")  # by the number that the loops know them by

_ready: dict[str, jit.Function] = {}


class Curves(NamedTuple):
    """The curves of both muscles at n angles are (n, segments, numbers), and the box is (n, 5) [Pa].

    A box is (lo1, hi1, lo2, hi2, least sum), the last -inf where there is no co-contraction floor.
    """

    one: Array
    two: Array
    box: Array

    @classmethod
    def of(cls, sides: BothMuscles, box: PressureBox, supply: tuple[float, float]) -> Self:
        """Return the curves of both sides in a box.

        Raises InvalidInput for a law that is not smooth between its kinks.
        """
        (lo1, hi1), (lo2, hi2) = ((interval.lo, interval.hi) for interval in box)
        limits = np.stack(np.broadcast_arrays(lo1, hi1, lo2, hi2, box.least_sum), 1)
        lo, hi = supply  # beyond which a slew limit may lead
        ends = min(lo, limits[:, :4].min(initial=lo)), max(hi, limits[:, :4].max(initial=hi))
        one, two = (rows(side, *ends, interval) for side, interval in zip(sides, box, strict=True))
        return cls(one, two, limits)


def optima(
    curves: Curves,
    T: Array,
    K: Array,
    priority: str,
    weights: tuple[float, float] = (1.0, 1.0),
    now: Pair | None = None,
) -> tuple[Array, Array, Array]:
    """Return (P1, P2 [Pa], gap), each (n,), for the priority "torque", "stiffness" or "weighted".

    Of several pairs that are as good it is the least, or the nearest to the pressures `now`. The gap is that of the
    second goal, or of the weighted cost, in its unit.
    """
    near = np.full((T.size, 2), np.nan) if now is None else np.stack(np.broadcast_arrays(*now), 1)
    P1, P2, gap = _run("optima", 3, (T, K, _PRIORITIES.index(priority), weights), curves, (near,)).T
    return P1, P2, gap


def all_pairs(curves: Curves, T: Array, K: Array) -> tuple[NDArray[np.intp], Array]:
    """Return how many pairs of the box give both targets (n,), and which: (n, m, 2) [Pa], NaN where fewer."""
    return _several(_run("pairs", _ROOM, (T, K), curves))


def torque_intervals(curves: Curves, K: Array) -> tuple[NDArray[np.intp], Array]:
    """Return how many intervals the torques at a stiffness form (n,), and their ends (n, m, 2) [N·m], else NaN."""
    return _several(_run("intervals", _ROOM, (K, K_T), curves))


def determinant_signs(curves: Curves) -> Array:
    """Return the sign that det ∂(T, K)/∂(P1, P2) is proved to have all over the box (n,), 0 where it is not."""
    return _run("signs", 1, (), curves)[:, 0]


@cache
def _compiled(name: str) -> jit.Function | None:
    """Return a loop, compiled for each kind of arguments at its first call (some fifteen seconds), or None."""
    callees = (function for file in (curves, stretches, pairs, arcs, loops) for function in file.FUNCTIONS)
    return jit.compiled(LOOPS[name], callees, inline=False, unaliased=False)


def ready(name: str = "optima") -> bool:
    """Return whether a loop is there compiled, or can be: then compile it, or load it, at its first call."""
    if name not in _ready and (function := _compiled(name)) is not None:
        _ready[name] = function
    return name in _ready


def prepare(targets: int) -> None:
    """Compile the search of the optimum, or load it, if it pays for so many targets, in however many calls."""
    if targets >= _PAYS:
        ready()


def _run(name: str, width: int, given: tuple[object, ...], curves: Curves, after: tuple[Array, ...] = ()) -> Array:
    """Return the output (n, width) of a loop."""
    n = len(curves.box)
    out = np.zeros((n, width))
    if not n:
        return out
    if n >= (_PAYS_SERIES if CHEBYSHEV in (curves.one[0, 0, 0], curves.two[0, 0, 0]) else _PAYS):
        ready(name)
    arguments = (*given, *curves, *after)
    if (function := _ready.get(name)) is not None:
        function(*(np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in arguments), out)
        return out
    plain = [[0.0] * width for _ in range(n)]
    LOOPS[name](*(x.tolist() if isinstance(x, np.ndarray) else x for x in arguments), plain)
    return np.array(plain)


def _several(out: Array) -> tuple[NDArray[np.intp], Array]:
    count = out[:, 0].astype(np.intp)
    listed = out[:, 1:].reshape(len(out), MOST, 2)[:, : int(count.max(initial=0))]
    return count, np.where(np.arange(listed.shape[1])[:, None] < count[:, None, None], listed, np.nan)
