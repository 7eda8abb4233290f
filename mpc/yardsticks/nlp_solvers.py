"""Solvers of the nonlinear programme in `mpc.yardsticks.shooting`, as values with their options.

Their results are proposals to be certified.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from typing import Any, ClassVar, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from mpc.codegen.buffered import Buffered
from mpc.tracking.qp.solvers import SolverOptions, with_options
from mpc.yardsticks.shooting import Given, Shooting


class NLPOptions(SolverOptions):
    """Options of a solver of nonlinear programmes, and CasADi's own options for it."""

    fixed: ClassVar[dict[str, object]]

    @property
    def casadi(self) -> dict[str, object]:
        """Options in the form of CasADi."""
        return self.fixed | {f"{self.name}.{option}": value for option, value in self.given.items()}


@dataclass(frozen=True)
class IPOPT(NLPOptions):
    """IPOPT, an interior-point method with a line search."""

    name: ClassVar[str] = "ipopt"
    fixed: ClassVar[dict[str, object]] = {"ipopt.sb": "yes"}
    tol: float = 1e-9
    max_iter: int = 200
    bound_relax_factor: float = 0.0  # a slack of -1e-8 would earn its penalty
    print_level: int = 0
    linear_solver: str | None = None
    mu_strategy: str | None = None
    acceptable_tol: float | None = None
    max_cpu_time: float | None = None  # [s]


@dataclass(frozen=True)
class Fatrop(NLPOptions):
    """Fatrop, an interior-point method for problems of optimal control."""

    name: ClassVar[str] = "fatrop"
    fixed: ClassVar[dict[str, object]] = {"structure_detection": "auto"}
    tolerance: float = 1e-9
    max_iter: int | None = None
    print_level: int = 0
    mu_init: float | None = None


_SOLVERS: dict[str, type[NLPOptions]] = {kind.name: kind for kind in (IPOPT, Fatrop)}
_WIDENING = 1e-8  # of a bound's size: fatrop widens bounds by this, without an option; they are narrowed before


# CasADi's messages for Ctrl-C inside IPOPT: between iterations, and inside a function, which throws nothing else.
_INTERRUPTED = ("User_Requested_Stop", "NonIpopt_Exception_Thrown")


class Proposal(NamedTuple):
    """Result of a solver."""

    z: Array
    multipliers: Array  # of g; positive at an upper, negative at a lower bound
    success: bool  # as reported by the solver


def _chosen(solver: str | Mapping[str, object] | NLPOptions) -> NLPOptions:
    if isinstance(solver, NLPOptions):
        return solver
    if not isinstance(solver, str | Mapping):
        raise MissingBackend("NLP solver", solver, _SOLVERS)
    return with_options("NLP solver", solver, _SOLVERS, IPOPT.name)


class NLPSolver:
    """IPOPT or fatrop, from CasADi's wheel, for one `Shooting`."""

    def __init__(self, solver: str | Mapping[str, object] | NLPOptions, shooting: Shooting) -> None:
        import casadi as ca

        chosen = _chosen(solver)
        self.name, self._free = chosen.name, ~shooting.equality
        options: dict[str, Any] = {"print_time": False, **chosen.casadi}
        if self.name == Fatrop.name:
            options["equality"] = shooting.equality.tolist()
        try:
            self._nlp = Buffered(ca.nlpsol("tracking", self.name, shooting.problem, options))
        except RuntimeError as error:
            raise InvalidInput(f"CasADi refuses {chosen!r}: {str(error).strip().splitlines()[-1]}") from None

    def __call__(self, begun: Array, given: Given) -> Proposal:
        """Return the answer for the programme of this step, `begun` at a point z."""
        lower, upper = given.lower, given.upper
        if self.name == Fatrop.name:
            lower, upper = lower + self._widening(lower), upper - self._widening(upper)
        with interruptible():
            z, _, _, _, multipliers, _ = self._nlp(begun, given.p, -inf, inf, lower, upper, 0.0, 0.0)
            said = self._nlp.stats()
        if said["return_status"] in _INTERRUPTED:
            raise KeyboardInterrupt
        return Proposal(np.ravel(z), np.ravel(multipliers), bool(said["success"]))

    def __deepcopy__(self, memo: dict[int, object]) -> "NLPSolver":
        """Return the same object, because it has no state."""
        return self

    def _widening(self, bound: Array) -> Array:
        size = np.where(np.isfinite(bound), np.maximum(1.0, np.abs(bound)), 0.0)
        return np.asarray(self._free * _WIDENING * size)


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt` for CasADi's exceptions in its place inside the block.

    CasADi raises a `RuntimeError` with its name in the text, or returns to Python with the interrupt still set, which
    Python reports as a `SystemError` caused by it. Other exceptions pass through. CasADi's conversions of arrays lose
    an interrupt silently: functions are called through `mpc.codegen.buffered` where an interrupt may occur.
    """
    try:
        yield
    except (RuntimeError, SystemError) as error:
        if "KeyboardInterrupt" in str(error) or isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
