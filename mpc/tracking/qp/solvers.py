"""QP solvers and their options: Riccati (the default), DAQP, and the solvers that qpsolvers finds installed.

A solver is a function from a `QP` and a time limit to a point and its multipliers, or None if it gives up. The result
is only a proposal; `mpc.tracking.qp.step` checks it and the clock. `guarded` returns None when a solver raises or
returns anything but two finite arrays of the right lengths, so a solver bug cannot stop the control loop. MemoryError
is such an exception; KeyboardInterrupt and SystemExit pass through.
"""

import warnings
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from functools import cached_property
from math import inf, isfinite
from numbers import Integral, Real
from types import UnionType
from typing import Any, ClassVar, Protocol, Self, TypeVar, get_args

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput, MissingBackend
from mpc.tracking.qp.programme import QP

_MOST = 2**31 - 1  # greatest C int


class SolverOptions:
    """Options of a solver: a frozen dataclass with the solver's own names of fields.

    None selects the solver's own default. Raises `InvalidInput` for unknown options and invalid values.
    """

    name: ClassVar[str]

    def __new__(cls, *values: object, **options: object) -> Self:
        """Raise `InvalidInput` for unknown options."""
        names = [entry.name for entry in fields(cls)]  # type: ignore[arg-type]  # members are dataclasses
        if unknown := [name for name in options if name not in names]:
            raise InvalidInput(f"{cls.__name__} has no option {unknown[0]!r}; its options are {', '.join(names)}")
        return super().__new__(cls)

    def __post_init__(self) -> None:
        """Raise `InvalidInput` for values that do not have the declared kind."""
        for entry in fields(self):  # type: ignore[arg-type]
            value = getattr(self, entry.name)
            kinds = get_args(entry.type) if isinstance(entry.type, UnionType) else (entry.type,)
            wanted = next((says for kind, says, holds in _KINDS if kind in kinds and not holds(value)), None)
            if wanted and not (value is None and type(None) in kinds):
                raise InvalidInput(f"{type(self).__name__}: {entry.name} = {value!r} has to be {wanted}")

    @cached_property
    def given(self) -> dict[str, object]:
        """Options set by the caller."""
        pairs = ((entry.name, getattr(self, entry.name)) for entry in fields(self))  # type: ignore[arg-type]
        return {name: value for name, value in pairs if value is not None}


def _is_number(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Real) and 0 <= float(value) < inf


def _is_count(value: object) -> bool:
    return not isinstance(value, bool) and isinstance(value, Integral) and 0 <= int(value) <= _MOST


_KINDS = (  # kind of a field, description of its values
    (float, "a number of at least 0", _is_number),
    (int, "a whole number of at least 0", _is_count),
    (bool, "True or False", lambda value: isinstance(value, bool | np.bool_)),
    (str, "a name", lambda value: isinstance(value, str)),
)

S = TypeVar("S", bound=SolverOptions)


def with_options(kind: str, solver: str | Mapping[str, Any], members: Mapping[str, type[S]], default: str) -> S:
    """Return the member for the name `solver` or for a dict of options.

    In a dict, "name" selects the solver, by default `default`. `MissingBackend` lists the valid names of this `kind`.
    """
    options = {"name": solver} if isinstance(solver, str) else dict(solver)
    if odd := [key for key in options if not isinstance(key, str)]:
        raise InvalidInput(f"solver = {solver!r}: {odd[0]!r} is no name of an option")
    name = options.pop("name", default)
    if name not in members:
        raise MissingBackend(kind, name, members)
    return members[name](**options)


class Solver(Protocol):
    """Function that proposes a solution of a QP, or gives up with None."""

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Propose point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""


class QPSolver(SolverOptions):
    """Callable QP solver with its options: see `Solver`."""

    @abstractmethod
    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Propose point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""


@dataclass(frozen=True)
class DAQP(QPSolver):
    """DAQP, an active-set method for small dense QPs."""

    name: ClassVar[str] = "daqp"
    primal_tol: float | None = None
    dual_tol: float | None = None
    zero_tol: float | None = None
    pivot_tol: float | None = None
    progress_tol: float | None = None
    iter_limit: int | None = None

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Propose point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""
        from daqp import solve

        upper, lower = qp.upper, qp.lower
        if len(qp.R):
            upper, lower = np.concatenate([upper, qp.rows_upper]), np.concatenate([lower, qp.rows_lower])
        seconds = limit if isfinite(limit) else 0.0  # 0: as long as it takes
        z, _, flag, info = solve(qp.H, qp.f, qp.R, upper, lower, time_limit=seconds, **self.given)
        return (z, info["lam"]) if flag > 0 else None


@dataclass(frozen=True)
class Riccati(QPSolver):
    """Structured solver of a step's QP by Riccati recursions, O(N) in compiled code.

    `exchanges` bounds the exchanges of active limits, and thus the time of a step. At the bound the plan's status is
    UNSOLVED, its commands are within slew and supply, and `Plan.gap` bounds their suboptimality. If nothing compiles,
    DAQP solves the condensed QP.
    """

    name: ClassVar[str] = "riccati"
    exchanges: int | None = None

    @property
    def limit(self) -> float:
        """Greatest number of exchanges; inf: the bound of the solver."""
        return inf if self.exchanges is None else float(self.exchanges)

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Propose point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""
        return DAQP()(qp, limit)


class ThroughQpsolvers(QPSolver):
    """Solver called through qpsolvers."""

    time_limit: ClassVar[str] = ""  # name of the option that limits its time [s], if it has one

    def __call__(self, qp: QP, limit: float = inf, /) -> tuple[Array, Array] | None:
        """Propose point (n,) and multipliers (n + m,) of `qp` within `limit` [s]."""
        timed = {self.time_limit: limit} if self.time_limit and isfinite(limit) else {}
        return _through_qpsolvers(self.name, qp, {**self.given, **timed})


