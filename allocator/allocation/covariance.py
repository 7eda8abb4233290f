"""The covariance that a user gives for the parameters of the muscles."""

from dataclasses import replace
from typing import Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.joint import AntagonistJoint


def with_covariance(joint: AntagonistJoint, uncertainty: Any) -> AntagonistJoint:
    """The joint with the covariance of its muscles' parameters: True takes their own, else one matrix or a pair."""
    if not joint.affine:
        raise InvalidInput("uncertainty needs muscles affine in pressure: only then the problem is convex")
    if uncertainty is True:
        if joint.covariance is None and joint.agonist.covariance is None and joint.antagonist.covariance is None:
            raise InvalidInput("uncertainty = True, but the muscles have no covariance: fit them, or pass a matrix")
        return joint
    pair = uncertainty if isinstance(uncertainty, tuple) else (uncertainty, uncertainty)
    if len(pair) != 2:
        raise InvalidInput("uncertainty has to be True, a covariance matrix, or a pair of them (agonist, antagonist)")
    one, two = (_checked(matrix) for matrix in pair)
    agonist, antagonist = replace(joint.agonist, covariance=one), replace(joint.antagonist, covariance=two)
    return replace(joint, agonist=agonist, antagonist=antagonist, covariance=None)


def _checked(matrix: Any) -> tuple[tuple[float, ...], ...]:
    try:
        C = np.asarray(matrix, float)
    except (TypeError, ValueError):
        raise InvalidInput(f"uncertainty = {matrix!r} is not a covariance matrix") from None
    if C.ndim != 2 or C.shape[0] != C.shape[1]:
        raise InvalidInput(f"uncertainty has to be a square covariance matrix, got shape {C.shape}")
    if not np.isfinite(C).all() or not np.allclose(C, C.T, rtol=1e-8, atol=0):
        raise InvalidInput("uncertainty has to be finite and symmetric, as a covariance is")
    scale = np.sqrt(np.abs(np.diag(C)))
    scale = np.where(scale > 0, scale, 1.0)
    if np.linalg.eigvalsh(C / np.outer(scale, scale)).min() < -1e-8:
        raise InvalidInput("uncertainty has a negative eigenvalue: a covariance is positive semi-definite")
    return tuple(map(tuple, C.tolist()))


__all__ = ["with_covariance"]
