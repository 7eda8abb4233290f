"""Answer for a mechanism: pressures of all muscles, levels of goals, and the proof."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.box import certificate
from allocator.allocation.box.certificate import Separation, Verdict
from allocator.allocation.box.pivoting import residuals
from allocator.allocation.box.problem import BoxProblem
from allocator.allocation.box.sensitivity import jacobian
from allocator.allocation.relaxation import Nearby
from allocator.allocation.result import Allocation, as_status, from_fields, shaped
from allocator.allocation.status import CLOSED_FORM, Status, status_names
from allocator.allocation.uncertain.spread import Spread, of_mechanism
from allocator.calculus import Array, Mask, Value
from allocator.errors import InvalidInput
from allocator.joint.gas import StiffnessKind
from allocator.joint.limits import Limit
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.endpoint.targets import EndpointTargets
from allocator.mechanism.mechanism import Mechanism
from allocator.presentation.tables import number
from allocator.units import BAR, DEG

_PROVED = 1e-9  # a smaller gap is rounding
_NAMES = {  # `OneMuscle.interval` gives every muscle the flags of an agonist
    Limit.P1_LOWER: "lower",
    Limit.P1_UPPER: "upper",
    Limit.AGONIST_SLACK: "slack",
    Limit.P1_RATE: "rate",
    Limit.AGONIST_VALIDITY: "model validity",
    Limit.AGONIST_FORCE: "force ceiling",
}


def limit_names(muscle: str, flags: int) -> tuple[str, ...]:
    """Return the names of the limits of a muscle that are among the `flags`: "muscle 1 upper", …"""
    return tuple(f"{muscle} {_NAMES[limit]}" for limit in Limit(flags))


@dataclass(frozen=True, eq=False)
class _Judged:
    """Pressures that a method found for a problem, and its tolerance `gap` of their costs."""

    problem: BoxProblem
    found: Nearby
    P: Array  # (N, m) [Pa]
    gap: float

    def field(self, name: str, allocation: "BoxAllocation") -> Any:
        """Return the field `name` of the `allocation` with these pressures."""
        shape, n = allocation._shape, self.problem.mechanism.n
        match name:
            case "T":
                return shaped(self._given[:, :n].copy(), shape)
            case "K":
                return shaped(self._stiffness, shape)
            case "status":
                return as_status(self._verdict.status, shape)
            case "torque_met" | "stiffness_met" | "holds":
                return shaped(getattr(self._verdict, name), shape)
            case "kkt_residual":
                return shaped(self._residual, shape)
            case "rounds":
                return shaped(self.found.solved.rounds, shape)
            case "gap":
                return shaped(self.found.left, shape)
            case _:
                return shaped(self.found.bounds, shape)

    @cached_property
    def _given(self) -> Array:
        return self.problem.given(self.P)

    @cached_property
    def _stiffness(self) -> Array:
        return self.problem.joint_stiffness(self.P)

    @cached_property
    def _residual(self) -> Array:
        known = self.found.residual
        return residuals(self.problem, self.found.solved) if known is None else known

    @cached_property
    def _verdict(self) -> Verdict:
        affine, left = self.problem.mechanism.affine, self.found.left
        residual = self._residual if affine else np.where(left <= self.gap, 0.0, np.inf)
        return certificate.decide(self.problem, self._given, self._stiffness, residual)


@dataclass(frozen=True, eq=False)
class BoxAllocation(Allocation):
    """`Allocation` of m muscles, for targets of any leading shape (…); one target has none."""

    P: Array  # pressures (…, m) [Pa]
    T: Array  # achieved torques (…, n) [N·m]
    K: Array  # achieved stiffness (…, n, n) [N·m/rad]
    status: Any  # Status, or an array (…) of its integers
    torque_met: bool | Mask  # (…) whether the torques are met
    stiffness_met: bool | Mask  # (…) whether the stiffness is met; free entries do not count
    holds: bool | Mask  # (…) whether K is positive definite: the posture is stable
    kkt_residual: Value  # (…) of optimality, in fractions of its scale; 0 is optimal (not affine: locally)
    rounds: int | NDArray[np.int64]  # (…) guesses of the pivoting; nodes of the search if muscles are not affine
    gap: Value  # (…) greatest excess of a level's cost over the least, of 1 + cost; 0 proves the least
    lower_bounds: Array  # (…, levels) [cost]: no pressures have less, given the costs of earlier levels
    method: str
    _problem: BoxProblem = field(repr=False)
    _mu: Array = field(repr=False)
    _shape: tuple[int, ...] = field(repr=False)

    @classmethod
    def of(cls, problem: BoxProblem, found: Nearby, shape: tuple[int, ...], method: str, gap: float = 0.0) -> Self:
        """Return the answer for the pressures that `method` found for targets of this `shape`.

        The other fields are computed on first access: of many targets, the proof takes a third of the time.
        """
        P = problem.pressures(found.solved.x)
        known = {"P": shaped(P, shape), "method": method, "_problem": problem, "_mu": found.solved.mu, "_shape": shape}
        made: Self = from_fields(cls, known | {"_later": _Judged(problem, found, P, gap)})
        return made

    if not TYPE_CHECKING:

        def __getattr__(self, name):
            """Compute a deferred field, see `of` and `allocator.allocation.box.ready`."""
            later = self.__dict__.get("_later")
            if later is None or name not in self.__dataclass_fields__:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            made = self.__dict__[name] = later.field(name, self)
            return made

    @property
    def mechanism(self) -> Mechanism:
        """Mechanism."""
        return self._problem.mechanism

    @property
    def kind(self) -> StiffnessKind:
        """Kind of the stiffness `K`: isobaric, shut, …"""
        return self._problem.kind

    @property
    def q(self) -> Array:
        """Postures solved for (…, n) [rad]: the requested ones, within the joints' range."""
        return self._array(self._problem.q)

    @property
    def _muscles(self) -> tuple[OneMuscle, ...]:
        return self._problem.muscles

    @property
    def _spread(self) -> Spread | None:
        return of_mechanism(self._muscles, [P for _, P in self._pulling])

    @property
    def theta(self) -> Array:
        """Requested postures (…, n) [rad]."""
        return self._array(self._problem.asked)

    @property
    def T_target(self) -> Array:
        """Requested torques (…, n) [N·m]."""
        return self._array(self._problem.y[:, : self.mechanism.n])

    @property
    def K_target(self) -> Array:
        """Requested stiffness (…, n, n) [N·m/rad]; NaN for free entries.

        All are NaN for an endpoint: see `K_x_error`.
        """
        n = self.mechanism.n
        if self._problem.endpoint is not None:
            return np.full(self.K.shape, np.nan)
        asked = np.where(self._problem.weights[n:] > 0, self._problem.y[:, n:], np.nan)
        return self._array(self.mechanism.whole(asked))

    @property
    def P1(self) -> Value:
        """Agonist's pressure [Pa], of two muscles. Raises `InvalidInput` for more."""
        return self._of_a_pair(0)

    @property
    def P2(self) -> Value:
        """Antagonist's pressure [Pa], of two muscles. Raises `InvalidInput` for more."""
        return self._of_a_pair(1)

    def _of_a_pair(self, i: int) -> Value:
        if self.mechanism.m != 2:
            raise InvalidInput(f"P1 and P2 are of a pair; this mechanism has m = {self.mechanism.m} muscles, see P")
        return self.P[..., i]

    @property
    def costs(self) -> Array:
        """Weighted squared errors of the levels (…, levels) [cost], in the order of the priority."""
        problem, (rows, ends) = self._problem, self._problem.rows
        squares = problem.weights * (problem.given(self.P.reshape(-1, self.mechanism.m)) - problem.y) ** 2
        squares = np.pad(squares, ((0, 0), (0, problem.row_weights.size - problem.weights.size)))[:, rows]
        return self._array(np.add.reduceat(squares, [0, *ends[:-1].tolist()], axis=1))

    @property
    def least_stiffness(self) -> Value:
        """Least eigenvalue of K (…) [N·m/rad]; a posture is stable if it is positive."""
        return self._formed(np.linalg.eigvalsh(self.K)[..., 0].ravel())

    # --- at the endpoint --------------------------------------------------------------------------------------------

    @property
    def endpoint(self) -> Endpoint | None:
        """Endpoint of the requested stiffness, or None."""
        return None if self._problem.endpoint is None else self._problem.endpoint.endpoint

    @property
    def x(self) -> Array:
        """Position of the endpoint (…, dim) [m]. Raises `InvalidInput` without one."""
        return self._array(self._hand.place.position)

    @cached_property
    def K_x(self) -> Array:
        """Endpoint's stiffness under its force (…, dim, dim) [N/m]. Raises `InvalidInput` without one."""
        return self._array(self._hand.stiffness(self.K.reshape(-1, *self.K.shape[-2:])))

    @property
    def K_x_error(self) -> Array:
        """Endpoint's stiffness, requested minus achieved (…, dim, dim) [N/m]; NaN for free entries."""
        free = self._problem.weights[self.mechanism.n :] == 0
        dim = self._hand.endpoint.dim
        asked = np.array(np.broadcast_to(self._hand.asked, (self._problem.size, dim, dim)))
        rows, columns = (index[free] for index in np.triu_indices(dim))
        asked[:, rows, columns] = asked[:, columns, rows] = np.nan
        return self._array(asked) - self.K_x

    @property
    def endpoint_error(self) -> Value:
        """‖K_x*^(-1/2) (K_x - K_x*) K_x*^(-1/2)‖_F (…) [-], over the requested entries."""
        n = self.mechanism.n
        given = self._hand.seen(self.K.reshape(-1, *self.K.shape[-2:]))
        twice = 2.0 - np.eye(self._hand.endpoint.dim)[np.triu_indices(self._hand.endpoint.dim)]
        error = np.sqrt(((given - self._problem.y[:, n:]) ** 2) @ (twice * (self._problem.weights[n:] > 0)))
        return self._formed(error)

    @property
    def _hand(self) -> EndpointTargets:
        if self._problem.endpoint is None:
            raise InvalidInput("no endpoint was given to `allocate`; its stiffness is not known")
        return self._problem.endpoint

    # --- proofs -------------------------------------------------------------------------------------------------------

    @cached_property
    def separation(self) -> Separation:
        """Return, for targets beyond reach, a direction d that proves it: reach = max d·y(P) < asked = d·y*.

        Check it with `y0, M = mechanism.targets_map(q)` and the box: d·y0 + Σ_j max(d·M_j lo_j, d·M_j hi_j). For
        muscles that are not affine, d·y(P) is a sum of functions of one pressure each. If no d separates their targets
        it is NaN, and `lower_bounds` is the proof.
        """
        return Separation(*map(self._formed, certificate.separation(self._problem, self._mu)))

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest pressures (…, m) [Pa] that the limits leave."""
        lo, hi = map(self._formed, self._problem.bounds)
        return lo, hi

    @cached_property
    def active(self) -> Any:
        """Names of the limits that bind: "muscle 1 upper", "muscle 2 slack", "joint 1 range", …

        A tuple, or an array (…) of tuples. A limit binds where the pressure lies on it, up to 1e-9 of the supply range.
        """
        ends = (
            (self.mechanism.joint_names, "range", self._problem.outside),
            (self.mechanism.muscle_names, "contraction threshold", self._problem.stretched),
        )
        return self._named(lambda side, P, near: side.binding(P, near), ends)

    def _named(self, flagged: Callable[..., Array], more: Sequence[tuple[tuple[str, ...], str, Mask]] = ()) -> Any:
        """Return the names of each muscle's limits by `flagged`, and of `more` limits."""
        names: list[tuple[str, ...]] = [()] * self._problem.size
        near = CLOSED_FORM.binds * self.mechanism.pressure_span
        for (muscle, P), side in zip(self._pulling, self._problem.box, strict=True):
            flags = np.broadcast_to(flagged(side, P, near), len(names))
            for i in np.flatnonzero(flags):
                names[i] += limit_names(muscle.name, int(flags[i]))
        for kinds, end, which in more:
            for i, j in zip(*np.nonzero(np.broadcast_to(which, (len(names), len(kinds)))), strict=True):
                names[i] += (f"{kinds[j]} {end}",)
        return self._listed(names)

    @property
    def broken(self) -> Any:
        """Names of the violated limits, if the slew limit or others allow no pressure that keeps them."""
        return self._named(lambda side, P, near: side.not_kept(P, near))

    def jacobian(self) -> Array:
        """Return dP/d(q, K, T) (…, m, n + n(n+1)/2 + n), of K the upper triangle, with the active set held.

        In [Pa/rad, Pa·rad/(N·m), Pa/(N·m)]; one-sided where the active set is about to change. Raises `InvalidInput`
        for muscles that are not affine in the pressure, and for the stiffness of an endpoint.
        """
        return self._array(jacobian(self._problem, self.P.reshape(-1, self.mechanism.m)))

    @property
    def _details(self) -> list[str]:
        missed = [] if self.torque_met else [f"asked {vector(self.T + self.T_error)}, given {vector(self.T)} N·m"]
        if not self.stiffness_met and self.endpoint is not None:
            missed.append(f"asked {vector(self.K_x + self.K_x_error)}, given {vector(self.K_x)} N/m at the endpoint")
        elif not self.stiffness_met:
            missed.append(f"asked {vector(self.K + self.K_error)}, given {vector(self.K)} N·m/rad")
        if self.endpoint is not None and self.mechanism.affine and self.gap > _PROVED:
            missed.append(
                "a local optimum, which does not exclude a nearer one: there are more joints than coordinates"
            )
        if not self.holds:
            missed.append(f"the least eigenvalue of K is {number(self.least_stiffness)} N·m/rad")
        return missed

    def to_dict(self) -> dict[str, object]:
        """Return the answer by name, units in the names: pressures, achieved values, status and binding limits."""
        hand = {} if self.endpoint is None else {"position_m": self.x, "endpoint_stiffness_N_per_m": self.K_x}
        return hand | {
            "posture_deg": np.divide(self.q, DEG),
            "P_bar": self.P / BAR,
            "torque_Nm": self.T,
            "stiffness_Nm_per_rad": self.K,
            "status": Status(self.status).name if not self._shape else status_names(self.status),
            "limits": self.active,
            **({"assumed": self.assumed} if self.assumed else {}),
            **({} if self.kind.isobaric else {"isobaric_stiffness_Nm_per_rad": self.isobaric_stiffness}),
        }

    def __repr__(self) -> str:
        """Show pressures, torques, stiffness and the limits in the way; of several targets the statuses."""
        if self._shape:
            return f"Allocation {self._shape}, {self.message}"
        lines = [
            f"Allocation {Status(self.status).name}: P = {vector(self.P / BAR)} bar",
            f"  torques {vector(self.T)} N·m, {self.kind.text} {vector(self.K)} N·m/rad",
        ]
        lines += [] if self.endpoint is None else [f"  stiffness {vector(self.K_x)} N/m at the endpoint"]
        return "\n".join([*lines, f"  {self.message}"] if self.assumed or not self.success else lines)


def vector(values: Array) -> str:
    """Return a vector or a matrix in a line; NaN entries are shown as free."""
    if np.ndim(values) > 1:
        return f"[{', '.join(map(vector, values))}]"
    return f"[{', '.join('free' if np.isnan(value) else number(value) for value in values)}]"
