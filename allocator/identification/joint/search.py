"""The unknowns of a joint's fit are searched here: least squares from several starts, and a test of convergence.

A search has converged where no Gauss–Newton step, full or shortened, lowers the cost by 1 % of σ² = cost/(rows -
unknowns): by then the unknowns are about a tenth of a standard deviation from the least cost nearby. The step is that
of the unknowns that no bound holds, in the directions that the equations determine. Where it helps after SciPy's trust
region has come to its end in a curved valley, the search goes on from there. The best of several starts is followed to
the end.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from allocator.calculus import Array
from allocator.identification.joint.mistakes import check_weight
from allocator.identification.joint.problem import JointProblem
from allocator.identification.least_squares import solve
from allocator.muscles import scaled

_TOLERANCE = 1e-6
_TINY = 1e-10
_FIRST_EVALUATIONS = 25
_EVALUATIONS = 100
_ROUNDS = 5
_GAIN = 0.01  # of σ²
_EXACT = 1e-16  # [rad²] a cost per row that is none: the data of a simulation without noise
_PARTS = (1.0, 0.3, 0.1, 0.03)  # of a Gauss–Newton step
_KNOWN = 1e-8  # singular values below this share of the greatest belong to no determined direction


def minimise(problem: JointProblem, x: Array, rounds: int = _ROUNDS) -> tuple[Array, bool]:
    """Return x at the least cost that the search finds from `x` in some `rounds`, and whether it converged."""
    if not x.size:
        return x, True
    for _ in range(rounds):
        x = _searched(problem, x, _EVALUATIONS)
        better = _improved(problem, x)
        if better is None:
            return x, True
        x = better
    return x, False


def best_start(problem: JointProblem, starts: Iterable[Array]) -> Array:
    """Return where the search that leads after some steps has come to, from all `starts` (m,)."""
    begun = [_searched(problem, x, _FIRST_EVALUATIONS) for x in starts]
    costs = [float(r @ r) for r in map(problem.residual, begun)]
    return begun[int(np.argmin(costs))]


def _searched(problem: JointProblem, x: Array, evaluations: int) -> Array:
    from scipy.optimize import least_squares

    if not x.size:
        return x
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
            xtol=_TINY,
            gtol=_TINY,
            max_nfev=evaluations,
        )
    return np.asarray(found.x)


def _improved(problem: JointProblem, x: Array) -> Array | None:
    """Return what a Gauss–Newton step makes of `x`, or None where the search has converged."""
    r = problem.residual(x)
    cost, rows = float(r @ r), max(problem.samples.n - x.size, 1)
    enough = max(_GAIN * cost / rows, _EXACT * rows)
    step, promised = _gauss_newton(problem, x, r)
    if promised <= enough:
        return None
    for part in _PARTS:
        moved = np.clip(x + part * step, problem.lower, problem.upper)
        there = problem.residual(moved)
        if cost - float(there @ there) > enough:
            return moved
    return None


def _gauss_newton(problem: JointProblem, x: Array, r: Array) -> tuple[Array, float]:
    """Return the step (m,) of the unknowns that no bound holds, and by how much it lowers the linearised cost."""
    J = problem.jacobian(x)
    width = np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 0.0)
    near, downhill = 1e-4 * np.maximum(np.abs(x), 1e-2 * width), -J.T @ r
    free = ~(((x - problem.lower < near) & (downhill < 0)) | ((problem.upper - x < near) & (downhill > 0)))
    step = np.zeros(x.size)
    step[free] = -solve(J[:, free], r, rcond=_KNOWN)
    gain = J[:, free] @ step[free]
    return step, float(gain @ gain)


def scale_shape(problem: JointProblem, x: Array) -> Array:
    """Return the unknowns `x` of a shape, on the force scale at which the weights in `problem` deflect it as
    measured.
    """
    hung = problem.on(problem.samples.torque != 0)
    unloaded = replace(hung, samples=replace(hung.samples, torque=0 * hung.samples.torque))
    u = problem.unknowns(x)
    theta, _ = unloaded.equilibrium(u)
    K = unloaded.balance(u, theta).stiffness
    factor = check_weight(hung.samples, hung.samples.theta - unloaded.predicted(u), -hung.samples.torque / K)
    values = scaled(replace(u.muscle), factor).parameters
    values["coulomb"] = factor * u.coulomb
    return np.array([values.get(name, value) for name, value in zip(problem.names, x.tolist(), strict=True)])
