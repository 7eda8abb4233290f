"""Allocation problem of two muscles.

At a joint angle θ, with targets T* and K*, over the pressures P = (P1, P2):

    minimise    w_T (T(θ, P) - T*)² + w_K (K(θ, P) - K*)² + ρ ‖P - P_ref‖²
    subject to  lo_i(θ) ≤ P_i ≤ hi_i(θ),  i = 1, 2                                                              [A]
                (P1 + P2)/2 ≥ P_co

Supply limits, min_force ≤ F_i ≤ max_force (bounds on P_i alone since force grows with pressure; min_force ≥ 0 keeps the
cables taut), the validity of the muscle models and the slew limits all are bounds on a single pressure: the box, see
`allocator.joint.antagonist.AntagonistJoint.box`. The co-contraction floor P_co, if any, cuts a corner off it. Angles
beyond the joint range are replaced by the nearest inside.

`priority` decides which target is given up if both cannot be met: "weighted" is [A] itself; "torque" is the limit w_T →
∞ (first the nearest torque, then among all pressures that give it the least w_K (K - K*)² + ρ ‖P - P_ref‖²) and
"stiffness" the opposite limit; the weight of the second goal is 1 there.

With a `stiffness_tolerance` all stiffnesses within K* ± tolerance are equally good, and the one with the least
pressures, hence the least air, is chosen. Along a torque level both pressures grow with the stiffness, so it is the
least stiffness: the target becomes K* - tolerance.

K is the isobaric stiffness, or with `shares` of the trapped gas that of (G5) in `allocator.joint.gas`. It is again a
sum of functions of single pressures, so all of the above holds. `felt` adds the hysteresis met by a push, (S3) in
`allocator.joint.felt`, which may couple both pressures, see `allocator.allocation.two_muscles.felt`. If it does not,
and the muscles are not affine, it is a `push` in the muscles' own stiffness and a constant `own`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from allocator.allocation.status import Priority
from allocator.calculus import Array, Mask
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.felt import Secant
from allocator.joint.gas import Shares
from allocator.joint.limits import TAUT, Limits, PressureBox
from allocator.joint.tondu_pulley import TonduPulley
from allocator.joint.torque_levels import BothMuscles, Pair
from allocator.search import Curves

_FAR = {"torque": 1e3, "stiffness": 1e3, "weighted": 1e6}
"""Greatest target, in multiples of the muscles' capacity: any greater number means "as much as possible".

