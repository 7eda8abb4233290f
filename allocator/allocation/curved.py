"""Problems of any two muscles on any geometry, in rows of numbers, through the loops of the search.

Compiled code is used where it is there (`allocator.warm_up`), or for so many targets that it pays to make it; else the
loops run as plain Python.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.compiled import kernel
from allocator.allocation.curve_rows import rows
from allocator.allocation.loops import LOOPS, MOST
from allocator.allocation.problem import PRIORITIES, Problem
from allocator.calculus import Array
from allocator.joint import AntagonistJoint
from allocator.levels import Pair

_PAYS = 30_000  # targets that take plain Python as long as a compilation
_ROOM = 2 * MOST + 1  # numbers of a target that has several pairs or intervals
_FAR = 1e3  # times all that there is: what is nearest to that is the extreme

_compiled: dict[str, Callable[..., Any]] = {}


class Curves(NamedTuple):
    """The curves of both muscles at n angles, (n, segments, numbers), and the box (n, 5) [Pa].

    A box is (lo1, hi1, lo2, hi2, least sum), the last -inf where there is no co-contraction floor.
    """

    one: Array
    two: Array
    box: Array

    @classmethod
    def of(cls, problem: Problem) -> Self:
        """Those of a problem. Raises InvalidInput for a law that is not smooth between its kinks."""
        agonist, antagonist = problem.box
        limits = agonist.lo, agonist.hi, antagonist.lo, antagonist.hi, problem.box.least_sum
        box = np.stack(np.broadcast_arrays(*limits), 1)
        lo, hi = problem.joint.pressure_limits  # beyond which a slew limit may lead
        ends = min(lo, box[:, :4].min(initial=lo)), max(hi, box[:, :4].max(initial=hi))
        one, two = (rows(side, *ends) for side in problem.sides)
        return cls(one, two, box)


def optimum(problem: Problem) -> tuple[Array, Array, Array]:
    """(P1, P2 [Pa], gap), each (n,); the gap is that of the second goal, or of the weighted cost, in its unit."""
    now = np.full((problem.theta.size, 2), np.nan)
    if problem.P1_now is not None and problem.P2_now is not None:
        now[:, 0], now[:, 1] = problem.P1_now, problem.P2_now
    order, weights = PRIORITIES.index(problem.priority), tuple(map(float, problem.weights))
    given = problem.T_aim, problem.K_aim, order, weights
    P1, P2, gap = _run("optima", 3, given, Curves.of(problem), (now,)).T
    return P1, P2, gap


def all_pairs(problem: Problem, T: Array, K: Array) -> tuple[NDArray[np.intp], Array]:
    """How many pairs of pressures of the box give both targets (n,), and which: (n, m, 2) [Pa], NaN where fewer."""
    return _several(_run("pairs", _ROOM, (T, K), Curves.of(problem)))


def torque_intervals(problem: Problem, K: Array) -> tuple[NDArray[np.intp], Array]:
    """How many intervals the torques at a stiffness form (n,), and their ends: (n, m, 2) [N·m], NaN where fewer."""
    return _several(_run("intervals", _ROOM, (K, True), Curves.of(problem)))


def stiffness_extremes(problem: Problem, T: Array) -> tuple[Pair, Pair]:
    """The pressures of the least and of the greatest stiffness at a torque, each (P1, P2) of (n,) [Pa]."""
    curves, now = Curves.of(problem), np.full((T.size, 2), np.nan)
    far = _FAR * problem.scales[1]
    least, greatest = (_run("optima", 3, (T, K, 0, (1.0, 1.0)), curves, (now,)).T for K in (-far, far))
    return (least[0], least[1]), (greatest[0], greatest[1])


def determinant_signs(problem: Problem) -> Array:
    """The sign that det ∂(T, K)/∂(P1, P2) is proved to have all over the box (n,), 0 where it is not."""
    return _run("signs", 1, (), Curves.of(problem))[:, 0]


def ready(joint: AntagonistJoint) -> bool:
    """Compile the search of the optimum now, or load it; False where that cannot be done."""
    if not _made("optima"):
        return False
    none = np.zeros(1)
    optimum(Problem(joint, none + sum(joint.angle_range) / 2, none + 1, none))
    return True


def _made(name: str) -> bool:
    """Whether a loop is there, compiled; each kind of arguments at its first call."""
    if name not in _compiled and (function := kernel(name)) is not None:
        _compiled[name] = function
    return name in _compiled


def _run(name: str, width: int, given: tuple[Any, ...], curves: Curves, after: tuple[Array, ...] = ()) -> Array:
    """The output (n, width) of a loop."""
    n = len(curves.box)
    if n >= _PAYS:
        _made(name)
    out = np.zeros((n, width))
    if not n:
        return out
    if (function := _compiled.get(name)) is not None:
        function(*(np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in (*given, *curves, *after)), out)
        return out
    plain = [[0.0] * width for _ in range(n)]
    LOOPS[name](*(x.tolist() if isinstance(x, np.ndarray) else x for x in (*given, *curves, *after)), plain)
    out[:] = plain
    return out


def _several(out: Array) -> tuple[NDArray[np.intp], Array]:
    count = out[:, 0].astype(np.intp)
    listed = out[:, 1:].reshape(len(out), MOST, 2)[:, : int(count.max(initial=0))]
    return count, np.where(np.arange(listed.shape[1])[:, None] < count[:, None, None], listed, np.nan)


__all__ = ["all_pairs", "determinant_signs", "optimum", "ready", "stiffness_extremes", "torque_intervals"]
