"""What the fit of a joint has not seen is said in one sentence by every answer that rests on it."""

from allocator.joint.antagonist import AntagonistJoint


class AssumedSlack(UserWarning):
    """An `AssumedSlack` is warned of, once, where an interval would end at a slack limit that is assumed."""


def assumption(joint: AntagonistJoint) -> str:
    """Return what is assumed about the joint, a sentence without a full stop; empty where nothing is."""
    if not joint.slack_assumed:
        return ""
    return f"slack limits are assumed: the data of the joint's fit do not see {' and '.join(joint.unseen)}"


__all__ = ["AssumedSlack", "assumption"]
