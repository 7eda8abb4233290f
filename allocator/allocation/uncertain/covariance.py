"""`with_covariance` takes the covariance that a user gives for the parameters of the muscles."""

from dataclasses import replace

from allocator import checks
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint


def with_covariance(joint: AntagonistJoint, uncertainty: object) -> AntagonistJoint:
    """Return the joint with the covariance of its muscles' parameters: their own (True), one matrix or a pair."""
    if not joint.affine:
        raise InvalidInput("uncertainty needs muscles affine in pressure: only then the problem is convex")
    if uncertainty is True:
        if joint.covariance is None and joint.agonist.covariance is None and joint.antagonist.covariance is None:
            raise InvalidInput("uncertainty = True, but the muscles have no covariance: fit them, or pass a matrix")
        return joint
    pair = uncertainty if isinstance(uncertainty, tuple) else (uncertainty, uncertainty)
    if len(pair) != 2:
        raise InvalidInput("uncertainty has to be True, a covariance matrix, or a pair of them (agonist, antagonist)")
    one, two = (checks.covariance("uncertainty", matrix) for matrix in pair)
    agonist, antagonist = replace(joint.agonist, covariance=one), replace(joint.antagonist, covariance=two)
    return replace(joint, agonist=agonist, antagonist=antagonist, covariance=None)
