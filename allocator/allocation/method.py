"""A `Method` is how an allocation is solved: by which solver, from where, and under what doubt."""

from typing import Literal, NamedTuple, Self

from allocator import checks
from allocator.errors import InvalidInput

Name = Literal["analytic", "exact", "qp", "nlp", "convex"]


class Method(NamedTuple):
    """Solution method with its options. A plain name stands for `Method(name)`.

    "exact": the global optimum, in closed form or by a complete search, see `Allocation.gap`. "analytic": the inverse
    alone, without limits; NaN where it does not exist. "qp" (successive QPs, of a mechanism one a level), "nlp"
    (CasADi), "convex" (cvxpy): optimisers that start from the analytic inverse; an answer that fails the library's own
    check is replaced, and the status says so.
    """

    name: Name = "exact"
    solver: str | None = None  # "qp": "daqp", "osqp", …; "nlp": "ipopt", "sqpmethod"; "convex": "clarabel", "osqp"
    warm_start: bool = True  # False starts the optimisers in the middle of the box, to measure what it gains
    gap: float = 1e-3  # of mechanisms that are not affine: the search ends at gap·(1 + cost) above the proved least
    uncertainty: object = None  # "convex": covariance of the muscles' parameters, a pair of them, or True for their own
    risk: float = 0.05  # α, the probability with which a force limit may be broken, see `uncertain.problem`

    @classmethod
    def of(cls, method: object) -> Self:
        """Return the method that a name or a `Method` means. Raises InvalidInput, also for options that cannot be."""
        if isinstance(method, cls):
            if not 0 < checks.number("gap", method.gap, "of 1 + cost") < 1:
                raise InvalidInput(f"gap = {method.gap:g} has to lie between 0 and 1, a share of 1 + cost")
            checks.probability("risk", method.risk)
            checks.flag("warm_start", method.warm_start)
            return method
        if isinstance(method, str):
            return cls(method)  # type: ignore[arg-type]  # whoever solves knows the names
        raise InvalidInput(f"method = {method!r} has to be a name, such as 'exact', or a Method")
