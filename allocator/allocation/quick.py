"""`allocate` by the `kernels`: one target in some microseconds, arrays at the speed of compiled loops.

A short cut for the ordinary question (method "exact", a lexicographic priority, no pull, no co-contraction floor, no
tolerance) about a joint that has a kernel. Whatever looks odd here is answered None: `allocator.allocation.arguments`
then finds out what is wrong with it, if anything, and the readable implementation answers.

Nothing is compiled for a few targets. Single ones are answered by the kernels as plain Python, arrays by the readable
implementation until so many targets have come that a compilation (a second or two, then kept on disk) would have paid;
`warm_up` compiles at once.
"""

from collections import Counter
from collections.abc import Iterable
from math import inf, pi
from typing import Any

import numpy as np

from allocator.allocation import kernels
from allocator.allocation.batch import Targets, run
from allocator.allocation.compiled import kernel
from allocator.allocation.laws import Kernel, Kind, Law, coefficients, law_of
from allocator.allocation.problem import PRIORITIES, Priority
from allocator.allocation.question import Question
from allocator.allocation.result import Allocation, from_fields, shaped
from allocator.allocation.status import Status
from allocator.checks import LOOKS_LIKE_BAR
from allocator.errors import InvalidInput
from allocator.joint import AntagonistJoint, report_joint

_TURN = 2 * pi
_HUGE = 1e300
_LIKE_BAR = LOOKS_LIKE_BAR[1]
_PAYS = 100_000  # targets in arrays that take the readable implementation about as long as a compilation
_FIRST = {"torque": None, "stiffness": True}  # priority → `stiffness_first` of the kernels
_STATUS = tuple(Status)

_PLAIN: dict[str, Kernel] = {"tondu": kernels.tondu_exact, "affine": kernels.affine_exact}

_scalars: dict[Kind, Kernel] = {}  # compiled
_batches: dict[Kind, Kernel] = {}  # compiled
_came: Counter[Kind] = Counter()  # targets in arrays that were not answered by compiled code


def answer(question: tuple[Any, ...]) -> Allocation | None:
    """The allocation, or None where the short cut does not lead; takes the fields of a `Question`."""
    joint, theta, K, T, priority, min_force, max_force, previous, max_step = question
    law = law_of(joint)
    if not law.name or type(priority) is not str or priority not in _FIRST:
        return None
    if not (max_force is None and type(min_force) is float and 0 <= min_force < inf):
        if not _fine(min_force, max_force):
            return None
        min_force, max_force = (None if F is None else float(F) for F in (min_force, max_force))
    kind = law.name, min_force is not None, max_force is not None, max_step is not None, _FIRST[priority]
    if not type(theta) is type(K) is type(T) is float:
        if not (type(theta) in _NUMBERS and type(K) in _NUMBERS and type(T) in _NUMBERS):
            return _batch(Question(*question), law, kind)
        theta, K, T = (_HUGE if abs(x) > _HUGE else float(x) for x in (theta, K, T))
    if not (-_TURN <= theta <= _TURN and 0 < K < _HUGE and -_HUGE < T < _HUGE):
        return None
    P1_now = P2_now = None
    if previous is not None or max_step is not None:
        if not _slew_fine(previous, max_step):
            return None
        P1_now, P2_now, max_step = float(previous[0]), float(previous[1]), float(max_step)
    exact = _scalars.get(kind) or _PLAIN[law.name]
    sides: Iterable[Any] = ()
    if law.name == "affine":
        sides = (tuple(map(float, c)) for c in coefficients(joint, min(max(theta, law.left), law.right)))
    found = exact(theta, K, T, *sides, law.p, min_force, max_force, P1_now, P2_now, max_step, kind[4])
    return _allocation(question, theta, K, T, found) if found[6] else None


_NUMBERS = frozenset((float, np.float64, int))


def _fine(low: Any, high: Any) -> bool:
    """Whether these are limits of forces, as plain numbers."""
    if low is not None and not (type(low) in _NUMBERS and 0 <= low < _HUGE):
        return False
    return high is None or (type(high) in _NUMBERS and (low or 0.0) < high < _HUGE)


def _slew_fine(previous: Any, max_step: Any) -> bool:
    """Whether the slew limit consists of plain numbers that are pressures in Pa."""
    if type(previous) is not tuple or len(previous) != 2 or type(max_step) not in _NUMBERS:
        return False
    P1, P2 = previous
    if type(P1) not in _NUMBERS or type(P2) not in _NUMBERS:
        return False
    total = abs(P1) + abs(P2)
    return bool(total == 0 or max(abs(P1), abs(P2)) > _LIKE_BAR) and total < inf and _LIKE_BAR < max_step < inf


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
            "local": False,
            "method": "exact",
            "iterations": None,
            "_source": question,
            "_shape": (),
        }
    )


def _batch(question: Question, law: Law, kind: Kind) -> Allocation | None:
    targets = Targets.of(question.theta, question.K, question.T, question.previous, question.max_step)
    if targets is None or (compiled := _paid(kind, targets.theta.size)) is None:
        return None
    question = targets.of_which(question)
    found = run(compiled, question, targets, law, kind[4])
    if found is None:
        return None
    fields = ("theta", "T_target", "K_target", "P1", "P2", "T", "K", "status", "limits", "local")
    flat = (targets.theta, targets.T, targets.K, *found)
    return from_fields(
        {name: shaped(array, targets.shape) for name, array in zip(fields, flat, strict=True)}
        | {"method": "exact", "iterations": None, "_source": question, "_shape": targets.shape}
    )


def _paid(kind: Kind, n: int) -> Kernel | None:
    """The compiled loop, if it is there or if it pays to compile it now for `n` more targets."""
    if (compiled := _batches.get(kind)) is not None:
        return compiled
    _came[kind] += n
    if _came[kind] < _PAYS or (compiled := kernel(f"{kind[0]}_batch")) is None:
        return None
    return _batches.setdefault(kind, compiled)


def warm_up(
    *,
    joint: AntagonistJoint | None = None,
    priority: Priority = "torque",
    min_force: float | None = 0.0,
    max_force: float | None = None,
    slew: bool = False,
) -> bool:
    """Compile now what `allocate` needs for questions with these options, so that no call has to wait.

    Takes some seconds the first time after installation and half a second in a new process, most of it the import of
    numba. `slew` is for calls with `previous` and `max_step`. False where nothing can be compiled: the joint has no
    kernel, numba is missing or finds no directory to keep what it compiles. `allocate` works then too, more slowly.
    Raises InvalidInput for a priority that there is not, or a limit that is none.
    """
    joint = report_joint() if joint is None else joint
    law = law_of(joint)
    if priority not in PRIORITIES or not _fine(min_force, max_force):
        raise InvalidInput(f"there are no questions with {priority=}, {min_force=} N, {max_force=} N")
    if not law.name or priority not in _FIRST:
        return False
    kind = law.name, min_force is not None, max_force is not None, slew, _FIRST[priority]
    one, many = kernel(f"{law.name}_exact"), kernel(f"{law.name}_batch")
    if one is None or many is None:
        return False
    _scalars[kind], _batches[kind] = one, many
    theta = sum(joint.angle_range) / 2
    slew_limit = ((2e5, 2e5), 1e5) if slew else (None, None)
    for angle in (theta, np.full(2, theta)):
        answer(Question(joint, angle, 1.0, 0.0, priority, min_force, max_force, *slew_limit))
    return True


__all__ = ["answer", "warm_up"]
