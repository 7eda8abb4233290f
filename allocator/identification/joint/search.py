"""The unknowns of a joint's fit are searched here: where to start, and least squares from there."""

from dataclasses import replace

import numpy as np

from allocator.calculus import Array
from allocator.identification.joint.mistakes import check_weight
from allocator.identification.joint.problem import JointProblem
from allocator.muscles import scaled

_TOLERANCE = 1e-8
_EVALUATIONS = 200
_GAIN = 1e-3  # of the cost


def first_guess(problem: JointProblem) -> Array:
    """Return the prototype's parameters, and no ratio, zero or friction yet."""
    values = problem.prototype.parameters
    return np.array([values.get(name, 0.05 if name == "friction" else 0.0) for name in problem.names])


def minimise(problem: JointProblem, x: Array) -> tuple[Array, bool]:
    """Return x at the least cost that the search finds from `x`, and whether it converged."""
    from scipy.optimize import least_squares

    if not x.size:
        return x, True
    width = problem.upper - problem.lower
    edge = 1e-4 * np.where(np.isfinite(width), width, np.maximum(np.abs(x), 1e-9))
    inside = np.clip(x, problem.lower + edge, problem.upper - edge)
    with np.errstate(all="ignore"):  # SciPy divides by singular values that vanish, and sees to it itself
        found = least_squares(
            problem.residual,
            inside,
            problem.jacobian,
            bounds=(problem.lower, problem.upper),
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TOLERANCE,
            gtol=_TOLERANCE,
            max_nfev=_EVALUATIONS,
        )
    return found.x, found.status > 0 or _settled(found.fun, np.asarray(found.jac))


def _settled(r: Array, J: Array) -> bool:
    """Return whether a full Gauss–Newton step would gain next to nothing: the search creeps along a valley without
    relief.
    """
    size = np.linalg.norm(J, axis=0)
    J = J / np.where(size > 0, size, 1.0)
    gain = J @ np.linalg.lstsq(J, r, rcond=1e-8)[0]
    return float(gain @ gain) <= _GAIN * float(r @ r)


def scaled_guess(problem: JointProblem) -> Array:
    """Return where to start under a weight: the shape fitted to the samples without it, scaled by what the weight
    shows.
    """
    guess, still = first_guess(problem), problem.samples.torque == 0
    if not problem.free or still.all() or still.sum() < guess.size + 1:
        return guess
    shape = replace(problem.on(still), conventional=True)
    x, _ = minimise(shape, guess)
    return scale_shape(problem, x)


def scale_shape(problem: JointProblem, x: Array) -> Array:
    """Return the unknowns `x` of a shape, on the force scale at which the weights in `problem` deflect it as
    measured.
    """
    hung = problem.on(problem.samples.torque != 0)
    unloaded = replace(hung, samples=replace(hung.samples, torque=0 * hung.samples.torque))
    u = problem.unknowns(x)
    theta, _ = unloaded.equilibrium(u)
    _, K, _ = unloaded.balance(u, theta)
    factor = check_weight(hung.samples, hung.samples.theta - u.zero - theta, -hung.samples.torque / K)
    values = scaled(replace(u.muscle), factor).parameters
    return np.array([values.get(name, value) for name, value in zip(problem.names, x.tolist(), strict=True)])


__all__ = ["first_guess", "minimise", "scale_shape", "scaled_guess"]
