"""Assumptions of an answer that the joint's data have not confirmed.

There are three: slack limits that the joint's fit could not identify (`AntagonistJoint.slack_assumed`), muscle forces
beyond the measured contractions and pressures (`Muscle.region`), and volumes of gas if neither a radius nor a volume
is given.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace

from numpy.typing import ArrayLike

from allocator.calculus import Mask
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import Muscle
from allocator.muscles.measured import Visit, extrapolation
from allocator.muscles.volume import usual_volume


class AssumedSlack(UserWarning):
    """Warning, given once, that an interval may end at an assumed slack limit."""


class Extrapolated(UserWarning):
    """Warning, given once, that an interval depends on muscle forces beyond the measured region."""


def assumption(joint: AntagonistJoint) -> str:
    """Return the assumption about the joint's slack limits, without a full stop; "" if they were identified."""
    if not joint.slack_assumed:
        return ""
    return f"slack limits are assumed: the data of the joint's fit do not see {' and '.join(joint.unseen)}"


def assumptions(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> str:
    """Return all assumptions of an answer at these angles [rad] and pressures [Pa]; "" if there are none.

    Arrays broadcast; a NaN pressure stands for no answer.
    """
    return "; ".join(filter(None, (assumption(joint), extrapolation(visits(joint, theta, P1, P2)))))


def visits(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> tuple[Visit, ...]:
    """Return the contractions and pressures of measured muscles at these angles [rad] and pressures [Pa]."""
    if joint.agonist.region is None and joint.antagonist.region is None:
        return ()
    return tuple(
        Visit(side.name, side.muscle.region, side.contraction, P)
        for side, P in zip(joint.sides(theta), (P1, P2), strict=True)
        if side.muscle.region is not None
    )


def extrapolates(joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> Mask | None:
    """Return whether (…) a muscle is used beyond its measured region; None if neither was measured."""
    found = [visit.extrapolates for visit in visits(joint, theta, P1, P2)]
    return None if not found else found[0] | found[-1]


def with_volumes(joint: AntagonistJoint) -> tuple[AntagonistJoint, str]:
    """Return the joint with volumes of both muscles, and a sentence on the assumption, or "" if they were known.

    Raises `InvalidInput` as `filled`.
    """
    pair, length = (joint.agonist, joint.antagonist), joint.geometry.rest_length
    (agonist, antagonist), assumed = filled(pair, (length, length), joint.pressure_limits[1])
    return (replace(joint, agonist=agonist, antagonist=antagonist) if assumed else joint), assumed


def filled(muscles: Sequence[Muscle], lengths: Iterable[float], supply: float) -> tuple[tuple[Muscle, ...], str]:
    """Return muscles of these rest `lengths` [m] with volumes, and a sentence on the assumption, or "" if all had one.

    An unknown volume becomes that of an ordinary braid with the same force at half the `supply` [Pa], see
    `usual_volume`. Raises `InvalidInput` for a muscle that gains no force by pressure.
    """
    radii, known = [], []
    for muscle, length in zip(muscles, lengths, strict=True):
        if not muscle.volume_known:
            volume, radius = usual_volume(muscle, supply / 2, length)
            radii.append(f"{1e3 * radius:.1f} mm")
            muscle = replace(muscle, rest_volume=volume)
        known.append(muscle)
    if not radii:
        return tuple(known), ""
    tubes = " and ".join(dict.fromkeys(radii))
    told = "inner_radius or rest_volume of the muscles in the file of --machine says it"
    return tuple(known), (
        f"how much gas the muscles hold: taken as in braids of {tubes} radius, which pull like them; {told}"
    )
