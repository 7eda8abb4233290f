"""Targets of a mechanism with affine muscles, solved by compiled code in about ten microseconds each.

It is a fast path for up to 2048 ordinary problems (method "exact", a lexicographic priority, the isobaric stiffness of
the joints, numbers as force limits) after `warm_up(joint=mechanism)`. It returns None for all other problems and
possibly invalid arguments, which the readable implementation then handles. CasADi evaluates the mechanism at the
postures, `kernel/target.py` does the rest. Fields of the answer are computed on first access.
"""

from functools import cache
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.kernel.data import flat_arrays
from allocator.allocation.box.kernel.target import FUNCTIONS, answer, answers
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.result import BoxAllocation
from allocator.allocation.result import as_status, from_fields, shaped
from allocator.allocation.status import Status
from allocator.calculus import Array
from allocator.checks import float_or_nan
from allocator.compilation import beside, jit
from allocator.errors import InvalidInput
from allocator.joint.limits import BINDS, TAUT, Limits
from allocator.mechanism.formulas import has_formulas, map_function
from allocator.mechanism.mechanism import Mechanism

_FIRST = {"torque": False, "stiffness": True}  # priority → whether stiffness comes first
_KINDS = "iuf"  # of NumPy's real numbers
_REMEMBERED = 64  # mechanisms
MOST = 2048  # targets of a call; for more the vectorised mechanism is as fast
_SIZES = 8  # numbers of targets with arrays to reuse

_ready: dict[int, "Machine"] = {}  # by the mechanism's id; the value holds the mechanism, so the id stays in use


class Desk:
    """Arrays for one call with N targets at a time: arguments, the mechanism at the postures, memory and results."""

    def __init__(self, mechanism: Mechanism, function: Any, N: int) -> None:
        n, m = mechanism.n, mechanism.m
        d = n + n * (n + 1) // 2
        self.asked, postures = np.zeros((N, _length(n, m))), np.zeros((N, 3 * m + d + d * m))
        self.q, self.T, K = self.asked[:, :n], self.asked[:, n : 2 * n], self.asked[:, 2 * n : 2 * n + n * n]
        self.K, self.diagonal = K.reshape(N, n, n), K[:, :: n + 1]
        self.now, self.ends = self.asked[:, 2 * n + n * n : -3], self.asked[:, -3:]
        floats, places, signs = flat_arrays(d, m, 2)
        self.found = np.zeros((N, m + d + 1 + 3 * d + 4))
        self.memory = (
            postures,
            np.empty(floats.size + d * m + 2 * d + 4 * m + n * n),
            np.empty(places.size + 2, np.int64),
            np.empty(signs.size + 2 * (m + d) + d, np.int8),
        )
        self.taut = False  # whether the limits written last are `TAUT`
        self._buffer, self.evaluate = (function if N == 1 else function.map(N)).buffer()
        self._buffer.set_arg(0, memoryview(self.asked))  # type: ignore[arg-type]  # Python 3.11 has no Buffer
        self._buffer.set_res(0, memoryview(postures))  # type: ignore[arg-type]


def _length(n: int, m: int) -> int:
    """Return the length of the arguments of a target."""
    return 2 * n + n * n + m + 3