The nearest torque or stiffness is the same for all unreachable targets; a weighted optimum depends on this factor.
"""


@dataclass(frozen=True)
class Problem:
    """n allocation problems [A] of one joint; all arrays have the shape (n,)."""

    joint: AntagonistJoint
    theta: Array  # joint angle within the joint range [rad]
    K: Array  # stiffness target [N·m/rad]
    T: Array  # torque target [N·m]
    priority: Priority = "torque"
    weights: tuple[float, float] = (1.0, 1.0)  # (w_T [cost]/[N·m]², w_K [cost]/[N·m/rad]²), for "weighted"
    limits: Limits = TAUT  # min_force, max_force, P_co, slew
    stiffness_tolerance: float = 0.0  # stiffnesses within this of the target are equally good [N·m/rad]
    pull: float = 0.0  # ρ [cost]/[Pa]²
    reference: Pair | None = None  # P_ref [Pa], with a pull
    shares: Pair | None = None  # s1, s2 of the trapped gas in the stiffness [-], None: it is isobaric
    felt: Secant | None = None  # hysteresis in the stiffness that couples both pressures, None for none
    push: tuple[float, float] | None = None  # (α, drag) of separable hysteresis, see `Secant.separable` …
    own: float = 0.0  # … and its stiffness that no pressure changes [N·m/rad]

    @cached_property
    def sides(self) -> BothMuscles:
        """Both muscles, held at the angles."""
        return self.sides_at(self.theta)

    def sides_at(self, theta: Array) -> BothMuscles:
        """Return both muscles, held at other angles (n,) [rad]."""
        one, two = self.joint.sides(theta, self.shares)
        return (one, two) if self.push is None else (replace(one, push=self.push), replace(two, push=self.push))

    @cached_property
    def box(self) -> PressureBox:
        """Pressures allowed by all limits."""
        return self.joint.box(self.theta, self.limits, self.shares)

    @cached_property
    def curves(self) -> Curves:
        """Both muscles at the angles, as numbers for the complete search."""
        return Curves.of(self.sides, self.box, self.joint.pressure_limits)

    @cached_property
    def box_without_forces(self) -> PressureBox:
        """Pressures allowed by all limits except those on forces."""
        return self.joint.box(self.theta, self.limits.without_forces, self.shares)

    @property
    def tondu_pulley(self) -> TonduPulley | None:
        """Closed forms of the report's joint, valid for its isobaric stiffness."""
        return self.joint.tondu_pulley if self.shares is None and self.felt is None and self.push is None else None

    @cached_property
    def T_aim(self) -> Array:
        """Torque aimed at: the target, or a smaller one if it is excessive."""
        return self._near(self.T, [side.torque for side in self.sides])

    @cached_property
    def K_aim(self) -> Array:
        """Stiffness aimed at: the least one within the tolerance, or a smaller one if it is excessive."""
        return self._near(self.K, [side.stiffness for side in self.sides], self._hysteresis) - self.stiffness_tolerance

    def of_muscles(self, K: Array) -> Array:
        """Return the part of stiffnesses K (n,) that the muscles have to supply, which their `curves` take."""
        return K - self.own

    def _near(
        self,
        target: Array,
        added: list[Callable[[Array], Array]],
        further: Callable[[Array, Array], Array | float] = lambda P1, P2: 0.0,
    ) -> Array:
        """Clip `target` to a multiple of the muscles' contribution at the joint's greatest pressures."""
        supply, muscles = self.joint.pressure_limits[1], (self.joint.agonist, self.joint.antagonist)
        most = [np.full(self.theta.shape, min(supply, muscle.max_pressure)) for muscle in muscles]
        reach = sum(np.abs(add(P)) for add, P in zip(added, most, strict=True)) + np.abs(further(*most))
        reach = _FAR[self.priority] * reach
        return np.asarray(np.clip(target, -reach, reach))

    @property
    def P_ref(self) -> Pair:
        """Reference pressures; without a pull they do not matter."""
        return (np.zeros(()), np.zeros(())) if self.reference is None else self.reference

    def errors(self, P1: Array, P2: Array) -> Pair:
        """Return (T - T_aim, K - K_aim) at pressures (…, n)."""
        T, K = self.given(P1, P2)
        return T - self.T_aim, K - self.K_aim

    def given(self, P1: Array, P2: Array) -> Pair:
        """Return the torque and the stiffness (T, K) at pressures (…, n)."""
        return self.sides[0].torque(P1) + self.sides[1].torque(P2), self.stiffness(P1, P2)

    def stiffness(self, P1: Array, P2: Array) -> Array:
        """Return the stiffness K [N·m/rad] at pressures (…, n)."""
        return np.asarray(self.sides[0].stiffness(P1) + self.sides[1].stiffness(P2) + self._hysteresis(P1, P2))

    def stiffness_slopes(self, P1: Array, P2: Array) -> Pair:
        """Return ∂K/∂P1 and ∂K/∂P2 [N·m/rad/Pa]; from below at a kink of the hysteresis."""
        one, two = self.sides
        k1, k2 = one.stiffness_gain(P1), two.stiffness_gain(P2)
        if self.felt is None:
            return k1, k2
        a, b, drag = one.isobaric, two.isobaric, self.felt.drag
        share, slope, own = self.felt.affine_at(P1 + P2)
        K = a.stiffness(P1) + b.stiffness(P2)
        return (
            k1 + a.stiffness_gain(P1) * share + K * slope + own + drag * one.torque_gain(P1),
            k2 + b.stiffness_gain(P2) * share + K * slope + own - drag * two.torque_gain(P2),
        )

    def _hysteresis(self, P1: Array, P2: Array) -> Array | float:
        """Return the contribution of hysteresis to the stiffness [N·m/rad]   (S1), (S2)"""
        if self.felt is None:
            return self.own
        one, two = self.sides
        K = one.isobaric.stiffness(P1) + two.isobaric.stiffness(P2)
        return np.asarray(self.felt.added(K, one.torque(P1) - two.torque(P2), P1 + P2))

    def pull_cost(self, P1: Array, P2: Array) -> Array:
        """Return ρ ‖P - P_ref‖² at pressures (…, n)."""
        R1, R2 = self.P_ref
        return np.asarray(self.pull * ((P1 - R1) ** 2 + (P2 - R2) ** 2))

    @cached_property
    def scales(self) -> Pair:
        """Scale of large torques and stiffnesses: both muscles' absolute values at their upper bounds."""
        one, two = self.sides
        hi1, hi2 = self.box.agonist.hi, self.box.antagonist.hi
        return (
            np.abs(one.torque(hi1)) + np.abs(two.torque(hi2)) + np.abs(self.T_aim),
            np.abs(one.stiffness(hi1))
            + np.abs(two.stiffness(hi2))
            + np.abs(self._hysteresis(hi1, hi2))
            + np.abs(self.K_aim),
        )

    def take(self, where: Mask | NDArray[np.intp]) -> Self:
        """Return the problems at the mask or the indices `where`."""
        theta, K, T = self.theta[where], self.K[where], self.T[where]
        reference, shares = (None if p is None else (p[0][where], p[1][where]) for p in (self.reference, self.shares))
        limits = self.limits.take(where)
        return replace(self, theta=theta, K=K, T=T, limits=limits, reference=reference, shares=shares)

    def with_shares(self, shares: Shares | None) -> Self:
        """Return the problems of another stiffness, with numbers as shares of the gas, or None."""
        if shares is None:
            return replace(self, shares=None)
        one, two = (np.full(self.theta.shape, float(s)) for s in shares)
        return replace(self, shares=(one, two))

    def at(self, theta: Array) -> Self:
        """Return the problems with other angles `theta` (n,) [rad]."""
        return replace(self, theta=theta)
