"""Contenders: the analytic inverse, raw and clipped, and the allocators."""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator import Method, Status, allocate, inverse
from benchmarks.allocators.targets import Array, Flags, TargetSet

Clip = Literal["nothing", "supply", "box"]
PRIORITIES = ("torque", "stiffness", "weighted")
WEIGHTS = (2.0, 5.0)  # w_T [1/(N·m)²], w_K [1/(N·m/rad)²] of the weighted priority


class Answer(NamedTuple):
    """Pressures for n targets; of an allocator also its claims."""

    P1: Array  # [Pa]
    P2: Array  # [Pa]
    status: NDArray[np.int8] | None = None
    residual: Array | None = None  # the KKT residual, in fractions of the supply range
    local: Flags | None = None  # not proved to be the global optimum
    iterations: NDArray[np.int32] | None = None

    @property
    def failed(self) -> Flags:
        """Whether the back-end's own answer was not optimal and was replaced, by the status."""
        return np.zeros(self.P1.shape, bool) if self.status is None else self.status == Status.SOLVER_FAILED


@dataclass(frozen=True)
class Inverse:
    """The analytic inverse, clipped to "nothing", to the "supply" or to the "box" of all limits.

    It has no priority. Without an inverse it returns NaN, as does its clipped form.
    """

    name: str
    clip: Clip

    def answer(self, targets: TargetSet, priority: str) -> Answer:
        """Return pressures for all targets; the priority is ignored."""
        joint = targets.joint
        P1, P2 = inverse(targets.theta, targets.K, targets.T, joint=joint)
        if self.clip == "supply":
            return Answer(np.clip(P1, *joint.pressure_limits), np.clip(P2, *joint.pressure_limits))
        if self.clip == "box":
            return Answer(*joint.pressure_box(targets.reached).project(P1, P2))
        return Answer(P1, P2)


@dataclass(frozen=True)
class Allocator:
    """`allocate` by one method and solver."""

    name: str
    method: Method = Method()  # noqa: RUF009  # immutable

    def answer(self, targets: TargetSet, priority: str, warm_start: bool = True) -> Answer:
        """Return pressures for all targets, with claims."""
        a = self.allocation(targets, priority, warm_start)
        return Answer(a.P1, a.P2, a.status, a.kkt_residual, ~(a.gap <= 1e-6), a.iterations)

    def allocation(self, targets: TargetSet, priority: str, warm_start: bool = True) -> Any:
        """Return the library's own answer; `answer` adds the residual, which is not timed."""
        weights = WEIGHTS if priority == "weighted" else None
        method, asked = self.method._replace(warm_start=warm_start), (targets.theta, targets.K, targets.T)
        return allocate(*asked, joint=targets.joint, priority=priority, weights=weights, method=method)


INVERSES = (
    Inverse("inverse", "nothing"),
    Inverse("inverse, clipped", "supply"),
    Inverse("inverse, in the box", "box"),
)
EXACT = Allocator("exact")
BACK_ENDS = (
    Allocator("qp (daqp)", Method("qp", solver="daqp")),
    Allocator("qp (osqp)", Method("qp", solver="osqp")),
    Allocator("nlp (ipopt)", Method("nlp", solver="ipopt")),
    Allocator("nlp (sqpmethod)", Method("nlp", solver="sqpmethod")),
    Allocator("convex (clarabel)", Method("convex", solver="clarabel")),
)
CONTENDERS = (*INVERSES, EXACT, *BACK_ENDS)