@dataclass(frozen=True)
class OSQP(ThroughQpsolvers):
    """OSQP, an operator-splitting method. At its default tolerance, 1e-3, answers are off by up to 8 % of the range."""

    name: ClassVar[str] = "osqp"
    time_limit: ClassVar[str] = "time_limit"
    eps_abs: float = 1e-7
    eps_rel: float = 1e-7
    max_iter: int = 50_000
    polishing: bool = True
    rho: float | None = None
    raise_error: bool = False


@dataclass(frozen=True)
class Clarabel(ThroughQpsolvers):
    """Clarabel, an interior-point method. Its default tolerance, 1e-8 of the cost, is 0.4 bar."""

    name: ClassVar[str] = "clarabel"
    time_limit: ClassVar[str] = "time_limit"
    tol_gap_abs: float = 1e-12
    tol_gap_rel: float = 1e-12
    tol_feas: float = 1e-12
    max_iter: int | None = None


@dataclass(frozen=True)
class SCS(ThroughQpsolvers):
    """SCS, an operator-splitting method for cone programmes."""

    name: ClassVar[str] = "scs"
    time_limit: ClassVar[str] = "time_limit_secs"
    eps_abs: float = 1e-8
    eps_rel: float = 1e-8
    max_iters: int | None = None


@dataclass(frozen=True)
class Installed(ThroughQpsolvers):
    """Any other solver of qpsolvers, by its name there; options are passed on unchanged."""

    name: str  # type: ignore[misc]  # a field here
    options: Mapping[str, object] = field(default_factory=dict, hash=False)

    @cached_property
    def given(self) -> dict[str, object]:
        """Options set by the caller."""
        return dict(self.options)


_OURS = ("riccati", "daqp")  # which do not go through qpsolvers
_KNOWN: dict[str, type[QPSolver]] = {kind.name: kind for kind in (Riccati, DAQP, OSQP, Clarabel, SCS)}


def solver(given: "str | Mapping[str, Any] | Solver") -> Solver:
    """Return the solver for a name, a dict of options or a value, `guarded` against failures.

    In a dict, "name" selects the solver, by default DAQP. `MissingBackend` lists the valid names, `InvalidInput` the
    valid options.
    """
    if isinstance(given, type) or not (isinstance(given, str | Mapping) or callable(given)):
        raise InvalidInput(
            f"solver = {given!r} is no QP solver: give a name, a dict of options, a value such as OSQP(eps_abs=1e-9), "
            "or a function of a QP and the seconds that it may take"
        )
    if not isinstance(given, str | Mapping):
        _check_installed(given)
        return guarded(given)
    name = given if isinstance(given, str) else given.get("name", DAQP.name)
    if name in _OURS:
        return with_options("QP solver", given, _KNOWN, DAQP.name)
    import qpsolvers

    there = set(qpsolvers.available_solvers)
    if name in there and name not in _KNOWN:
        return guarded(
            Installed(name, {} if isinstance(given, str) else {k: v for k, v in given.items() if k != "name"})
        )
    known = {kind: member for kind, member in _KNOWN.items() if kind in {*_OURS, *there}}
    if name not in known:
        raise MissingBackend("QP solver", name, {*_OURS, *there})
    return guarded(with_options("QP solver", given, known, DAQP.name))


def _check_installed(value: Solver) -> None:
    """Raise `MissingBackend` unless qpsolvers has the solver of `value`."""
    if isinstance(value, ThroughQpsolvers):
        import qpsolvers

        if value.name not in qpsolvers.available_solvers:
            raise MissingBackend("QP solver", value.name, {DAQP.name, *qpsolvers.available_solvers})


def guarded(solve: Solver) -> Solver:
    """Return a solver that gives up where `solve` fails.

    `Riccati` and `DAQP`, which do not raise, are returned unchanged (`mpc.tracking.compiled.qp_step` looks for the
    former).
    """
    if isinstance(solve, Riccati | DAQP):
        return solve

    def proposed(qp: QP, limit: float = inf) -> tuple[Array, Array] | None:
        try:
            z, multipliers = (np.asarray(part, float) for part in solve(qp, limit) or (None, None))
        except Exception:
            return None
        right = z.shape == qp.f.shape and multipliers.shape == (qp.f.size + len(qp.R),)
        return (z, multipliers) if right and np.isfinite(z).all() and np.isfinite(multipliers).all() else None

    return proposed


def _through_qpsolvers(name: str, qp: QP, settings: dict[str, object]) -> tuple[Array, Array] | None:
    """Propose a solution of `qp` by the solver that qpsolvers calls `name`."""
    import qpsolvers
    from scipy.sparse import csc_matrix

    matrix = np.asarray if name in qpsolvers.dense_solvers else csc_matrix
    rows, bounds = np.concatenate([qp.R, -qp.R]), np.concatenate([qp.rows_upper, -qp.rows_lower])
    used = np.isfinite(bounds)
    problem = qpsolvers.Problem(matrix(qp.H), qp.f, matrix(rows[used]), bounds[used], lb=qp.lower, ub=qp.upper)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the answer shows a failure
        found = qpsolvers.solve_problem(problem, name, **settings)
    if found.x is None or found.z is None or found.z_box is None:
        return None
    multipliers = np.zeros(bounds.size)
    multipliers[used] = found.z
    above, below = np.split(multipliers, 2)
    return found.x, np.concatenate([found.z_box, above - below])
