"""Volumes of the gas in the muscles of a joint, also where neither a radius nor a volume is given."""

from dataclasses import replace

from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles.volume import usual_volume


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
