"""`allocate_mechanism` turns torques and a stiffness matrix into the pressures of all muscles."""

from typing import Any

from numpy.typing import ArrayLike

from allocator import checks
from allocator.allocation.method import Method, Name
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.limits import TAUT, Limits
from allocator.mechanism import batches, lifting, qp, relaxation
from allocator.mechanism.arguments import problem_from
from allocator.mechanism.batches import Solved
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.problem import MechanismProblem, Priority
from allocator.mechanism.relaxation import Nearby
from allocator.mechanism.result import MechanismAllocation

METHODS: tuple[Name, ...] = ("exact", "qp")


def allocate_mechanism(
    mechanism: Mechanism,
    q: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    limits: Limits = TAUT,
    stiffness: Stiffness = ISOBARIC,
    priority: Priority = "torque",
    weights: Any = None,
    pull: tuple[float, ArrayLike] | None = None,
    along: int | None = None,
    method: Name | Method = "exact",
) -> MechanismAllocation:
    """Find the pressures of all muscles that give stiffness `K` and torques `T` at the posture `q`, or come nearest.

    Solves problem [M] of `allocator.mechanism.problem`, whose answer is unique. Leading axes of arguments broadcast.

    Parameters
    ----------
    mechanism
        A mechanism with n joints and m muscles.
    q
        Posture (…, n) [rad]; beyond the angle limits it is answered at the nearest posture within, and says so.
    K
        Stiffness [N·m/rad], isobaric unless `stiffness` says otherwise: matrices (…, n, n), symmetric and positive
        definite; or only what their diagonals shall be (…, n), or all of one diagonal, a number: the other entries are
        then free.
    T
        Torques (…, n) [N·m], or a number for every joint.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K), of the squared errors in [N·m]² and [N·m/rad]²: numbers, or w_T (n,) and w_K (n, n) for each entry;
        0 leaves an entry free. The sum over K has all n² entries. By default 1; needed for "weighted".
    pull
        (ρ, P_ref), ρ [cost]/[Pa]² and pressures (…, m) [Pa], for "weighted": the pressures are then not least among the
        best, but their distance from P_ref is traded for torque and stiffness.
    limits
        Least and greatest muscle force [N] are numbers or rows (m,). Of equally good pressures those nearest to
        `previous` (…, m) [Pa] are given, instead of the least Σ P²; with `max_step` [Pa], a number or (…), no pressure
        moves farther than that.
    stiffness
        Which stiffness `K` is: `Stiffness("shut")`, or with a truth value for each muscle, has gas trapped; with a
        frequency and the regulators' lag, a number or (m,), it is what motions meet. With an `endpoint` K is the
        stiffness K_x [N/m] of its dim coordinates, matrices (…, dim, dim), diagonals or a number, and T what is asked
        for besides the torques Jᵀ·force that hold it while it exerts `force` (…, dim) [N], such as gravity's. Of
        stiffnesses beyond reach the nearest is that with the least ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F. With
        n > dim the joints that the hand does not see are free: the answer is then a local optimum, found by linearising
        K_x again and again. For muscles affine in the pressure.
    along
        The axis of time: consecutive targets are near each other, and each is begun with the limits that bind in the
        one before. The answers are the same.
    method
        "exact": block principal pivoting; of muscles that are not affine a search, which ends when each level's cost,
        its weighted squared error, is proved to be above the least by no more than gap·(1 + cost) of the `Method`, see
        `MechanismAllocation.gap`. Of equally good pressures those given are nearest in their neighbourhood.
        "qp": one QP a level through qpsolvers, slow and readable, by DAQP or another solver; for affine muscles.

    Raises
    ------
    InvalidInput
        For an argument that makes no sense: shapes that do not fit n and m, a K that is not symmetric or not positive
        definite, NaN, degrees for radians, bar for Pa, contradictory limits, valves, a frequency or a lag that cannot
        be; for gas in a muscle whose volume is not known (`Muscle.rest_volume`), and for muscles whose force does not
        rise with the pressure all over their limits; at a posture where the Jacobian of the endpoint is singular.
    MissingBackend
        For an unknown method or solver.
    """
    if not isinstance(mechanism, Mechanism):
        raise InvalidInput(
            f"mechanism is a {type(mechanism).__name__}; expected a Mechanism, such as Mechanism.from_joint"
        )
    chosen = _checked(Method.of(method))
    asked = {"limits": limits, "stiffness": stiffness, "priority": priority, "weights": weights, "pull": pull}
    problem, shape = problem_from(mechanism, q, K, T, **asked)
    problem, found = _solved(problem, chosen, checks.axis("along", along, len(shape)) is not None)
    return MechanismAllocation.of(problem, found, shape, chosen.name, chosen.gap)


def _checked(method: Method) -> Method:
    """Return the method. Raises for one that mechanisms have not, and for options that belong to others."""
    if method.name not in METHODS:
        raise MissingBackend("method", method.name, METHODS)
    if method.solver is not None and method.name != "qp":
        raise InvalidInput(f"solver = {method.solver!r} belongs to the method 'qp', not {method.name!r}")
    if method.uncertainty is not None:
        raise InvalidInput("uncertainty is of an AntagonistJoint and method='convex'")
    if not 0 < checks.number("gap", method.gap, "of 1 + cost") < 1:
        raise InvalidInput(f"gap = {method.gap:g} has to lie between 0 and 1, a share of 1 + cost")
    return method


def _solved(problem: MechanismProblem, method: Method, trajectory: bool) -> tuple[MechanismProblem, Nearby]:
    """Return what the method finds, and the problem that it solved last."""
    if not problem.mechanism.affine:
        if method.name != "exact":
            problem.mechanism.check_affine(f"method={method.name!r}")
        if problem.pull:
            problem.mechanism.check_affine("a pull")
        return problem, relaxation.solve(problem, method.gap)

    if problem.pull and problem.endpoint is not None and problem.endpoint.redundant:
        raise InvalidInput("a pull is not for an endpoint with more joints than coordinates")

    def solve(problem: MechanismProblem) -> Solved:
        return qp.solve(problem, method.solver) if method.name == "qp" else batches.solve(problem, trajectory)

    problem, solved = lifting.solve(problem, solve)
    return problem, Nearby.of(problem, solved)
