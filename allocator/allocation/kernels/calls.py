"""`allocate` by the `kernels`: one target in some microseconds, arrays at the speed of compiled loops.

A short cut for the ordinary question (method "exact", a lexicographic priority, no pull, no co-contraction floor, no
tolerance) about a joint that has a kernel. Whatever looks odd here is answered None: `allocator.allocation.arguments`
then finds out what is wrong with it, if anything, and the readable implementation answers.

Of what type a number is makes no difference: all of them are turned into Python's floats, all arrays into NumPy's.

No call waits for a compiler, however many came before: `warm_up` compiles beforehand. Until then the kernels as plain
Python answer single targets and short arrays, and the readable implementation longer ones. The exception is one array
so large that it pays: 300 000 targets take the readable implementation 0.6 to 1.3 s; compiled code is loaded from disk
in 0.7 s, or made in 3 s, once after installation.
"""

from math import inf, isnan, pi
from typing import Any

import numpy as np

from allocator import search
from allocator.allocation import exact
from allocator.allocation.kernels import source as kernels
from allocator.allocation.kernels.arrays import Targets, one_by_one, run
from allocator.allocation.kernels.choice import Kernel, Kind, Law, coefficients, law_of
from allocator.allocation.kernels.compiled import kernel
from allocator.allocation.kernels.question import Question, number, pair
from allocator.allocation.problem import PRIORITIES, Priority, Problem
from allocator.allocation.result import Allocation, from_fields, shaped
from allocator.allocation.status import Status
from allocator.checks import LOOKS_LIKE_BAR
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint, report_joint

_TURN = 2 * pi
_HUGE = 1e300
_LIKE_BAR = LOOKS_LIKE_BAR[1]
_PAYS = 300_000  # targets in one array that take the readable implementation as long as compiled code takes to load
_FEW = 200  # targets in one array that it takes longer than the kernels in plain Python
_FIRST = {"torque": None, "stiffness": True}  # priority → `stiffness_first` of the kernels
_STATUS = tuple(Status)

_PLAIN: dict[str, Kernel] = {"tondu": kernels.tondu_exact, "affine": kernels.affine_exact}
_LOOPS: dict[str, Kernel] = {name: one_by_one(exact) for name, exact in _PLAIN.items()}

_scalars: dict[Kind, Kernel] = {}  # compiled
_batches: dict[Kind, Kernel] = {}  # compiled


def answer(
    joint: Any, theta: Any, K: Any, T: Any, priority: Any, min_force: Any, max_force: Any, previous: Any, max_step: Any
) -> Allocation | None:
    """The allocation, or None where the short cut does not lead; takes the fields of a `Question`."""
    law = law_of(joint)
    _, name, p, left, right = law
    if not name or type(priority) is not str or priority not in _FIRST:
        return None
    if not (max_force is None and type(min_force) is float and 0 <= min_force < inf):
        if (forces := _forces(min_force, max_force)) is None:
            return None
        min_force, max_force = forces
    kind = name, min_force is not None, max_force is not None, max_step is not None, _FIRST[priority]
    if not (type(theta) is type(K) is type(T) is float and previous is max_step is None):
        if (single := _single(theta, K, T, previous, max_step)) is None:
            return _batch(Question(joint, theta, K, T, priority, min_force, max_force, previous, max_step), law, kind)
        theta, K, T, previous, max_step = single
    if not (-_TURN <= theta <= _TURN and 0 < K < _HUGE and -_HUGE < T < _HUGE):
        return None
    P1_now, P2_now = previous or (None, None)
    exact = _scalars.get(kind) or _PLAIN[name]
    if name == "affine":
        one, two = (tuple(map(float, c)) for c in coefficients(joint, min(max(theta, left), right)))
        found = exact(theta, K, T, one, two, p, min_force, max_force, P1_now, P2_now, max_step, kind[4])
    else:
        found = exact(theta, K, T, p, min_force, max_force, P1_now, P2_now, max_step, kind[4])
    if not found[6]:
        return None
    question = joint, theta, K, T, priority, min_force, max_force, previous, max_step  # a tuple is quicker
    return _allocation(question, theta, K, T, found)


def _single(theta: Any, K: Any, T: Any, previous: Any, max_step: Any) -> tuple[Any, ...] | None:
    """The same in floats, where these are one target and, if any, a slew limit in Pa; else None."""
    theta, K, T = number(theta), number(K), number(T)
    if isnan(theta + K + T):
        return None
    if previous is not None or max_step is not None:
        P1, P2 = pair(previous)
        P1, P2, max_step = number(P1), number(P2), number(max_step)
        previous, total = (P1, P2), abs(P1) + abs(P2)
        if not ((total == 0 or max(abs(P1), abs(P2)) > _LIKE_BAR) and total < inf and _LIKE_BAR < max_step < inf):
            return None
    return theta, K, T, previous, max_step


