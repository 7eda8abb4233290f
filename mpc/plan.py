"""What the controller answers at every sample."""

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

from allocator.calculus import Array


class Rung(IntEnum):
    """Which step of the fallback ladder gave the plan, best first."""

    QP = 0
    PREVIOUS = 1
    ALLOCATION = 2

    @property
    def text(self) -> str:
        """What this rung does."""
        return _RUNGS[self]


_RUNGS = {
    Rung.QP: "solved the QP",
    Rung.PREVIOUS: "went on with the previous plan",
    Rung.ALLOCATION: "commanded the closed-form allocation",
}


class PlanStatus(IntEnum):
    """How the plan came about."""

    OPTIMAL = 0
    UNSOLVED = 1
    REFUSED = 2
    NO_MEASUREMENT = 3
    NOT_FINITE = 4
    CLOSED_FORM = 5

    @property
    def text(self) -> str:
        """One sentence, with advice."""
        return _STATUSES[self]


_STATUSES = {
    PlanStatus.OPTIMAL: "The QP was solved and its optimality conditions were checked.",
    PlanStatus.UNSOLVED: "The QP solver gave up; try another solver.",
    PlanStatus.REFUSED: "The QP solver's answer is not optimal and was refused; try another solver.",
    PlanStatus.NO_MEASUREMENT: "The measured state is not finite; the predicted one was used in its place.",
    PlanStatus.NOT_FINITE: "The prediction left the range of numbers; check the state and the plant's parameters.",
    PlanStatus.CLOSED_FORM: "This controller does not optimise: its commands are in closed form.",
}


class Times(NamedTuple):
    """Where the time of a step went [s]."""

    feed_forward: float
    linearise: float
    condense: float
    solve: float
    total: float


@dataclass(frozen=True, eq=False)
class Plan:
    """The commands for the horizon and what they are expected to do; time runs along the first axis. Read-only."""

    u: Array  # (N, 2) commanded pressures [Pa], within the supply and the slew limit; u[0] is the one to send now
    x: Array  # (N+1, 4) states that the plant model has from when u[0] is heard
    K: Array  # (N+1,) stiffness along x [N·m/rad]
    status: PlanStatus
    rung: Rung
    slack: float  # how far x leaves the joint range at worst [rad]
    times: Times

    def __post_init__(self) -> None:
        """The controller goes on from these arrays: nobody may write into them."""
        for array in (self.u, self.x, self.K):
            array.setflags(write=False)


__all__ = ["Plan", "PlanStatus", "Rung", "Times"]
