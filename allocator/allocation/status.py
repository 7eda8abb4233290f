"""A `Status` says what became of an allocation."""

from enum import IntEnum


class Status(IntEnum):
    """A `Status` is the outcome of an allocation, of several that hold the last; `.advice` is a sentence on it."""

    EXACT = 0
    TORQUE_LIMITED = 1
    STIFFNESS_LIMITED = 2
    BOTH_LIMITED = 3
    PULLED = 4
    CONFLICT = 5
    SLACK = 6
    OUTSIDE_JOINT_RANGE = 7
    SOLVER_FAILED = 8
    OUTSIDE_LIMITS = 9
    NO_INVERSE = 10
    TOO_RISKY = 11
    HEDGED = 12

    @property
    def advice(self) -> str:
        """Return a sentence on what it means and what to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.EXACT: "torque and stiffness are met",
    Status.TORQUE_LIMITED: "the torque cannot be met, this is the nearest; ask for less or relieve a limit",
    Status.STIFFNESS_LIMITED: "the stiffness cannot be met, this is the nearest; choose one inside its interval",
    Status.BOTH_LIMITED: "neither torque nor stiffness can be met, this is the best trade for the priority",
    Status.PULLED: "the pull towards the reference pressures keeps the answer off the targets",
    Status.CONFLICT: "the limits contradict each other here; the supply was kept first, then ceilings, then floors",
    Status.SLACK: "no allowed pressure pulls both cables with the force that they need to stay taut",
    Status.OUTSIDE_JOINT_RANGE: "the angle is beyond the joint range, answered at the nearest angle inside",
    Status.SOLVER_FAILED: "the back-end's answer was not optimal; this is the exact or projected one instead",
    Status.OUTSIDE_LIMITS: "a limit is broken: the slew limit leaves nothing inside, or only the inverse was asked for",
    Status.NO_INVERSE: "no pressures give this torque and stiffness",
    Status.TOO_RISKY: "no pressures keep the force limits with that probability; answered as if nothing were uncertain",
    Status.HEDGED: "the limits' probabilities and the spread of the error keep the mean off the targets",
}

__all__ = ["Status"]
