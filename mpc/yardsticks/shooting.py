"""Multiple shooting of the problem in `mpc.tracking.controller`: a nonlinear programme, ordered for fatrop.

Stage k has the state χ_k = (x_k, u_{k-1}, s, s_F) and the control u_k. The last command is a state because the slew
limit and the rate's cost couple two samples; the slacks are because all stages share them: χ_{k+1} repeats them.

    z = (χ_0, u_0, χ_1, u_1, …, χ_N)
    g = (χ_1 - f(χ_0, u_0), rows_0, χ_2 - f(χ_1, u_1), rows_1, …, rows_N),      lower ≤ g ≤ upper

    rows_0 = (x_0, u_{-1}, s, s_F, u_0, u_0 - u_{-1})                            the first two are given
    rows_k = (u_k, u_k - u_{k-1}, θ_k - s, θ_k + s, F(x_k) + s_F)                rows_N without the first two

Solutions of solvers are checked: `certify` evaluates the conditions of Karush, Kuhn and Tucker with the solver's
multipliers. Units within z and g: pressures in bar, forces in 100 N, slacks in mrad and 0.1 N; the cost in 10 000.

Solvers are values with their options. Their results are proposals to be certified.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from math import inf
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput, MissingBackend
from allocator.lazy import SX, Function
from allocator.units import BAR
from mpc.codegen.buffered import Buffered
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.cost import COMMANDS, NY, Rows, Weights, charges
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.limits import Limits
from mpc.tracking.linearise import Motion
from mpc.tracking.qp.solvers import SolverOptions, with_options

_FORCE, _COST = 100.0, 1e4  # [N], [cost]
_S, _S_F = 1e-3, 0.1  # slacks [rad], [N]
_X = np.array([1.0, 1.0, BAR, BAR])  # units of x
_CHI, _STAGE = NX + NU + 2, NX + 2 * NU + 2  # numbers in χ_k, in (χ_k, u_k)
_PREVIEW = 1 + NX + NY + 2 * NU  # numbers given to a stage: d_k, x*_k, y*_k, u*_k, u*_{k-1}


class Residuals(NamedTuple):
    """Distance of a point from optimality, in units of z, g and the cost; NaN: not finite."""

    primal: float  # greatest violation of a row
    stationarity: float  # greatest entry of the Lagrangian's gradient
    gap: float  # sum of the multipliers times the distances from their bounds; relative to a cost above 1

    def within(self, tolerance: float) -> bool:
        """Return whether all residuals are below `tolerance`; False for NaN."""
        return all(value <= tolerance for value in self)


class Given(NamedTuple):
    """Data of one step."""

    p: Array  # the parameters
    lower: Array  # of g
    upper: Array


class Shooting:
    """Programme of `plant` for N samples of `dt` [s], open to inspection; `L` (6, 6) is the terminal factor."""

    def __init__(self, plant: Plant, dt: float, N: int, weights: Weights, limits: Limits, L: Array) -> None:
        self.plant, self.dt, self.N, self.weights, self.limits = plant, dt, N, weights, limits
        self._L = L * np.append(_X, np.full(NU, BAR))
        self.equality = np.concatenate([[True] * self._gap(k) + list(self._fixed(k)) for k in range(N + 1)])

    def __getstate__(self) -> dict[str, object]:
        """Leave out CasADi's symbols, which cannot be pickled."""
        return {name: value for name, value in self.__dict__.items() if name != "problem"}

    def __deepcopy__(self, memo: dict[int, object]) -> "Shooting":
        """Return the same object, because it does not change."""
        return self

    # --- the programme ----------------------------------------------------------------------------------------------

    @cached_property
    def problem(self) -> "dict[str, SX]":
        """CasADi's dictionary x, p, f, g of the programme."""
        import casadi as ca

        N = self.N
        z, preview = ca.SX.sym("z", self.size), ca.SX.sym("p", _PREVIEW, N + 1)
        chi = [z[k * _STAGE : k * _STAGE + _CHI] for k in range(N + 1)]
        u = [z[k * _STAGE + _CHI : (k + 1) * _STAGE] for k in range(N)]
        cost, rows = self._end(chi[N], preview[:, N]), []
        for k in range(N):
            cost += self._stage_cost(chi[k], u[k], preview[:, k], first=k == 0)
            rows += [chi[k + 1] - self._next(chi[k], u[k], preview[0, k]), *self._rows(k, chi[k], u[k])]
        rows += self._rows(N, chi[N], None)
        return {"x": z, "p": ca.vec(preview), "f": cost / _COST, "g": ca.vertcat(*rows)}

    @property
    def size(self) -> int:
        """Number of entries of z."""
        return self.N * _STAGE + _CHI

    def _next(self, chi: "SX", u: "SX", d: "SX") -> "SX":
        import casadi as ca

        return ca.vertcat(self._step(_state(chi), BAR * u, d) / ca.DM(_X), u, chi[NX + NU :])

    @cached_property
    def _step(self) -> "Function":
        step: Function = self.plant.discrete(self.dt)
        return step

    def _stage_cost(self, chi: "SX", u: "SX", preview: "SX", *, first: bool) -> "SX":
        """Return the cost of `mpc.tracking.cost`, without that of the measured state, which is fixed."""
        import casadi as ca

        _, x_star, y_star, u_star, u_star_last = _given_to_stage(preview)
        x, e = _state(chi), BAR * (u - u_star)
        y = ca.vertcat(self.plant.stiffness(x), *self.plant.forces(x))
        rate = (e - BAR * (chi[NX : NX + NU] - u_star_last)) / self.dt
        rows = Rows(*(ca.vertsplit(row) for row in (x - x_star, y - y_star, e, rate)))
        return ca.SX(sum(charges(self.weights, rows, COMMANDS if first else Rows._fields).values()))

    def _end(self, chi: "SX", preview: "SX") -> "SX":
        """Return the terminal cost and the cost of the slacks."""
        import casadi as ca

        _, x_star, _, _, u_star_last = _given_to_stage(preview)
        w, s, s_F = self.weights, _S * chi[NX + NU], _S_F * chi[NX + NU + 1]
        xi = ca.vertcat(chi[:NX] - x_star / ca.DM(_X), chi[NX : NX + NU] - u_star_last)
        slacks = w.slack * s + w.slack_square / 2 * s**2 + w.slack_force * s_F + w.slack_force_square / 2 * s_F**2
        return ca.sumsqr(ca.mtimes(ca.DM(self._L), xi)) / 2 + slacks

    def _rows(self, k: int, chi: "SX", u: "SX | None") -> list["SX"]:
        import casadi as ca

        u_last, s, s_F = chi[NX : NX + NU], _S * chi[NX + NU], _S_F * chi[NX + NU + 1]
        commands = [] if u is None else [u, u - u_last]
        if k == 0:
            return [chi, *commands]
        F = ca.vertcat(*self.plant.forces(_state(chi)))
        return [*commands, chi[0] - s, chi[0] + s, (F + s_F) / _FORCE]

    def _gap(self, k: int) -> int:
        return _CHI if k < self.N else 0

    def _fixed(self, k: int) -> Mask:
        """Return which rows of stage k are equalities."""
        count = 2 * NU + _CHI if k == 0 else 2 * NU * (k < self.N) + 2 + NU
        return np.arange(count) < (NX + NU) * (k == 0)

    # --- its numbers ------------------------------------------------------------------------------------------------

    def given(self, x: Array, feed: FeedForward, d: Array, u_last: Array, u_star_last: Array) -> Given:
        """Return the data of a step: the state `x` (4,), torques `d` (N,), previous command and feed-forward (2,)."""
        u_star = np.vstack([u_star_last, feed.u, feed.u[-1:]]) / BAR  # (N+2, 2)
        stages = np.hstack([np.append(d, 0.0)[:, None], feed.x, feed.y, u_star[1:], u_star[:-1]])
        bounds = [self._bounds(k, x, u_last / BAR) for k in range(self.N + 1)]
        lower, upper = (np.concatenate(side) for side in zip(*bounds, strict=True))
        return Given(stages.ravel(), lower, upper)

    def _bounds(self, k: int, x: Array, u_last: Array) -> tuple[Array, Array]:
        """Return the bounds of all rows of stage k. Commands outside the supply return at the slew limit."""
        (P_lo, P_hi), (left, right), step = self.limits.pressure, self.limits.theta, self.limits.step / BAR
        never, least = np.inf, self.limits.min_force / _FORCE
        gap = np.zeros(self._gap(k))
        lower: list[ArrayLike] = [gap]
        upper: list[ArrayLike] = [gap]
        if k == 0:
            now = np.append(x / _X, u_last)
            lower += [now, [0.0, 0.0]]
            upper += [now, [never, never]]
        if k < self.N:
            lower += [np.minimum(P_lo / BAR, u_last + (k + 1) * step), [-step] * NU]
            upper += [np.maximum(P_hi / BAR, u_last - (k + 1) * step), [step] * NU]
        if k > 0:
            lower += [[-never, left, least, least]]
            upper += [[right, never, never, never]]
        return np.concatenate(lower), np.concatenate(upper)

    def point(self, motion: Motion, u_last: Array) -> Array:
        """Return the z of a `motion`, with the necessary slacks."""
        slacks = self.limits.excursion(motion.x[1:, 0]) / _S, self.limits.slackening(motion.F[1:]) / _S_F
        u = np.vstack([u_last, motion.u]) / BAR
        chi = np.hstack([motion.x / _X, u, np.tile(slacks, (self.N + 1, 1))])
        return np.append(np.hstack([chi[:-1], u[1:]]).ravel(), chi[-1])

    def commands(self, z: Array) -> Array:
        """Return u (N, 2) [Pa] of z."""
        return BAR * z[:-_CHI].reshape(self.N, _STAGE)[:, _CHI:]

    # --- its certificate --------------------------------------------------------------------------------------------

    @cached_property
    def _conditions(self) -> Buffered:
        """Function (z, p, λ) ↦ (f, g, gradient of f + λᵀg)."""
        import casadi as ca

        z, p, f, g = (self.problem[name] for name in "xpfg")
        multipliers = ca.SX.sym("lambda", g.numel())
        outputs = f, g, ca.densify(ca.gradient(f + ca.dot(multipliers, g), z))
        return Buffered(ca.Function("conditions", [z, p, multipliers], outputs))

    def certify(self, z: Array, multipliers: Array, given: Given) -> Residuals:
        """Return the residuals of z with `multipliers` of g: positive at an upper, negative at a lower bound."""
        f, g, gradient = map(np.ravel, self._conditions(z, given.p, multipliers))
        primal = np.maximum(given.lower - g, g - given.upper).max()
        bound = np.where(multipliers > 0, given.upper, given.lower)
        away = np.where(np.isfinite(bound), np.abs(bound - g), 1.0)  # a bound at infinity cannot push
        gap = np.abs(multipliers * away).sum() / max(1.0, abs(f.item()))
        return Residuals(float(primal), float(np.abs(gradient).max()), float(gap))

    def cost(self, z: Array, given: Given) -> float:
        """Return the cost of z."""
        return _COST * self._conditions(z, given.p, 0.0)[0].item()


def _given_to_stage(preview: "SX") -> list["SX"]:
    """Return d_k, x*_k, y*_k, u*_k and u*_{k-1} of a column of the previews."""
    import casadi as ca

    return ca.vertsplit(preview, np.cumsum([0, 1, NX, NY, NU, NU]).tolist())


def _state(chi: "SX") -> "SX":
    import casadi as ca

    return chi[:NX] * ca.DM(_X)


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
