"""Answer for a pair of muscles, in floats and arrays."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.arguments import problem_from
from allocator.allocation.result import Allocation
from allocator.allocation.status import CLOSED_FORM, OPTIMISER, Priority, Status, status_names
from allocator.allocation.two_muscles import certificate, reach, sensitivity
from allocator.allocation.two_muscles.problem import Problem
from allocator.allocation.uncertain.spread import Spread, of_joint
from allocator.calculus import Array, Mask, Value
from allocator.closed_form import why_no_inverse
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.assumption import assumptions
from allocator.joint.gas import HELD, StiffnessKind, Valves
from allocator.joint.limits import Limits, names
from allocator.joint.one_muscle import OneMuscle
from allocator.joint.torque_levels import Pair, torque_interval
from allocator.presentation.tables import html_table, number, span
from allocator.units import BAR, DEG

_STATUS = tuple(Status)


@dataclass(frozen=True, eq=False)
class PairAllocation(Allocation):
    """The `Allocation` of a joint: floats for scalars, else arrays of the targets' shape."""

    theta: Value  # requested joint angle [rad]
    T_target: Value  # requested torque [N·m]
    K_target: Value  # requested stiffness [N·m/rad]
    P1: Value  # agonist pressure [Pa]
    P2: Value  # antagonist pressure [Pa]
    T: Value  # achieved torque [N·m]
    K: Value  # achieved stiffness [N·m/rad], of the requested kind
    status: Any  # Status, or an array of its integers
    limits: int | NDArray[np.int32]  # combination of Limit flags that bind, as integers
    joint: AntagonistJoint = field(repr=False)
    priority: Priority
    _within: Limits = field(repr=False)  # the requested limits
    kind: StiffnessKind = HELD  # kind of `K_target` and `K`: isobaric, shut, …
    method: str = "exact"
    iterations: int | NDArray[np.int32] | None = None  # of an optimising method
    _gap: Value = field(default=0.0, repr=False)  # `gap` if the method has proved one, else None
    _built: Problem | None = field(default=None, repr=False)  # None: no other arguments; made on demand
    _shape: tuple[int, ...] = field(default=(), repr=False)  # of the targets

    @cached_property
    def _problem(self) -> Problem:
        if self._built is not None:
            return self._built
        targets = map(np.ravel, (self.theta, self.K_target, self.T_target))  # flat, as the limits are
        asked: dict[str, Any] = {"limits": self._within, "priority": self.priority, "shares": self.kind.fixed}
        asked["felt"] = self.kind.secant(self.joint.loop) if self.kind.amplitude is not None else None
        return problem_from(self.joint, *targets, **asked)[0]

    @property
    def valves(self) -> tuple[bool | Mask, bool | Mask]:
        """Whether the valves of (agonist, antagonist) are shut while the joint has the stiffness `K`.

        Two truth values, or arrays of them; regulated valves (with a `frequency`) count as open.
        """
        shares = self._problem.shares
        if shares is None or self.kind.frequency is not None:
            shares = (np.zeros(self._problem.theta.shape),) * 2
        one, two = (self._formed(np.asarray(s == 1)) for s in shares)
        return one, two

    @cached_property
    def P(self) -> Array:
        """Pressures of agonist and antagonist (…, 2) [Pa]."""
        return np.stack([self.P1, self.P2], axis=-1)

    @property
    def q(self) -> Value:
        """Angle solved for [rad]: the requested one, within the joint's range."""
        return self._formed(self._problem.theta)

    @property
    def _muscles(self) -> Sequence[OneMuscle]:
        return self._problem.sides

    @property
    def box(self) -> tuple[Array, Array]:
        """Least and greatest pressures (…, 2) [Pa] that the limits leave."""
        one, two = self._problem.box
        return self._array(np.stack([one.lo, two.lo], axis=-1)), self._array(np.stack([one.hi, two.hi], axis=-1))

    @property
    def torque_met(self) -> Any:
        """Whether the torque is met."""
        return self._near(self.T_error, self._problem.scales[0], 0.0)

    @property
    def stiffness_met(self) -> Any:
        """Whether the stiffness is met, up to the tolerance."""
        return self._near(self.K_error, self._problem.scales[1], self._problem.stiffness_tolerance)

    def _near(self, error: Value, scale: Array, tolerance: float) -> Any:
        met = (CLOSED_FORM if self.method == "exact" else OPTIMISER).met
        return self._formed(np.abs(np.ravel(error)) <= tolerance + met * scale)

    def felt_stiffness(self, amplitude: float, valves: Valves = "open") -> Value:
        """Return the stiffness [N·m/rad] against pushes by ±`amplitude` [rad], `AntagonistJoint.stiffness`   (S3)"""
        at = self._problem.theta, np.ravel(self.P1), np.ravel(self.P2)
        return self._formed(np.asarray(self.joint.stiffness(*at, valves, amplitude=amplitude)))

    @property
    def holds(self) -> Any:
        """Whether the joint is stable: K > 0."""
        return self.K > 0

    @property
    def least_stiffness(self) -> Value:
        """K [N·m/rad], the only eigenvalue."""
        return self.K

    @property
    def assumed(self) -> str:
        """Sentence listing the assumptions behind the answer that the data could not confirm, or "".

        Equilibria of some joints do not reveal a force common to both muscles: the pressures at which cables go slack
        are then assumed. A muscle fitted to forces is extrapolated beyond the contractions and pressures measured.
        """
        theta = np.clip(np.ravel(self.theta), *self.joint.angle_range)  # the angle of the pressures
        return assumptions(self.joint, theta, np.ravel(self.P1), np.ravel(self.P2))

    @property
    def active(self) -> Any:
        """Names of the limits that bind: "P1 upper", "agonist slack", …; a tuple, or an array of tuples.

        A limit binds where the pressure lies on it, up to 1e-9 of the supply range; all limits at one pressure bind,
        since relaxing only one does not help. Supply and validity of the model count as one limit, the lower.
        """
        return self._listed(map(names, np.ravel(self.limits)))

    @property
    def broken(self) -> Any:
        """Names of the violated limits, if the slew limit or others allow no pressure that keeps them.

        Method "analytic" ignores limits: all that its answer violates. A tuple, or an array of tuples.
        """
        near = CLOSED_FORM.binds if self.method in ("exact", "analytic") else OPTIMISER.binds
        near *= self._problem.joint.pressure_span
        return self._listed(map(names, self._problem.box.not_kept(np.ravel(self.P1), np.ravel(self.P2), near)))

    @cached_property
    def torque_interval(self) -> Pair:
        """(T_min, T_max) [N·m] within reach at the angle."""
        return self._shaped(*torque_interval(self._problem.sides, self._problem.box))

    @cached_property
    def stiffness_interval(self) -> Pair:
        """(K_min, K_max) [N·m/rad] within reach at the angle with the achieved torque; NaN for no answer.

        Of the requested kind of stiffness, with the present state of the valves.
        """
        return self._shaped(*reach.stiffness_interval(self._problem, np.ravel(self.T)))

    @cached_property
    def torque_intervals(self) -> Array:
        """Intervals (T_min, T_max) [N·m] within reach at the angle with the achieved stiffness: (…, m, 2).

        A union of m intervals at most, NaN where a target has fewer; m is 1 for affine muscles and on the report's
        joint.
        """
        found = reach.torque_intervals(self._problem, np.ravel(self.K))
        return found.reshape(*self._shape, *found.shape[1:])

    @cached_property
    def gap(self) -> Value:
        """Proven bound on the improvement by any other answer; 0 for closed forms.

        A fraction of the scale of the missed goal, or of the weighted cost with both at their scales. Searches (muscles
        not affine) prove about 1e-13. For an optimising method it is the excess over the bound of "exact". NaN without
        a proof: methods "analytic" and "uncertain", and a pull on muscles that are not affine.
        """
        if self._gap is not None:
            return self._gap
        return self._formed(certificate.gap(self._problem, np.ravel(self.P1), np.ravel(self.P2)))

    @cached_property
    def pairs(self) -> Any:
        """Number of pairs of pressures within the limits with this torque and stiffness: 1, on levers also more.

        The answer is the least of them, or with `previous` the nearest to it; see `along` of `allocate`.
        """
        return self._formed(reach.pairs(self._problem, np.ravel(self.T), np.ravel(self.K)))

    @cached_property
    def kkt_residual(self) -> Value:
        """Step that would still improve the answer, in fractions of the supply range; 0 is optimal."""
        return self._formed(certificate.residual(self._problem, np.ravel(self.P1), np.ravel(self.P2)))

    @property
    def _spread(self) -> Spread | None:
        return of_joint(self._problem, np.ravel(self.P1), np.ravel(self.P2))

    @property
    def torques(self) -> tuple[Array, Array]:
        """Torques of agonist (a1 F1) and antagonist (-a2 F2), in one row [N·m]."""
        one, two = self._problem.sides
        return one.torque(np.ravel(self.P1)), two.torque(np.ravel(self.P2))

    def jacobian(self) -> Array:
        """Return dP/d(θ, K, T), shape (…, 2, 3) [Pa/rad, Pa·rad/(N·m), Pa/(N·m)], with the active set held.

        One-sided where the active set is about to change; NaN without an answer, and where the stiffness turns (on some
        levers), because the equations are singular. Raises InvalidInput for answers under uncertainty.
        """
        if self.method == "uncertain":
            raise InvalidInput("jacobian() holds for allocations without uncertainty")
        dP = sensitivity.jacobian(self._problem, np.ravel(self.P1), np.ravel(self.P2))
        inside = np.ravel(self.theta) == self._problem.theta
        dP[~inside, :, 0] = 0.0  # beyond the joint range the answer is constant
        return dP.reshape(*self._shape, 2, 3)

    @property
    def _details(self) -> list[str]:
        found = _DETAILS.get(Status(self.status))
        return [] if found is None else [found(self)]

    def to_dict(self) -> dict[str, object]:
        """Return the answer as columns of a table for `pandas.DataFrame`, units in their names.

        Of arrays every column is one row (n,), the targets in C order; of a single target every value is a scalar, and
        the dictionary one row: ``DataFrame([a.to_dict()])``. Status and binding limits are given by their names.
        """
        columns = {
            "theta_deg": self.theta / DEG,
            "stiffness_target_Nm_per_rad": self.K_target,
            "torque_target_Nm": self.T_target,
            "P1_bar": self.P1 / BAR,
            "P2_bar": self.P2 / BAR,
            "stiffness_Nm_per_rad": self.K,
            "torque_Nm": self.T,
        }
        assumed = {"assumed": self.assumed} if self.assumed else {}
        columns |= self._gas_columns()
        if not self._shape:
            return columns | {"status": Status(self.status).name, "limits": " + ".join(self.active)} | assumed
        flags, which = np.unique(np.ravel(self.limits), return_inverse=True)
        return {name: np.ravel(column) for name, column in columns.items()} | {
            "status": status_names(np.ravel(self.status)),
            "limits": np.array([" + ".join(names(int(value))) for value in flags], str)[which],
            **{name: np.full(which.size, text) for name, text in assumed.items()},
        }

    def _gas_columns(self) -> dict[str, Value]:
        """Return the additional columns for stiffnesses other than isobaric."""
        if self.kind.isobaric:
            return {}
        names = ("isobaric_stiffness_Nm_per_rad", "agonist_valve_shut", "antagonist_valve_shut")
        return dict(zip(names, (self.isobaric_stiffness, *self.valves), strict=True))

    def __repr__(self) -> str:
        """Show the pressures, the achieved values and the limits in the way; of arrays their ranges."""
        P1, P2 = np.divide(self.P1, BAR), np.divide(self.P2, BAR)
        if self._shape:
            angles = span(np.divide(self.theta, DEG), "°")
            return f"Allocation {self._shape}, {self.message}\n  θ {angles}, P1 {span(P1, 'bar')}, P2 {span(P2, 'bar')}"
        lines = [
            f"Allocation {Status(self.status).name} at {number(self.theta / DEG)}°: "
            f"P1 = {number(P1)} bar, P2 = {number(P2)} bar",
            f"  torque {number(self.T)} N·m (asked {number(self.T_target)}), "
            f"{self.stiffness_name} {number(self.K)} N·m/rad (asked {number(self.K_target)})",
        ]
        return "\n".join([*lines, f"  {self.message}"] if self.status != Status.EXACT or self.assumed else lines)

    def _repr_html_(self) -> str:
        """Return the answer as a table, for notebooks."""
        quantities = (
            ("angle [°]", np.divide(self.theta, DEG), None),
            ("torque [N·m]", self.T, self.T_target),
            (f"{self.stiffness_name} [N·m/rad]", self.K, self.K_target),
            ("P1 [bar]", np.divide(self.P1, BAR), None),
            ("P2 [bar]", np.divide(self.P2, BAR), None),
        )
        show = span if self._shape else number
        rows = [(name, "" if asked is None else show(asked), show(given)) for name, given, asked in quantities]
        return html_table(self.message, rows, ("", "asked", "given"))

    @property
    def stiffness_name(self) -> str:
        """Name of the kind of stiffness, with the valves of the answer if they were free: "shut stiffness", …"""
        if self.kind.shares is not None:
            return self.kind.text
        state = StiffnessKind.of("open" if self._shape else tuple(map(bool, self.valves)))
        return self.kind.text if self._shape else replace(state, amplitude=self.kind.amplitude).text

    def _shaped(self, first: Array, second: Array) -> Pair:
        return self._formed(first), self._formed(second)


