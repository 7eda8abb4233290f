"""The angle that a fitted joint will show at other pressures is predicted here, with an interval that is to hold."""

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.samples import JointSamples
from allocator.joint.geometry import Geometry

if TYPE_CHECKING:
    from allocator.identification.joint.result import JointFit

_GROWTH = 20.0  # of the error, per half width of the measured region outside it: seen on lengths that were left out
_MOST_BEYOND = 0.35  # [rad] beyond the measured angles that equilibria are looked for


class Prediction(NamedTuple):
    """A prediction holds angles as the encoder will show them; ± 1.96 `std` is the 95 % interval of a measurement."""

    theta: Array  # (n,) [rad]; NaN where the joint has no equilibrium
    std: Array  # (n,) [rad]


def predict(
    fit: "JointFit",
    P1: ArrayLike,
    P2: ArrayLike,
    torque: ArrayLike,
    direction: ArrayLike,
    geometry: Geometry | None,
) -> Prediction:
    """Return the prediction of a `JointFit`, as its method of this name does."""
    known = {shape.geometry for shape in fit.shapes.values()}
    if geometry is None:
        if len(known) > 1:
            raise InvalidInput("the fit is of several geometries: pass geometry=, one of them or a new one")
        geometry = next(iter(known))
    measured = fit.samples.theta
    middle = (measured.min() + measured.max()) / 2
    s = JointSamples.checked(middle, P1, P2, geometry=geometry, torque=torque, direction=direction)
    there = replace(fit.problem, samples=s, margin=float(np.ptp(measured)) / 2 + _MOST_BEYOND)
    _, reached = there.equilibrium(there.unknowns(fit.x))
    std = angle_std(fit, there, new_group=geometry not in known)
    theta = middle - there.angle_error(fit.x)
    return Prediction(*(np.where(reached, a, np.nan) for a in (theta, std)))


def angle_std(fit: "JointFit", problem: JointProblem, new_group: bool) -> Array:
    """Return the standard deviation (n,) [rad] of an angle measured at the samples of `problem`, from a `JointFit`.

    The error of the law is in the errors of the angles already; another law that fits as well predicts the same.
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
