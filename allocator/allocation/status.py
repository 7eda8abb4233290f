"""What an allocation can say of itself."""

from enum import IntEnum


class Status(IntEnum):
    """Outcome of one allocation; `.advice` is a sentence."""

    EXACT = 0
    TORQUE_LIMITED = 1
    STIFFNESS_LIMITED = 2
    BOTH_LIMITED = 3
    SLACK = 4
    OUTSIDE_JOINT_RANGE = 5
    OUTSIDE_LIMITS = 6
    NO_INVERSE = 7

    @property
    def advice(self) -> str:
        """One sentence on what it means and what to do."""
        return _ADVICE[self]


_ADVICE = {
    Status.EXACT: "torque and stiffness are met",
    Status.TORQUE_LIMITED: "the torque cannot be met, this is the nearest; ask for less or relieve a limit",
    Status.STIFFNESS_LIMITED: "the stiffness cannot be met, this is the nearest; choose one inside its interval",
    Status.BOTH_LIMITED: "neither torque nor stiffness can be met, this is the best trade for the priority",
    Status.SLACK: "no allowed pressure keeps both cables taut here; the model's torque and stiffness do not hold",
    Status.OUTSIDE_JOINT_RANGE: "the angle is beyond the joint range, answered at the nearest angle inside",
    Status.OUTSIDE_LIMITS: "the inverse exists but breaks a limit; method='exact' respects it",
    Status.NO_INVERSE: "no pressures give this torque and stiffness",
}

__all__ = ["Status"]