class Machine:
    """Mechanism with its compiled formulas, numbers and arrays."""

    def __init__(self, mechanism: Mechanism, compiled: jit.Function) -> None:
        import casadi as ca

        self.mechanism, self.compiled, self.n, self.m = mechanism, compiled, mechanism.n, mechanism.m
        n = self.n
        low, high = mechanism.pressure_limits
        limits = mechanism.angle_limits
        left, right = np.full((2, n), [[-inf], [inf]]) if limits is None else np.transpose(limits)
        rows, columns = mechanism.upper_triangle
        roots = np.concatenate([np.ones(n), np.where(rows == columns, 1.0, np.sqrt(2.0))])
        most = [min(high, muscle.max_pressure) for muscle in mechanism.muscles]
        numbers = low, high, BINDS * mechanism.pressure_span, mechanism.min_contraction
        self.fixed = np.concatenate([left, right, most, roots, numbers])
        asked = ca.SX.sym("asked", _length(n, self.m))
        q = asked[:n]
        inside = q if limits is None else ca.fmin(ca.fmax(q, left), right)
        self._function = ca.Function("posture", [asked], [ca.densify(ca.vertcat(*map_function(mechanism)(inside)))])
        self._desks: dict[int, list[Desk]] = {}  # by N

    def ask(self, theta: object, K: object, T: object, priority: object, limits: Limits) -> BoxAllocation | None:
        """Return the answer, or None outside the fast path."""
        n, m, q, K, T = self.n, self.m, _array(theta), _array(K), _array(T)
        if q is None or K is None or T is None or not 0 < q.size <= MOST * n or q.shape[-1:] != (n,):
            return None
        lead, stiffness_first = q.shape[:-1], _FIRST.get(priority) if type(priority) is str else None
        diagonal = K.shape != (n, n) and K.shape != (*lead, n, n)
        if diagonal and not (K.ndim == 0 or K.shape == (n,) or (K.shape == (*lead, n) and K.shape[-2:] != (n, n))):
            return None
        if stiffness_first is None or not (T.ndim == 0 or T.shape == (n,) or T.shape == (*lead, n)):
            return None
        desk = self._desk(q.size // n)
        if (nearest := _set(desk, limits, lead)) is None:
            return None
        desk.q[:], desk.T[:] = q if not lead else q.reshape(-1, n), T if T.ndim < 2 else T.reshape(-1, n)
        if diagonal:
            desk.diagonal[:] = K if K.ndim < 2 else K.reshape(-1, n)
        else:
            desk.K[:] = K if K.ndim < 3 else K.reshape(-1, n, n)
        desk.evaluate()
        arrays = desk.asked, self.fixed, *desk.memory, desk.found
        if not self.compiled(*arrays, n, m, diagonal, stiffness_first, nearest):
            return None
        found = desk.found.copy()
        given = desk.asked.copy(), found, lead, stiffness_first, diagonal, nearest
        later = Later(self.mechanism, *given)
        self._desks.setdefault(len(found), []).append(desk)
        P = found[:, :m].reshape((*lead, m))
        P.flags.writeable = False
        made: BoxAllocation = from_fields(BoxAllocation, {"P": P, "method": "exact", "_shape": lead, "_later": later})
        return made

    def _desk(self, N: int) -> Desk:
        """Return arrays for N targets that no other thread uses."""
        if ready := self._desks.get(N):
            return ready.pop()
        if len(self._desks) >= _SIZES:
            self._desks.clear()
        return Desk(self.mechanism, self._function, N)


def _array(x: Any) -> Array | None:
    """Return `x` as an array of real numbers, or None if it is not one."""
    if type(x) is not np.ndarray:
        try:
            x = np.asarray(x)
        except ValueError:  # rows of different lengths
            return None
    return x if x.dtype.kind in _KINDS else None


def _set(desk: Desk, limits: Limits, lead: tuple[int, ...]) -> bool | None:
    """Write the limits to the desk; return whether the present pressures count, None if the limits may be invalid."""
    if limits is TAUT and desk.taut:
        return False
    least, greatest, floor, previous, step = limits
    if floor is not None or (step is not None and previous is None):
        return None
    low = -inf if least is None else float_or_nan(least)
    high = inf if greatest is None else float_or_nan(greatest)
    farthest = inf if step is None else float_or_nan(step)
    if not (low == -inf or 0 <= low < inf) or not (high > 0 and high > low) or not farthest > 0:
        return None
    desk.ends[:] = low, high, farthest
    desk.taut = limits is TAUT
    if previous is None:
        return False
    now = _array(previous)
    m = desk.now.shape[1]
    if now is None or (now.shape != (m,) and now.shape != (*lead, m)):
        return None
    desk.now[:] = now if now.ndim < 2 else now.reshape(-1, m)
    return True


class Later(NamedTuple):
    """Results of a compiled answer, from which the fields of a `BoxAllocation` are computed on first access."""

    mechanism: Mechanism
    asked: Array  # (N, …) in the layout of `kernel/target.py`, as the next one
    found: Array
    shape: tuple[int, ...]
    stiffness_first: bool
    diagonal: bool
    nearest: bool

    def field(self, name: str, allocation: BoxAllocation) -> Any:
        """Return the field `name` of the allocation."""
        n, m, N = self.mechanism.n, self.mechanism.m, len(self.found)
        d = n + n * (n + 1) // 2
        status, rounds, missed, holds = self.found[:, -4:].T
        match name:
            case "_problem":
                return self._problem(n)
            case "_mu":
                rows = allocation._problem.rows[0]
                if self.stiffness_first:
                    rows = np.where(rows < n, rows + d - n, rows - n)
                return self.found[:, -3 * d - 4 : -4].reshape(N, 3, d)[:, :, rows]
            case "lower_bounds":
                P = allocation.P.reshape(N, m)
                return shaped(allocation._problem.costs(P / allocation._problem.unit), self.shape)
            case "status":
                return as_status(status.astype(np.int8), self.shape)
            case "T":
                made: Any = self.found[:, m : m + n]
            case "K":
                made = self.mechanism.whole(self.found[:, m + n : m + d])
            case "kkt_residual":
                made = self.found[:, m + d]
            case "torque_met":
                made = missed.astype(np.int8) & Status.TORQUE_LIMITED == 0
            case "stiffness_met":
                made = missed.astype(np.int8) & Status.STIFFNESS_LIMITED == 0
            case "gap":
                made = np.zeros(N)
            case "holds":
                made = holds == 1
            case _:
                made = rounds.astype(np.int64)
        return shaped(made, self.shape)

    def _problem(self, n: int) -> BoxProblem:
        """Return the problem in readable form."""
        q, T = self.asked[:, :n], self.asked[:, n : 2 * n]
        K = self.asked[:, 2 * n : 2 * n + n * n].reshape(-1, n, n)
        least, greatest, step = (None if np.isinf(end) else float(end) for end in self.asked[0, -3:])
        now = self.asked[:, 2 * n + n * n : -3] if self.nearest else None
        limits = Limits(least, greatest, previous=now, max_step=step)
        return problem_from(
            self.mechanism,
            q,
            np.diagonal(K, axis1=1, axis2=2) if self.diagonal else K,
            T,
            limits=limits,
            priority="stiffness" if self.stiffness_first else "torque",
        )[0]


def answered(
    mechanism: Mechanism, theta: object, K: object, T: object, priority: object, limits: Limits
) -> BoxAllocation | None:
    """Return the answer of a mechanism that is ready, or None outside the fast path."""
    machine = _ready.get(id(mechanism))
    return None if machine is None else machine.ask(theta, K, T, priority, limits)


def warm_up(mechanism: Mechanism) -> bool:
    """Compile the code for single targets of a mechanism; return False if it has no formulas or cannot be compiled."""
    if id(mechanism) in _ready:
        return True
    compiled = _compiled()
    if compiled is None or not mechanism.affine or not has_formulas(mechanism.routes):
        return False
    try:
        made = Machine(mechanism, compiled)
    except InvalidInput:  # a muscle law that does not accept symbols
        return False
    if len(_ready) >= _REMEMBERED:
        _ready.clear()
    middle = np.zeros(mechanism.n) if mechanism.angle_limits is None else np.mean(mechanism.angle_limits, axis=1)
    made.ask(middle, np.ones(mechanism.n), np.zeros(mechanism.n), "torque", Limits())
    _ready[id(mechanism)] = made
    return True


def begin_warm_up(mechanism: Mechanism) -> None:
    """Begin to compile in another process if no code is cached, so that this one can do other work before `warm_up`."""
    try:
        with beside.only_kept():
            warm_up(mechanism)
    except beside.NotKept:
        made: Any = _compiled()
        beside.begin("ready", Path(made._cache.cache_path), warm_up, mechanism)


@cache
def _compiled() -> jit.Function | None:  # not inlined: compiles in two thirds of the time, and takes 3 % longer
    return jit.compiled(answers, (answer, *FUNCTIONS), inline=False, unaliased=True)
