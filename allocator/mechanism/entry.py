"""Here `allocate` turns torques and a stiffness matrix of a mechanism into the pressures of all muscles."""

from allocator import checks
from allocator.allocation.entry import Asked, allocated
from allocator.allocation.friction import checked_direction
from allocator.allocation.method import Method, Name
from allocator.errors import InvalidInput, MissingBackend
from allocator.mechanism import batches, lifting, qp, relaxation
from allocator.mechanism.arguments import problem_from
from allocator.mechanism.batches import Solved
from allocator.mechanism.mechanism import Mechanism
from allocator.mechanism.problem import BoxProblem
from allocator.mechanism.relaxation import Nearby
from allocator.mechanism.result import BoxAllocation

METHODS: tuple[Name, ...] = ("exact", "qp")


@allocated.register
def _of_a_mechanism(mechanism: Mechanism, asked: Asked) -> BoxAllocation:
    """Return the allocation of a mechanism. Raises as `allocate`."""
    method = _checked(asked.method)
    if checked_direction(asked.direction).any():
        raise InvalidInput(
            f"direction = {checks.brief(asked.direction)} is for an AntagonistJoint with friction; a mechanism has none"
        )
    if asked.along is not None and method.name != "exact":
        raise InvalidInput(f"along is for the method 'exact', not {method.name!r}")
    problem, shape = problem_from(
        *(mechanism, asked.theta, asked.K, asked.T),
        limits=asked.limits,
        stiffness=asked.stiffness,
        priority=asked.priority,
        weights=asked.weights,
        pull=asked.pull,
    )
    problem, found = _solved(problem, method, checks.axis("along", asked.along, len(shape)) is not None)
    return BoxAllocation.of(problem, found, shape, method.name, method.gap)


def _checked(method: Method) -> Method:
    """Return the method. Raises for one that mechanisms have not, and for options that belong to others."""
    if method.name not in METHODS:
        raise MissingBackend("method", method.name, METHODS)
    if method.solver is not None and method.name != "qp":
        raise InvalidInput(f"solver = {method.solver!r} belongs to the method 'qp', not {method.name!r}")
    if method.uncertainty is not None:
        raise InvalidInput("uncertainty is of an AntagonistJoint and method='convex'")
    return method


def _solved(problem: BoxProblem, method: Method, trajectory: bool) -> tuple[BoxProblem, Nearby]:
    """Return what the method finds, and the problem that it solved last."""
    if not problem.mechanism.affine:
        if method.name != "exact":
            problem.mechanism.check_affine(f"method={method.name!r}")
        if problem.pull:
            problem.mechanism.check_affine("a pull")
        return problem, relaxation.solve(problem, method.gap)

    if problem.pull and problem.endpoint is not None and problem.endpoint.redundant:
        raise InvalidInput("a pull is not for an endpoint with more joints than coordinates")

    def solve(problem: BoxProblem) -> Solved:
        return qp.solve(problem, method.solver) if method.name == "qp" else batches.solve(problem, trajectory)

    problem, solved = lifting.solve(problem, solve)
    return problem, Nearby.of(problem, solved)
