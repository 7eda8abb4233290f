"""`allocate_at_least`: the least pressures that are stiff enough."""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.at_least import semidefinite
from allocator.allocation.at_least.result import AtLeast
from allocator.allocation.at_least.semidefinite import Floors
from allocator.allocation.box import pivoting
from allocator.allocation.box.arguments import problem_from
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.result import BoxAllocation
from allocator.allocation.relaxation import Nearby
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.gas import ISOBARIC, Stiffness, checked_stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.mechanism import Mechanism

_SEVERAL = "at least a stiffness is asked for one posture and one target at a time, not for {}"


def allocate_at_least(
    mechanism: Mechanism,
    theta: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    margin: float | None = None,
) -> AtLeast:
    """Find the least pressures with exactly the torques `T` and at least the stiffness `K`, or prove that none exist.

    Minimises ‖P - P_ref‖² over the box of the limits, subject to τ(P) = T and K(P) ⪰ K: at least as stiff in every
    direction, the ellipse of K inside that of K(P). For affine muscles this is a semidefinite programme. Clarabel
    solves it, its answer is checked, and both outcomes are proved: `AtLeast.gap`, `AtLeast.certificate`.

    Parameters
    ----------
    mechanism
        A mechanism with n joints and m muscles, all affine in the pressure.
    theta
        Posture (n,) [rad], one.
    K
        Least stiffness: a matrix (n, n) [N·m/rad], symmetric and positive definite, its diagonal (n,), of which the
        other entries are then 0, or a number for K times the unit matrix. Of an endpoint that of its dim coordinates
        [N/m]: then K_x ⪰ K, which is K_q ⪰ Jᵀ K J - Γ(f), with any number of joints.
    T
        Torques (n,) [N·m], or a number for every joint; of an endpoint in addition to Jᵀ·force.
    limits, stiffness
        As of `allocate`.
    margin
        If given, also K_q ⪰ margin·1 [N·m/rad]: the posture is stable with this margin.

    Raises
    ------
    InvalidInput
        As `allocate`, and for several postures or targets at once.
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(f"mechanism is a {type(mechanism).__name__}; expected a Mechanism")
    mechanism.check_affine("at least a stiffness")
    hand = checked_stiffness(stiffness).endpoint
    size, unit = (hand.dim, "N/m") if isinstance(hand, Endpoint) else (mechanism.n, "N·m/rad")
    if np.ndim(theta) > 1:
        raise InvalidInput(_SEVERAL.format(np.shape(theta)[:-1]))
    least = None if margin is None else checks.not_negative("margin", margin, "N·m/rad")
    problem, shape = problem_from(mechanism, theta, _matrix(K, size, unit), T, limits=limits, stiffness=stiffness)
    if shape:
        raise InvalidInput(_SEVERAL.format(shape))
    return _solved(problem, Floors.of(problem, least))


def _matrix(K: object, size: int, unit: str) -> Array:
    """Return a matrix from a diagonal or a number."""
    array = checks.real("K", K, unit)
    if array.ndim > 1:
        return array
    return array[..., None] * np.eye(size) if array.shape in ((), (size,)) else array


def _solved(problem: BoxProblem, floors: Floors) -> AtLeast:
    programme = floors.programme
    found = semidefinite.least(programme)
    if found is not None:
        answer = _exact(problem, found[0])
        if (met := AtLeast(answer, floors, found[1])).success:
            return met
    beyond = semidefinite.widest(programme)
    if beyond is None:  # unreachable torques: the nearest, and among these the nearest stiffness
        return AtLeast(
            BoxAllocation.of(problem, Nearby.of(problem, pivoting.solve(problem)), (), "exact"), floors, None
        )
    return AtLeast(_exact(problem, beyond[0]), floors, beyond[1])


def _exact(problem: BoxProblem, x: Array) -> BoxAllocation:
    """Return the answer with the pressures nearest to `x` that give the torques."""
    n = problem.mechanism.n
    torques = np.where(np.arange(problem.weights.size) < n, 1.0, 0.0)
    alone = replace(problem, weights=torques, priority="weighted", reference=x[None] * problem.unit)
    return BoxAllocation.of(alone, Nearby.of(alone, pivoting.solve(alone)), (), "clarabel")