def single(
    joint: AntagonistJoint,
    priority: Priority,
    limits: Limits,
    theta: float,
    K: float,
    T: float,
    found: tuple[Value, ...],
    kind: StiffnessKind = HELD,
) -> PairAllocation:
    """Return the answer for one target from the results `found`: P1, P2, torque, stiffness, status, binding limits."""
    P1, P2, T_given, K_given, status, flags, _ = found
    allocation = object.__new__(PairAllocation)  # as `from_fields`, without the call
    fields = {
        "theta": theta,
        "T_target": T,
        "K_target": K,
        "P1": P1,
        "P2": P2,
        "T": T_given,
        "K": K_given,
        "status": _STATUS[status],
        "limits": flags,
        "joint": joint,
        "priority": priority,
        "_within": limits,
        "kind": kind,
    }
    object.__setattr__(allocation, "__dict__", fields)
    return allocation


# --- errors of one target, in words -----------------------------------------------------------------------------------


def _at(a: PairAllocation) -> str:
    return f"{a.theta / DEG:.4g}°"


def _torque(a: PairAllocation) -> str:
    """Return the feasible torques: all, or those with the achieved stiffness if that is in the way."""
    T_min, T_max = a.torque_interval
    if a.priority != "stiffness" and not T_min <= a.T_target <= T_max:
        return f"torque at {_at(a)} is {T_min:.4g} … {T_max:.4g} N·m, asked {a.T_target:.4g}"
    found = a.torque_intervals
    listed = " or ".join(f"{low:.4g} … {high:.4g}" for low, high in found[~np.isnan(found[:, 0])])
    return f"torque at {_at(a)} and {number(a.K)} N·m/rad is {listed} N·m, asked {a.T_target:.4g}"


