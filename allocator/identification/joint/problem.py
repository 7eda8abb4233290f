"""Least-squares problem of a joint's fit: the output error of the angle.

The muscles F1 = F(P1, ε1; p) and F2 = ρ F(P2, ε2; p) balance the torque T and friction in the direction of motion s:

    G(θ) = (1 - μ s) a1 F1 - (1 + μ s) a2 F2 - T - T_g(θ) = 0    equilibrium, friction as in `friction_torque`

    minimise  Σ (θ_i - z - θ_eq,i)²  +  w² Σ max(0, η - F_i/F̄)²        over p, log ρ, z, μ within bounds

z is the encoder's zero, T_g the link's gravity: known, or A sin θ - B cos θ with unknown A and B, else 0. By the
implicit function theorem ∂θ_eq/∂p = (∂G/∂p)/K_s, with K_s = -∂G/∂θ. The second sum keeps the muscles taut: every force
at least the share η of the mean force F̄. Without weights, T = T_g = 0, the force scale is not an unknown: one more
equation, mean ∂F/∂P = 10 cm², sets it by convention.

A force common to both muscles, a1 ΔF1 = a2 ΔF2 at all angles, moves no angle. Two more kinds of equation can set it:

    W (φ - φ*) = 0,   φ = Σ F / Σ P ∂F/∂P      the pull share: the mean force as a share of what the pressure gives
    w_s F_i/(∂F/∂P) = 0                        muscle i just goes slack at this pressure, in a sag test

φ = 1 for a muscle that without pressure neither pulls nor pushes, and does not depend on the force scale. The friction
μ grows with the forces and would determine them if it were proportional to them. If that is uncertain, a constant
friction torque c s ("coulomb") and a constant play b s of the angle ("play") are also fitted.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Mask, falling_root
from allocator.identification.joint.samples import JointSamples, Routes, SlackReadings, weighed
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.muscles import Muscle, force_gradient

MOST_ZERO = 0.6  # [rad] of the encoder
FITTED_GRAVITY = "gravity_sin", "gravity_cos"  # among the extra unknowns
CONVENTIONAL_AREA = 1e-3  # [m²] mean ∂F/∂P if the force scale is unknown
_TAUT_WEIGHT = 0.05  # [rad] per unit of F/F̄: weak, so that it affects only quantities that the angles leave open
_MARGIN = 0.35  # [rad]
_HALVINGS = 5
_CLOSE = 1e-8  # [rad] a Newton step after which the next is below rounding
_COMPLEX_STEP = 1e-30
_GREAT = 10.0  # in place of a residual that the law cannot evaluate [rad]


class Unknowns(NamedTuple):
    """Meaning of the unknowns x."""

    muscle: Muscle  # agonist, not checked
    ratio: float  # strength of the antagonist relative to the agonist, ρ [-]
    zero: float  # of the encoder, z [rad]
    friction: float  # μ [-]
    coulomb: float = 0.0  # constant friction torque c [N·m]
    play: float = 0.0  # constant part of the hysteresis, b [rad]
    gravity_sin: float = 0.0  # A of T_g [N·m]
    gravity_cos: float = 0.0  # B of T_g [N·m]


class PullShare(NamedTuple):
    """Value φ* and weight W of the equation for the pull share."""

    value: float  # [-]
    weight: float  # [rad]


class Torques(NamedTuple):
    """G(θ) and its parts, each (n,)."""

    lacking: Array  # G [N·m]
    forces: tuple[Array, Array]  # F1, F2 [N]
    pulls: tuple[Array, Array]  # ∂G/∂F1, -∂G/∂F2 [m]


class Balance(NamedTuple):
    """`Torques` and the slope of G, each (n,)."""

    lacking: Array
    stiffness: Array  # K_s = -∂G/∂θ [N·m/rad]
    forces: tuple[Array, Array]
    pulls: tuple[Array, Array]


@dataclass(frozen=True)
class JointProblem:
    """Problem of this module. x = (`free` parameters of the muscle, then `extra`: "log_ratio", "zero", "friction",
    `FITTED_GRAVITY`, "coulomb", "play").
    """

    prototype: Muscle
    free: tuple[str, ...]
    extra: tuple[str, ...]
    lower: Array  # (m,)
    upper: Array  # (m,)
    samples: JointSamples
    taut_min: float  # η [-]
    conventional: bool  # whether the force scale is set by convention
    pull: PullShare | None = None  # None: the common force is left to the other equations
    sag: SlackReadings | None = None
    sag_weight: float = 0.0  # w_s [rad/Pa]
    gravity: Gravity = NO_GRAVITY  # the known one
    margin: float = _MARGIN  # of the search for equilibria beyond the measured angles [rad]

    def on(self, keep: Mask) -> Self:
        """Return this problem on some of the samples."""
        return replace(self, samples=self.samples.where(keep))

    def still(self) -> Self:
        """Return this problem without directions of motion, for predictions without friction."""
        return replace(self, samples=replace(self.samples, direction=0 * self.samples.direction))

    def with_free_zero(self) -> Self:
        """Return this problem with the encoder's zero among the unknowns, about the held one."""
        lower, upper = (
            np.append(x, self.samples.zero + d) for x, d in ((self.lower, -MOST_ZERO), (self.upper, MOST_ZERO))
        )
        return replace(self, extra=(*self.extra, "zero"), lower=lower, upper=upper)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the names of the unknowns x."""
        return (*self.free, *self.extra)

    def unknowns(self, x: Array) -> Unknowns:
        """Return x by meaning."""
        values = dict(zip(self.names, x.tolist(), strict=True))
        free = {name: values[name] for name in self.free}
        muscle = self.prototype.unchecked([*(self._given | free).values()])
        ratio = np.exp(values.get("log_ratio", 0.0)).item()
        others = {name: values[name] for name in self.extra if name != "log_ratio"}
        return Unknowns(muscle, ratio, **({"zero": self.samples.zero, "friction": 0.0} | others))

    @cached_property
    def _given(self) -> dict[str, float]:
        """Parameters of the prototype."""
        return self.prototype.parameters

    # --- equilibrium ------------------------------------------------------------------------------------------------

    def torques(self, u: Unknowns, theta: Array, routes: Routes) -> Torques:
        """Return G at the true angles `theta` (n,), where the muscles have these `routes`."""
        s = self.samples
        (eps1, a1, _), (eps2, a2, _), _ = routes
        w1, w2 = self._frictions(u)
        with np.errstate(all="ignore"):
            F1, F2 = u.muscle.law(s.P1, eps1), u.ratio * u.muscle.law(s.P2, eps2)
        pull1, pull2, weight = w1 * a1, w2 * a2, s.torque + self.gravity_of(u).moment(theta)
        return Torques(pull1 * F1 - pull2 * F2 - weight - u.coulomb * s.direction, (F1, F2), (pull1, pull2))

    def gravity_of(self, u: Unknowns) -> Gravity:
        """Return the link's gravity, known or by the unknowns."""
        return Gravity.of_parts(u.gravity_sin, u.gravity_cos) if FITTED_GRAVITY[0] in self.extra else self.gravity

    def balance(self, u: Unknowns, theta: Array, routes: Routes | None = None) -> Balance:
        """Return G and its slope at the true angles `theta` (n,)."""
        s, routes = self.samples, routes or self.samples.routes(theta)
        (eps1, a1, da1), (eps2, a2, da2), l0 = routes
        w1, w2 = self._frictions(u)
        lacking, (F1, F2), pulls = self.torques(u, theta, routes)
        with np.errstate(all="ignore"):
            slope1, slope2 = u.muscle.slope(s.P1, eps1), u.ratio * u.muscle.slope(s.P2, eps2)
        elastic = -(w1 * a1**2 * slope1 + w2 * a2**2 * slope2) / l0
        bends = w1 * da1 * F1 - w2 * da2 * F2
        return Balance(lacking, elastic - bends + self.gravity_of(u).stiffness(theta), (F1, F2), pulls)

    def _frictions(self, u: Unknowns) -> tuple[Array, Array]:
        """Return the shares (n,) of both muscles' torques that friction leaves."""
        return 1 - u.friction * self.samples.direction, 1 + u.friction * self.samples.direction

    def equilibrium(self, u: Unknowns) -> tuple[Array, Mask]:
        """Return θ_eq (n,) [rad], searched from the measured angles for all samples at once, and whether it exists."""
        start = np.clip(self.samples.theta - u.zero, *self._searched(u.zero))
        low, high, reached = self._bracket(u, start)
        theta = falling_root(lambda theta: self.balance(u, theta)[:2], start, low, high, _CLOSE, reached)
        return theta, reached

    def _bracket(self, u: Unknowns, start: Array) -> tuple[Array, Array, Mask]:
        """Return angles with G(low) > 0 > G(high), and whether they exist.

        They lie nearer to `start` if the law bends back further out.
        """
        low, high = self._searched(u.zero)
        for _ in range(_HALVINGS):
            G_low, G_high = (self.torques(u, theta, self.samples.routes(theta)).lacking for theta in (low, high))
            below, above = G_low > 0, G_high < 0
            if (below & above).all():
                break
            low, high = np.where(below, low, (low + start) / 2), np.where(above, high, (high + start) / 2)
        return low, high, below & above

    def _searched(self, zero: float) -> tuple[Array, Array]:
        """Return the ends (n,) [rad] of the true angles among which equilibria are searched."""
        (low, high), (least, most) = self._reach, self._ends
        return np.maximum(low, least - zero - self.margin), np.minimum(high, most - zero + self.margin)

    @cached_property
    def _reach(self) -> tuple[Array, Array]:
        return self.samples.reach()

    @cached_property
    def _ends(self) -> tuple[float, float]:
        """Least and greatest measured angle [rad]."""
        return float(self.samples.theta.min()), float(self.samples.theta.max())

    # --- least squares ----------------------------------------------------------------------------------------------

    def angle_error(self, x: Array) -> Array:
        """Return θ - z - θ_eq (n,) [rad], measured minus predicted."""
        return np.asarray(self.samples.theta - self.predicted(self.unknowns(x)))

    def predicted(self, u: Unknowns) -> Array:
        """Return z + θ_eq (n,) [rad].

        Without a θ_eq, the missing torque over the stiffness is added, which guides the search back.
        """
        theta, reached = self.equilibrium(u)
        shown = u.zero + theta - u.play * self.samples.direction
        if reached.all():
            return np.asarray(shown)
        G, K, *_ = self.balance(u, theta)
        return np.asarray(shown + np.where(reached, 0.0, G / _usual(K, reached)))

    def residual(self, x: Array) -> Array:
        """Return the angle errors (n,), tautness (2n,), and the residuals of further equations."""
        u = self.unknowns(x)
        rows = [self.angle_error(x), _TAUT_WEIGHT * np.maximum(self.taut_min - self.shares(u), 0.0), self._further(u)]
        r = np.concatenate(rows)
        return np.where(np.isfinite(r), r, _GREAT)

    def jacobian(self, x: Array) -> Array:
        """Return ∂residual/∂x (rows, m)."""
        u = self.unknowns(x)
        rows = [-self._angle_gradient(u), self._taut_gradient(u), self.gradient(self._further, x)]
        return np.nan_to_num(np.vstack(rows))

    def _further(self, u: Unknowns) -> Array:
        """Return the residuals of convention (1,), pull share (1,) and sag test (k,); complex if an unknown is."""
        rows = []
        if self.conventional:
            rows.append(np.array([self.mean_area(u) / CONVENTIONAL_AREA - 1]))
        if self.pull is not None:
            rows.append(np.array([self.pull.weight * (self.pull_share(u) - self.pull.value)]))
        if self.sag is not None:
            error = weighed(self.sag, self.sag_error(u), self.prototype.has_threshold)
            rows.append(self.sag_weight * error)
        return np.concatenate(rows) if rows else np.zeros(0)

    def gradient(self, quantity: Callable[[Unknowns], Array], x: Array) -> Array:
        """Return ∂quantity/∂x (rows, m), exact to rounding by complex steps."""
        gradient = np.zeros((quantity(self.unknowns(x)).size, x.size))
        for i in range(x.size if gradient.size else 0):
            moved = x.astype(object)  # one complex number among real ones
            moved[i] += _COMPLEX_STEP * 1j
            gradient[:, i] = np.imag(quantity(self.unknowns(moved))) / _COMPLEX_STEP
        return gradient

    def _angle_gradient(self, u: Unknowns) -> Array:
        """Return ∂(z + θ_eq)/∂x (n, m)."""
        s = self.samples
        theta, reached = self.equilibrium(u)
        routes = s.routes(theta)
        (eps1, a1, _), (eps2, a2, _), _ = routes
        _, K, (F1, F2), (pull1, pull2) = self.balance(u, theta, routes)
        dF1, dF2 = self._force_gradient(u, s.P1, eps1), u.ratio * self._force_gradient(u, s.P2, eps2)
        columns = [*(pull1[:, None] * dF1 - pull2[:, None] * dF2).T]
        extra = {"log_ratio": -pull2 * F2, "friction": -s.direction * (a1 * F1 + a2 * F2), "coulomb": -s.direction}
        extra |= {"zero": K, "play": 0.0 * K, "gravity_sin": -np.sin(theta), "gravity_cos": np.cos(theta)}
        columns += [extra[name] for name in self.extra]
        with np.errstate(all="ignore"):
            gradient = np.stack(columns, axis=1).reshape(s.n, -1) / np.where(reached, K, _usual(K, reached))[:, None]
        for name, shift in (("zero", 1.0), ("play", -s.direction)):
            if name in self.extra:
                gradient[:, self.names.index(name)] = shift
        return np.asarray(gradient)

    def _force_gradient(self, u: Unknowns, P: Array, eps: Array) -> Array:
        with np.errstate(all="ignore"):
            return force_gradient(u.muscle, P, eps, self.free)

    @cached_property
    def _measured(self) -> tuple[Array, Array, Array]:
        """Return pressures [Pa], contractions and moment arms [m] (2n,) at the measured angles, the agonist's first."""
        s = self.samples
        (eps1, a1, _), (eps2, a2, _), _ = s.routes(s.true_angles(s.zero))
        return np.concatenate([s.P1, s.P2]), np.concatenate([eps1, eps2]), np.concatenate([a1, a2])

    def _strength(self, u: Unknowns) -> Array:
        return np.repeat([1.0, u.ratio], self.samples.n)

    def shares(self, u: Unknowns) -> Array:
        """Return F/F̄ (2n,) at the measured angles."""
        F = self.measured_forces(u)
        return np.asarray(F / np.abs(F).mean())

    def measured_forces(self, u: Unknowns) -> Array:
        """Return F1, F2 (2n,) [N] at the measured angles."""
        P, eps, _ = self._measured
        with np.errstate(all="ignore"):
            return np.asarray(self._strength(u) * u.muscle.law(P, eps))

    def _taut_gradient(self, u: Unknowns) -> Array:
        P, eps, _ = self._measured
        F, n = self.measured_forces(u), self.samples.n
        mean = np.abs(F).mean()
        dF = np.zeros((2 * n, len(self.names)))
        dF[:, : len(self.free)] = self._strength(u)[:, None] * self._force_gradient(u, P, eps)
        if "log_ratio" in self.extra:
            dF[n:, self.names.index("log_ratio")] = F[n:]
        dmean = (np.sign(F)[:, None] * dF).mean(axis=0)
        slack = F < self.taut_min * mean
        return np.asarray(-_TAUT_WEIGHT * slack[:, None] * (dF / mean - np.outer(F, dmean) / mean**2))

    def mean_area(self, u: Unknowns) -> complex:
        """Return the mean ∂F/∂P of the agonist [m²]; complex if a parameter is."""
        P, eps, _ = self._measured
        with np.errstate(all="ignore"):
            return np.mean(u.muscle.gain(P[: self.samples.n], eps[: self.samples.n])).item()

    def pull_share(self, u: Unknowns) -> complex:
        """Return φ [-] at the measured angles; complex if an unknown is."""
        P, eps, _ = self._measured
        with np.errstate(all="ignore"):
            given = np.add(*np.split(self._strength(u) * P * u.muscle.gain(P, eps), 2))
            share: complex = np.divide(self.measured_forces(u).sum(), given.sum()).item()
        return share

    @cached_property
    def common_weight(self) -> Array:
        """Return ā/a (2n,) of agonist and antagonist at the measured angles; forces in these ratios move no angle."""
        return np.asarray(self.mean_arm / self._measured[2])

    @property
    def mean_arm(self) -> float:
        """Return ā [m], the mean moment arm at the measured angles."""
        return float(self._measured[2].mean())

    def sag_error(self, u: Unknowns) -> Array:
        """Return the excess (k,) [Pa] of the pressures of the sag test over those at which the muscle goes slack."""
        if self.sag is None:
            return np.zeros(0)
        P, eps = self.sag.muscles(u.zero)
        with np.errstate(all="ignore"):
            return np.asarray(u.muscle.law(P, eps) / u.muscle.gain(P, eps))


def _usual(K: Array, reached: Mask) -> float:
    known = K[reached & np.isfinite(K)]
    return float(np.median(known)) if known.size else 1.0
