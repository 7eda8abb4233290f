"""The forces that a fitted joint has, with intervals: what the errors of the fit leave open, and the common force."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.identification.joint.problem import CONVENTIONAL_AREA
from allocator.identification.joint.report import parameter_jacobian
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import force_gradient
from allocator.muscles.uncertainty import deviation

if TYPE_CHECKING:
    from allocator.identification.joint.result import JointFit

_NORMAL = 1.96  # standard deviations of an interval of 95 %


class ForceIntervals(NamedTuple):
    """Force intervals are what each muscle pulls with, and between which forces that lies; arrays (…) [N]."""

    agonist: Array | float
    antagonist: Array | float
    agonist_interval: tuple[Array | float, Array | float]
    antagonist_interval: tuple[Array | float, Array | float]
    seen: bool  # False: the common force is assumed, and the intervals are what the data leave of it


def force_intervals(
    fit: "JointFit", joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike
) -> ForceIntervals:
    """Return the intervals of a `JointFit` at angles [rad] and pressures [Pa], which broadcast."""
    given = checks.pressures_or_symbols(P1, P2)
    theta, *pressures = checks.broadcast(theta=checks.angle("theta", theta), P1=given[0], P2=given[1])
    contractions = (joint.geometry.agonist(theta).contraction, joint.geometry.antagonist(theta).contraction)
    held, intervals, values = _held(fit, joint), [], []
    arms = joint.geometry.agonist(theta).arm, joint.geometry.antagonist(theta).arm
    k = len(joint.agonist.parameters)
    for i, (muscle, P, eps, arm) in enumerate(
        zip((joint.agonist, joint.antagonist), pressures, contractions, arms, strict=True)
    ):
        gradient = force_gradient(muscle, P, eps)
        C = held[i * k : (i + 1) * k, i * k : (i + 1) * k]
        half = _NORMAL * deviation(gradient, C)
        F, common = np.asarray(muscle.law(P, eps)), _scale(fit) * fit.problem.mean_arm / arm
        values.append(_plain(F))
        intervals.append((_plain(F + fit.common.low * common - half), _plain(F + fit.common.high * common + half)))
    return ForceIntervals(values[0], values[1], intervals[0], intervals[1], fit.common.seen)


def _plain(F: Array) -> Array | float:
    """Return a float for a scalar call."""
    return F if np.ndim(F) else float(F)


def _scale(fit: "JointFit") -> float:
    """Return the force scale of the fit in that of its problem."""
    return fit.scale / CONVENTIONAL_AREA if fit.scale and fit.problem.conventional else 1.0


def _held(fit: "JointFit", joint: AntagonistJoint) -> Array:
    """Return the covariance of the parameters of both muscles, φ of `problem` held where the scale was fitted."""
    n = len(joint.agonist.parameters) + len(joint.antagonist.parameters)
    if joint.covariance is None:
        return np.zeros((n, n))
    if fit.problem.conventional:
        return np.asarray(joint.covariance)
    C = fit.doubt.covariance
    gradient = fit.problem.gradient(lambda u: np.array([fit.problem.pull_share(u)]), fit.x)[0]
    share, variance = C @ gradient, float(gradient @ C @ gradient)
    J = parameter_jacobian(fit.problem, fit.problem.unknowns(fit.x))
    return np.asarray(J @ (C - np.outer(share, share) / max(variance, 1e-300)) @ J.T)
