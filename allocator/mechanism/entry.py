"""`allocate_mechanism` turns torques and a stiffness matrix into the pressures of all muscles."""

from typing import Any, Literal, get_args

from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.joint.gas import Valves
from allocator.mechanism import batches, lifting, qp, relaxation
from allocator.mechanism.arguments import problem_from
from allocator.mechanism.batches import Solved
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.problem import MechanismProblem, Priority
from allocator.mechanism.relaxation import Nearby
from allocator.mechanism.result import MechanismAllocation

Method = Literal["exact", "qp"]
METHODS: tuple[Method, ...] = get_args(Method)


def allocate_mechanism(
    mechanism: Mechanism,
    q: ArrayLike,
    K: ArrayLike,
    T: ArrayLike = 0.0,
    *,
    priority: Priority = "torque",
    weights: Any = None,
    min_force: ArrayLike | None = 0.0,
    max_force: ArrayLike | None = None,
    previous: ArrayLike | None = None,
    max_step: ArrayLike | None = None,
    endpoint: Endpoint | None = None,
    force: ArrayLike = 0.0,
    trajectory: bool = False,
    method: Method = "exact",
    solver: str | None = None,
    gap: float = 1e-3,
    valves: Valves = "open",
    frequency: float | None = None,
    lag: ArrayLike | None = None,
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
        Stiffness [N·m/rad], isobaric unless `valves` or `frequency` say otherwise: matrices (…, n, n), symmetric and
        positive definite; or only what their diagonals shall be (…, n), or all of one diagonal, a number: the other
        entries are then free.
    T
        Torques (…, n) [N·m], or a number for every joint.
    priority
        What is met first where not both can be: "torque", "stiffness", or "weighted" by `weights`.
    weights
        (w_T, w_K), of the squared errors in [N·m]² and [N·m/rad]²: numbers, or w_T (n,) and w_K (n, n) for each entry;
        0 leaves an entry free. The sum over K has all n² entries. By default 1; needed for "weighted". That also takes
        a third, w_P [cost/Pa²]: the pressures are then not least among the best, but traded for torque and stiffness.
    min_force, max_force
        Least and greatest muscle force [N], numbers or rows (m,). 0 keeps the muscles taut; None lifts the limit.
    previous, max_step
        The pressures now (…, m) [Pa]: of equally good pressures those nearest to them are given, instead of the least
        Σ P²; with `max_step` [Pa], a number or (…), no pressure moves farther than that.
    endpoint, force
        With an `Endpoint` K is the stiffness K_x [N/m] of its dim coordinates, matrices (…, dim, dim), diagonals or a
        number, and T what is asked for besides the torques Jᵀ·force that hold it while it exerts `force` (…, dim) [N],
        such as gravity's. Of stiffnesses beyond reach the nearest is that with the least
        ‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F. With n > dim the joints that the hand does not see are free: the
        answer is then a local optimum, found by linearising K_x again and again. For muscles affine in the pressure.
    trajectory
        True: consecutive targets are near each other, and each is begun with the limits that bind in the one before.
        The answers are the same.
    method, solver
        "exact": block principal pivoting. "qp": one QP a level through qpsolvers, slow and readable, by DAQP or another
        `solver`; for muscles affine in the pressure.
    gap
        For muscles that are not affine: the search ends when each level's cost, its weighted squared error, is proved
        to be above the least by no more than gap·(1 + cost), see `MechanismAllocation.gap`. Of equally good pressures
        those given are nearest in their neighbourhood.
    valves, frequency, lag
        Which stiffness `K` is, as in `Mechanism.stiffness`: "open" isobaric; "shut", or a truth value for each muscle,
        with gas trapped; or what motions at the frequency [Hz] meet, with regulators of this lag [s], a number or (m,).

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
    if not isinstance(method, str) or method not in METHODS:
        raise MissingBackend("method", method, METHODS)
    if solver is not None and method != "qp":
        raise InvalidInput(f"solver = {solver!r} belongs to the method 'qp', not {method!r}")
    problem, shape = problem_from(
        mechanism,
        q,
        K,
        T,
        priority=priority,
        weights=weights,
        min_force=min_force,
        max_force=max_force,
        previous=previous,
        max_step=max_step,
        kind=mechanism.kind(valves, frequency, lag),
        endpoint=endpoint,
        force=force,
    )
    if not 0 < checks.number("gap", gap, "of 1 + cost") < 1:
        raise InvalidInput(f"gap = {gap:g} has to lie between 0 and 1, a share of 1 + cost")
    problem, found = _solved(problem, method, solver, checks.flag("trajectory", trajectory), gap)
    return MechanismAllocation.of(problem, found, shape, method, gap)


def _solved(
    problem: MechanismProblem, method: Method, solver: str | None, trajectory: bool, gap: float
) -> tuple[MechanismProblem, Nearby]:
    """Return what the method finds, and the problem that it solved last."""
    if not problem.mechanism.affine:
        if method != "exact":
            problem.mechanism.check_affine(f"method={method!r}")
        if problem.pull:
            problem.mechanism.check_affine("a third weight")
        return problem, relaxation.solve(problem, gap)

    if problem.pull and problem.endpoint is not None and problem.endpoint.redundant:
        raise InvalidInput("a third weight is not for an endpoint with more joints than coordinates")

    def solve(problem: MechanismProblem) -> Solved:
        return qp.solve(problem, solver) if method == "qp" else batches.solve(problem, trajectory)

    problem, solved = lifting.solve(problem, solve)
    return problem, Nearby.of(problem, solved)