def _forces(low: Any, high: Any) -> tuple[float | None, float | None] | None:
    """The limits of forces as floats; None where they are none."""
    low, high = (None if F is None else number(F) for F in (low, high))
    fine = (low is None or 0 <= low < _HUGE) and (high is None or (low or 0.0) < high < _HUGE)
    return (low, high) if fine else None


def _allocation(question: tuple[Any, ...], theta: float, K: float, T: float, found: tuple[Any, ...]) -> Allocation:
    P1, P2, T_given, K_given, status, limits, _ = found
    return from_fields(
        {
            "theta": theta,
            "T_target": T,
            "K_target": K,
            "P1": P1,
            "P2": P2,
            "T": T_given,
            "K": K_given,
            "status": _STATUS[status],
            "limits": limits,
            "_gap": 0.0,
            "method": "exact",
            "iterations": None,
            "_source": question,
            "_shape": (),
        }
    )


def _batch(question: Question, law: Law, kind: Kind) -> Allocation | None:
    targets = Targets.of(question.theta, question.K, question.T, question.previous, question.max_step)
    if targets is None or (loop := _loop(kind, targets.theta.size)) is None:
        return None
    question = targets.of_which(question)
    found = run(loop, question, targets, law, kind[4])
    if found is None:
        return None
    fields = ("theta", "T_target", "K_target", "P1", "P2", "T", "K", "status", "limits", "_gap")
    flat = (targets.theta, targets.T, targets.K, *found)
    return from_fields(
        {name: shaped(array, targets.shape) for name, array in zip(fields, flat, strict=True)}
        | {"method": "exact", "iterations": None, "_source": question, "_shape": targets.shape}
    )


def _loop(kind: Kind, n: int) -> Kernel | None:
    """The compiled loop where it is there or pays for `n` targets; else for few of them the one in plain Python."""
    if (compiled := _batches.get(kind)) is not None:
        return compiled
    if n >= _PAYS and (compiled := kernel(f"{kind[0]}_batch")) is not None:
        return _batches.setdefault(kind, compiled)
    return _LOOPS[kind[0]] if n <= _FEW else None


def warm_up(
    *,
    joint: AntagonistJoint | None = None,
    priority: Priority = "torque",
    min_force: float | None = 0.0,
    max_force: float | None = None,
    slew: bool = False,
) -> bool:
    """Compile now what `allocate` needs for questions with these options, so that no call has to wait.

    Takes some seconds the first time after installation (for muscles that are not affine half a minute) and half a
    second in a new process, most of it the import of numba. `slew` is for calls with `previous` and `max_step`. False
    where nothing can be compiled: there is nothing for weighted targets of affine muscles, or numba is missing or finds
    no directory to keep what it compiles. `allocate` works then too, more slowly.
    By itself it compiles only for an array of 300 000 targets or more.
    Raises InvalidInput for a priority that there is not, or a limit that is none.
    """
    joint = report_joint() if joint is None else joint
    law = law_of(joint)
    if priority not in PRIORITIES or _forces(min_force, max_force) is None:
        raise InvalidInput(f"there are no questions with {priority=}, {min_force=} N, {max_force=} N")
    if not law.name or priority not in _FIRST:
        return not joint.affine and _search_ready(joint)
    kind = law.name, min_force is not None, max_force is not None, slew, _FIRST[priority]
    one, many = kernel(f"{law.name}_exact"), kernel(f"{law.name}_batch")
    if one is None or many is None:
        return False
    _scalars[kind], _batches[kind] = one, many
    theta = sum(joint.angle_range) / 2
    slew_limit = ((2e5, 2e5), 1e5) if slew else (None, None)
    for angle in (theta, np.full(2, theta)):
        answer(joint, angle, 1.0, 0.0, priority, min_force, max_force, *slew_limit)
    return True


def _search_ready(joint: AntagonistJoint) -> bool:
    """Compile the search of the optimum now, or load it; False where that cannot be done."""
    if not search.ready():
        return False
    zero = np.zeros(1)
    exact.solve(Problem(joint, zero + sum(joint.angle_range) / 2, zero + 1, zero))
    return True


__all__ = ["answer", "warm_up"]
