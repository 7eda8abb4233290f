"""The complete search (`allocator.search`) of allocation problems."""

import numpy as np
from numpy.typing import NDArray

from allocator import search
from allocator.allocation.problem import PRIORITIES, Problem
from allocator.calculus import Array
from allocator.joint import AntagonistJoint
from allocator.levels import Pair

_FAR = 1e3  # times all that there is: what is nearest to that is the extreme


def curves(problem: Problem) -> search.Curves:
    """The curves of both muscles in the box of a problem."""
    return search.Curves.of(problem.sides, problem.box, problem.joint.pressure_limits)


def optimum(problem: Problem) -> tuple[Array, Array, Array]:
    """(P1, P2 [Pa], gap), each (n,); the gap is that of the second goal, or of the weighted cost, in its unit."""
    now = None if problem.P1_now is None or problem.P2_now is None else (problem.P1_now, problem.P2_now)
    order, weights = PRIORITIES.index(problem.priority), (float(problem.weights[0]), float(problem.weights[1]))
    return search.optima(curves(problem), problem.T_aim, problem.K_aim, order, weights, now)


def all_pairs(problem: Problem, T: Array, K: Array) -> tuple[NDArray[np.intp], Array]:
    """How many pairs of pressures within the limits give T and K (n,), and which: (n, m, 2) [Pa], NaN where fewer."""
    return search.all_pairs(curves(problem), T, K)


def stiffness_extremes(problem: Problem, T: Array) -> tuple[Pair, Pair]:
    """The pressures of the least and of the greatest stiffness at the torques T (n,)."""
    far = _FAR * problem.scales[1]
    (a1, a2, _), (b1, b2, _) = (search.optima(curves(problem), T, K, 0) for K in (-far, far))
    return (a1, a2), (b1, b2)


def stiffness_range(problem: Problem) -> tuple[Pair, Pair]:
    """The pressures of the least and of the greatest stiffness at any torque."""
    far = _FAR * problem.scales[1]
    (a1, a2, _), (b1, b2, _) = (search.optima(curves(problem), 0.0 * far, K, 1) for K in (-far, far))
    return (a1, a2), (b1, b2)


def torque_extremes(problem: Problem, K: Array) -> tuple[Pair, Pair]:
    """The pressures of the least and of the greatest torque at the stiffnesses K (n,), brought within reach."""
    far = _FAR * problem.scales[0]
    (a1, a2, _), (b1, b2, _) = (search.optima(curves(problem), T, K, 1) for T in (-far, far))
    return (a1, a2), (b1, b2)


def ready(joint: AntagonistJoint) -> bool:
    """Compile the search of the optimum now, or load it; False where that cannot be done."""
    if not search.ready():
        return False
    none = np.zeros(1)
    optimum(Problem(joint, none + sum(joint.angle_range) / 2, none + 1, none))
    return True


__all__ = ["all_pairs", "curves", "optimum", "ready", "stiffness_extremes", "stiffness_range", "torque_extremes"]
