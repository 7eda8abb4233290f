"""Priorities, statuses of an allocation with advice, and the rule that decides the status.

The kernels of two muscles use the same rule (`verdict` in `allocator.allocation.two_muscles.kernels.source`).
"""

from collections.abc import Iterable, Mapping
from enum import IntEnum
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Mask
from allocator.joint.limits import BINDS, PressureInterval

Priority = Literal["torque", "stiffness", "weighted"]
PRIORITIES: tuple[Priority, ...] = get_args(Priority)


class Status(IntEnum):
    """Outcome of an allocation. If several apply, the last one is given. `.advice` explains it in a sentence.

    UNSTABLE occurs for mechanisms only; NO_INVERSE, TOO_RISKY and HEDGED for one joint with two muscles only.
    """

    EXACT = 0
    TORQUE_LIMITED = 1
    STIFFNESS_LIMITED = 2
    BOTH_LIMITED = 3
    PULLED = 4
    UNSTABLE = 5
    CONFLICT = 6
    SLACK = 7
    OUTSIDE_JOINT_RANGE = 8
    SOLVER_FAILED = 9
    OUTSIDE_LIMITS = 10
    NO_INVERSE = 11
    TOO_RISKY = 12
    HEDGED = 13

    @property
    def advice(self) -> str:
        """Sentence with the meaning and the remedy."""
        return _ADVICE[self]


_ADVICE = {
    Status.EXACT: "torque and stiffness are met",
    Status.TORQUE_LIMITED: "the torque cannot be met, this is the nearest; ask for less or relieve a limit",
    Status.STIFFNESS_LIMITED: "the stiffness cannot be met, this is the nearest; choose a feasible one (see `map`)",
    Status.BOTH_LIMITED: "neither torque nor stiffness can be met, this is the best trade for the priority",
    Status.PULLED: "the pull towards the reference pressures keeps the answer off the targets",
    Status.UNSTABLE: "the stiffness is not positive definite: the posture does not hold itself",
    Status.CONFLICT: "the limits contradict each other here; the supply was kept first, then ceilings, then floors",
    Status.SLACK: "no allowed pressures pull all cables with the force that they need to stay taut",
    Status.OUTSIDE_JOINT_RANGE: (
        "the posture is beyond the joint range, answered at the nearest one inside, or stretches a muscle too far"
    ),
    Status.SOLVER_FAILED: "no answer was proved to be optimal; this is the best of them, or the exact one",
    Status.OUTSIDE_LIMITS: "a limit is broken: the slew limit leaves nothing inside, or only the inverse was asked for",
    Status.NO_INVERSE: "no pressures give this torque and stiffness",
    Status.TOO_RISKY: "no pressures keep the force limits with that probability; answered as if nothing were uncertain",
    Status.HEDGED: "the limits' probabilities and the spread of the error keep the mean off the targets",
}


def status_names(codes: NDArray[np.int8]) -> NDArray[np.str_]:
    """Return the names (…) of statuses that are given as integers (…)."""
    return np.array([status.name for status in Status])[codes]


def decided(
    T_missed: Mask,
    K_missed: Mask,
    pulled: bool,
    sides: Iterable[PressureInterval],
    outside: Mask,
    others: Mapping[Status, Mask] | None = None,
) -> NDArray[np.int8]:
    """Return the statuses (N,) from the targets missed, for answers in the box of intervals `sides`.

    `outside` marks postures beyond the range. Of `others` and the statuses of the box the last that applies counts.
    """
    sides = list(sides)
    status = T_missed * Status.TORQUE_LIMITED + K_missed * Status.STIFFNESS_LIMITED
    if pulled:
        status = np.where(status > 0, Status.PULLED, status)
    found = {
        Status.CONFLICT: np.any([side.empty for side in sides], axis=0),
        Status.SLACK: np.any([side.slack for side in sides], axis=0),
        Status.OUTSIDE_JOINT_RANGE: outside,
        Status.OUTSIDE_LIMITS: np.any([side.unreachable for side in sides], axis=0),
        **(others or {}),
    }
    for other, holds in found.items():
        status = np.maximum(status, np.where(holds, other, Status.EXACT))
    return status.astype(np.int8)


class Tolerance(NamedTuple):
    """Tolerances below which a target counts as met and a limit as binding."""

    met: float  # of the torque or stiffness scale: a target missed by less is met
    binds: float  # of the supply range: a pressure nearer to a bound lies on it


CLOSED_FORM = Tolerance(met=1e-9, binds=BINDS)
OPTIMISER = Tolerance(met=1e-6, binds=1e-7)
UNCERTAIN = Tolerance(met=1e-6, binds=1e-6)  # of cone programmes
