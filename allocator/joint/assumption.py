"""Assumptions behind an answer about a joint that its data have not confirmed.

There are three: slack limits that the fit of the joint has not seen (`AntagonistJoint.slack_assumed`), muscle forces
beyond the contractions and pressures at which a muscle was measured (`Muscle.measured`), and volumes of gas where
neither a radius nor a volume is given.
"""

from dataclasses import replace

from numpy.typing import ArrayLike

from allocator.calculus import Mask
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles.measured import Visit, extrapolation
from allocator.muscles.volume import usual_volume


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


def with_volumes(joint: AntagonistJoint) -> tuple[AntagonistJoint, str]:
    """Return the joint with a volume in both muscles, and a sentence on the assumption, or "" if it was known.

    A muscle whose volume is unknown gets that of an ordinary braid that pulls like it at half of the supply, see
    `usual_volume`. Raises `InvalidInput` for a muscle that gains no force by pressure.
    """
    radii, volumes = [], {}
    for name in ("agonist", "antagonist"):
        muscle = getattr(joint, name)
        if muscle.rest_volume is None and muscle.inner_radius is None and muscle.own_radius is None:
            volume, radius = usual_volume(muscle, joint.pressure_limits[1] / 2, joint.geometry.rest_length)
            radii.append(f"{1e3 * radius:.1f} mm")
            volumes[name] = replace(muscle, rest_volume=volume)
    if not radii:
        return joint, ""
    tubes = " and ".join(dict.fromkeys(radii))
    known = "inner_radius or rest_volume of the muscles in the file of --machine says it"
    assumed = f"how much gas the muscles hold: taken as in braids of {tubes} radius, which pull like them; {known}"
    return replace(joint, **volumes), assumed
