"""Assumptions behind an answer about a joint that its data have not confirmed.

There are two: slack limits that the fit of the joint has not seen (`AntagonistJoint.slack_assumed`), and muscle forces
beyond the contractions and pressures at which a muscle was measured (`Muscle.measured`).
"""

from numpy.typing import ArrayLike

from allocator.calculus import Mask
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles.measured import Visit, extrapolation


class AssumedSlack(UserWarning):
    """Warning, given once, that an interval would end at a slack limit that is assumed."""


class Extrapolated(UserWarning):
    """Warning, given once, that an interval rests on muscle forces beyond what was measured."""


def assumption(joint: AntagonistJoint) -> str:
    """Return what is assumed about the joint's slack limits, without a full stop; "" if they were seen."""
    if not joint.slack_assumed:
        return ""
    return f"slack limits are assumed: the data of the joint's fit do not see {' and '.join(joint.unseen)}"


def assumptions(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> str:
    """Return all that an answer at these angles [rad] and pressures [Pa] assumes; "" if it assumes nothing.

    Arrays broadcast; a NaN pressure stands for no answer.
    """
    return "; ".join(filter(None, (assumption(joint), extrapolation(visits(joint, theta, P1, P2)))))


def visits(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Visit, ...]:
    """Return where both muscles are used at these angles [rad] and pressures [Pa]; none that was not measured."""
    if joint.agonist.measured is None and joint.antagonist.measured is None:
        return ()
    return tuple(
        Visit(side.name, side.muscle.measured, side.contraction, P)
        for side, P in zip(joint.sides(theta), (P1, P2), strict=True)
        if side.muscle.measured is not None
    )


def extrapolates(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> Mask | None:
    """Return where (…) a muscle is used beyond what was measured; None if neither was measured."""
    found = [visit.extrapolates for visit in visits(joint, theta, P1, P2)]
    return None if not found else found[0] | found[-1]