def _stiffness(a: PairAllocation) -> str:
    K_min, K_max = a.stiffness_interval
    name = a.stiffness_name
    return f"{name} at {_at(a)} and {number(a.T)} N·m is {K_min:.4g} … {K_max:.4g} N·m/rad, asked {a.K_target:.4g}"


def _both(a: PairAllocation) -> str:
    return f"{_torque(a)}; stiffness given {a.K:.4g} N·m/rad, asked {a.K_target:.4g}"


def _pulled(a: PairAllocation) -> str:
    asked = f"asked {a.T_target:.4g} N·m and {a.K_target:.4g} N·m/rad"
    return f"{asked}, given {number(a.T)} and {number(a.K)}"


def _slack(a: PairAllocation) -> str:
    one, two = map(number, a.forces)
    return f"at {_at(a)} the forces are {one} N and {two} N"


def _outside(a: PairAllocation) -> str:
    left, right = (f"{end / DEG:.4g}°" for end in a.joint.angle_range)
    return f"range {left} … {right}, asked {_at(a)}"


_DETAILS: dict[Status, Callable[[PairAllocation], str]] = {
    Status.TORQUE_LIMITED: _torque,
    Status.STIFFNESS_LIMITED: _stiffness,
    Status.BOTH_LIMITED: _both,
    Status.PULLED: _pulled,
    Status.CONFLICT: lambda a: f"at {_at(a)}",
    Status.SLACK: _slack,
    Status.OUTSIDE_JOINT_RANGE: _outside,
    Status.OUTSIDE_LIMITS: lambda a: f"P1 = {a.P1 / BAR:.4g} bar, P2 = {a.P2 / BAR:.4g} bar",
    Status.NO_INVERSE: lambda a: why_no_inverse(a.joint, a.kind.isobaric),
}
