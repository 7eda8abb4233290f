"""Predicted angles and forces of a fitted joint, with their intervals."""

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import CONVENTIONAL_AREA, JointProblem
from allocator.identification.joint.report import parameter_jacobian
from allocator.identification.joint.samples import JointSamples
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Geometry
from allocator.muscles import force_gradient
from allocator.muscles.uncertainty import deviation

if TYPE_CHECKING:
    from allocator.identification.joint.result import JointFit

_GROWTH = 20.0  # of the error, per half width outside the measured region: observed on left-out lengths
_MOST_BEYOND = 0.35  # [rad] beyond the measured angles in the search for equilibria
_NORMAL = 1.96  # standard deviations of an interval of 95 %


class Prediction(NamedTuple):
    """Angles as shown by the encoder; ± 1.96 `std` is the 95 % interval of a measurement."""

    theta: Array  # (n,) [rad]; NaN without an equilibrium
    std: Array  # (n,) [rad]


def predict(
    fit: "JointFit", P1: ArrayLike, P2: ArrayLike, torque: ArrayLike, direction: ArrayLike, geometry: Geometry | None
) -> Prediction:
    """Return the prediction of a `JointFit`, as its method of this name."""
    known = {shape.geometry for shape in fit.shapes.values()}
    if geometry is None:
        if len(known) > 1:
            raise InvalidInput("the fit is of several geometries: pass geometry=, one of them or a new one")
        geometry = next(iter(known))
    measured = fit.samples.theta
    middle = (measured.min() + measured.max()) / 2
    s = JointSamples.checked(middle, P1, P2, geometry=geometry, torque=torque, direction=direction, zero=fit.zero)
    there = replace(fit.problem, samples=s, margin=float(np.ptp(measured)) / 2 + _MOST_BEYOND)
    _, reached = there.equilibrium(there.unknowns(fit.x))
    std = angle_std(fit, there, new_group=geometry not in known)
    theta = middle - there.angle_error(fit.x)
    return Prediction(*(np.where(reached, a, np.nan) for a in (theta, std)))


def angle_std(fit: "JointFit", problem: JointProblem, new_group: bool) -> Array:
    """Return the standard deviation (n,) [rad] of an angle measured at the samples of `problem`, from a `JointFit`.

    The errors of the angles already contain the error of the law; another law that fits as well predicts the same.
    """
    error = fit.left_out * np.sqrt(1 + 1 / len(fit.groups)) if new_group else fit.rms
    if np.isnan(error):
        raise InvalidInput(
            "no group was left out in turn: how far off this fit is for another one is not known; fit several groups "
            "with leave_one_out=True"
        )
    found = fit.doubt.discrepancy
    error = error * (1 + _GROWTH * found.outside(problem, fit.x))
    return np.asarray(np.sqrt(found.angle_variance(problem, fit.x) + error**2))


class ForceIntervals(NamedTuple):
    """Forces of both muscles and their intervals; arrays (…) [N]."""

    agonist: Array | float
    antagonist: Array | float
    agonist_interval: tuple[Array | float, Array | float]
    antagonist_interval: tuple[Array | float, Array | float]
    seen: bool  # False: the common force is assumed, within the intervals that the data allow


def force_intervals(
    fit: "JointFit", joint: AntagonistJoint, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike
) -> ForceIntervals:
    """Return the intervals of a `JointFit` at angles [rad] and pressures [Pa], which broadcast."""
    given = checks.pressures_or_symbols(P1, P2)
    theta, *pressures = checks.broadcast(theta=checks.angle("theta", theta), P1=given[0], P2=given[1])
    held, intervals, values = _held(fit, joint), [], []
    scale = fit.scale / CONVENTIONAL_AREA if fit.scale and fit.problem.conventional else 1.0  # in that of the problem
    at, k = (joint.geometry.agonist(theta), joint.geometry.antagonist(theta)), len(joint.agonist.parameters)
    for i, (muscle, P, there) in enumerate(zip((joint.agonist, joint.antagonist), pressures, at, strict=True)):
        C = held[i * k : (i + 1) * k, i * k : (i + 1) * k]
        half = _NORMAL * deviation(force_gradient(muscle, P, there.contraction), C)
        F, common = np.asarray(muscle.law(P, there.contraction)), scale * fit.problem.mean_arm / there.arm
        ends = F + fit.common.low * common - half, F + fit.common.high * common + half
        value, low, high = (a if np.ndim(a) else float(a) for a in (F, *ends))
        values.append(value)
        intervals.append((low, high))
    return ForceIntervals(values[0], values[1], intervals[0], intervals[1], fit.common.seen)


def _held(fit: "JointFit", joint: AntagonistJoint) -> Array:
    """Return the covariance of the parameters of both muscles, at constant φ of `problem` if the scale was fitted."""
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
