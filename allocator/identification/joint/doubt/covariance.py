"""Uncertainty of the unknowns of a joint's fit, and other fits that the same data allow.

The errors of a fit to equilibria are mostly those of the force law and of the friction, not noise: errors at
neighbouring pressures are alike. The formal covariance σ² (JᵀJ)⁻¹ treats them as independent and is far too small. The
covariance of a fit has two parts, each evaluated in stiffness and forces and carried by the unknowns as in `Effects`:

1. the second moment of noise and of a smooth error of the law, see `discrepancy`;
2. the change by the common force between the ends of its interval, see `common_force`: the mean square if these
   are four standard deviations apart.

A fit without the lowest pressures, with constant hysteresis or with another law is a *choice*. Choices are reported
with their effects. They add nothing to the covariance: the discrepancy contains every smooth law.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.joint.doubt.common_force import CommonForce
from allocator.identification.joint.doubt.discrepancy import Discrepancy, discrepancy
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.relative import stiffness_with_gradient
from allocator.identification.joint.report import parameter_jacobian, rough_joints
from allocator.identification.joint.search import minimise
from allocator.identification.least_squares import determine, rms, solve, unit_columns
from allocator.identification.muscle.fit import fit
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import MODELS, Muscle, force_gradient
from allocator.units import BAR

LAWS = ("Sarosi2012", "AffinePolynomial", "Hildebrandt2005", "MartensBoblan2017")  # compared as choices
_FURTHER = (0.5 * BAR, 1.5 * BAR)  # increases of the dead band [Pa]
_LEFT = 0.5  # of the samples must remain with a greater dead band
_AS_GOOD = 1.25  # times the error of the fit: greatest error of another law
_MOST_PSEUDO = 300  # forces to which another law is fitted first
_ROUNDS = 3  # of fitting a constant hysteresis and the unknowns in turn
_FORCE_WEIGHT = 0.3  # w, of a relative change of force, in that of a stiffness
_RANK = 1e-3  # singular values of G, its columns scaled to one, in the greatest
_WIDENED = 1.25  # of standard deviations: benchmarks.identification.joint_coverage, seeds below 1000
_LEAST_STIFFNESS = 0.3  # of the median: least divisor of a change of K


@dataclass(frozen=True)
class Effects:
    """Stiffness and forces of a fit at its samples, and the changes of its unknowns that imitate others.

    A joint carries its uncertainty as a covariance of parameters. Other errors (the form of the law, the common force)
    are therefore evaluated as relative changes of K, F1 and F2 at the samples, and of the unknowns that are not muscle
    parameters (ratio, zero, friction). The nearest change d of the unknowns is

        minimise |G d - t|²,   G = ∂(K/K, w F1/F̄, w F2/F̄, extra)/∂x

    by a truncated singular value decomposition: directions of d that move stiffness and forces by less than a
    thousandth of the effect of single unknowns are left out, since an error of the linearisation would become a huge
    change along them.
    """

    problem: JointProblem
    x: Array  # (m,)
    inside: Mask  # (m,) unknowns that are not at a bound
    theta: Array  # true angles of the fit (n,) [rad]
    scale: Array  # (3n,) divisors of K [N·m/rad], F1 and F2 [N]
    gradient: Array  # G (3n + extra, m inside)

    @classmethod
    def of(cls, problem: JointProblem, x: Array, inside: Mask) -> Self:
        """Return the effects at the solution `x`."""
        u, s = problem.unknowns(x), problem.samples
        theta = s.theta - u.zero
        values, slopes = np.empty((3, s.n)), np.empty((3, s.n, x.size))
        J = parameter_jacobian(problem, u)
        for here, joint in rough_joints(problem, u):
            at = theta[here], s.P1[here], s.P2[here]
            K = stiffness_with_gradient(joint, *at)
            values[0, here], slopes[0, here] = K.value, K.gradient @ J
            half = K.gradient.shape[1] // 2
            for i, (side, P) in enumerate(zip(joint.sides(at[0]), at[1:], strict=True)):
                values[i + 1, here] = side.force(P)
                dF = force_gradient(side.muscle, P, side.contraction)
                slopes[i + 1, here] = dF @ J[i * half : (i + 1) * half]
        scale = _scale(values)
        extra = np.sqrt(s.n) * np.eye(x.size)[len(problem.free) :]
        gradient = np.vstack([slopes.reshape(3 * s.n, -1) / scale[:, None], extra])[:, inside]
        return cls(problem, x, inside, theta, scale, np.nan_to_num(gradient))

    def difference(self, other: JointProblem, there: Array) -> Array:
        """Return the change by another fit, or another law (3n + extra,)."""
        now, u, s = self.problem.unknowns(self.x), other.unknowns(there), self.problem.samples
        changes = np.empty((3, s.n))
        for (here, one), (_, two) in zip(rough_joints(self.problem, now), rough_joints(self.problem, u), strict=True):
            at = self.theta[here], s.P1[here], s.P2[here]
            changes[:, here] = _values(two, *at) - _values(one, *at)
        extra = [np.log(u.ratio / now.ratio)] if "log_ratio" in self.problem.extra else []
        extra += [getattr(u, name) - getattr(now, name) for name in self.problem.extra if name != "log_ratio"]
        return np.append(
            np.nan_to_num(changes.ravel() / self.scale, posinf=0.0, neginf=0.0), np.sqrt(s.n) * np.array(extra)
        )

    def imitated(self, targets: Array) -> Array:
        """Return the changes of the unknowns (m, k) that come nearest to the `targets` (3n + extra, k)."""
        found = np.zeros((self.x.size, targets.shape[1]))
        found[self.inside] = solve(self.gradient, targets, rcond=_RANK)
        return found

    def covariance(self, found: Discrepancy) -> Array:
        """Return the covariance of the unknowns (m, m) that represents the error of the fit and of its law."""
        u, s = self.problem.unknowns(self.x), self.problem.samples
        field = np.zeros((3, s.n, found.terms))
        for i, (_, geometry) in enumerate(s.groups):
            here = s.group == i
            field[:, here] = found.field.effects(geometry, u, self.theta[here], s.P1[here], s.P2[here])
        targets = self.gradient @ self._with_friction(found)[self.inside]
        of_field = found.root[self.x.size : self.x.size + found.terms]
        targets[: 3 * s.n] += field.reshape(3 * s.n, -1) @ of_field / self.scale[:, None]
        root = self.imitated(targets)
        left = (targets - self.gradient @ root[self.inside])[: s.n]  # part of K that no change of the unknowns imitates
        lost = float(np.square(left).sum(axis=1).mean())
        return np.asarray(_WIDENED**2 * (root @ root.T + lost * self._even()))

    def _with_friction(self, found: Discrepancy) -> Array:
        """Return the root (m, p) of the unknowns, with the part of the friction error that μ can describe."""
        root = found.root[: self.x.size].copy()
        if "friction" in self.problem.names:
            i, s = self.problem.names.index("friction"), self.problem.samples
            column = -self.problem.jacobian(self.x)[: s.n, i]
            part = column @ found.friction.columns(s) / max(float(column @ column), 1e-300)
            root[i] += part @ found.root[self.x.size + found.terms :]
        return root

    def _even(self) -> Array:
        """Return a covariance (m, m) of the muscles' parameters that moves K by one, relative, in the mean square."""
        names = np.array(self.problem.names)[self.inside]
        muscle = ~np.isin(names, [name for name in self.problem.extra if name != "log_ratio"])
        if not muscle.any():
            return np.zeros((self.x.size, self.x.size))
        G = self.gradient[:, muscle]
        scaled_G, size = unit_columns(G)
        root = np.linalg.pinv(scaled_G, rcond=_RANK) / size[:, None]  # (muscle, rows)
        C = root @ root.T
        K = G[: self.problem.samples.n]
        C /= max(float(np.mean(np.einsum("ni,ij,nj->n", K, C, K))), 1e-300)
        even = np.zeros((self.x.size, self.x.size))
        place = np.flatnonzero(self.inside)[muscle]
        even[np.ix_(place, place)] = C
        return even


def _values(joint: AntagonistJoint, theta: Array, P1: Array, P2: Array) -> Array:
    """Return K, F1 and F2 (3, n)."""
    one, two = joint.sides(theta)
    with np.errstate(all="ignore"):
        F1, F2 = one.force(P1), two.force(P2)
        return np.stack([one.stiffness(P1) + two.stiffness(P2), F1, F2])


def _scale(values: Array) -> Array:
    """Return the scales (3n,) of K, F1 and F2 (3, n)."""
    K, F1, F2 = values
    force = float(np.abs(np.concatenate([F1, F2])).mean()) / _FORCE_WEIGHT
    least = _LEAST_STIFFNESS * float(np.median(np.abs(K)))
    return np.concatenate([np.maximum(np.abs(K), least), np.full(2 * K.size, force)])


class Choice(NamedTuple):
    """Result of a fit with another dead band, hysteresis or law."""

    name: str
    kind: str  # "dead band", "hysteresis" or "law"
    rms: float  # [rad]
    ratio: float  # [-]
    zero: float  # [rad]
    friction: float  # [-]
    stiffness: float  # RMS relative change of K (of K/K_ref without a force scale) at the samples [-]


@dataclass(frozen=True)
class Doubt:
    """Covariance of the unknowns of a fit and where it comes from."""

    covariance: Array  # (m, m), both parts together; 0 for unknowns at a bound
    formal: Array  # (m, m), σ² (JᵀJ)⁻¹, as if all errors were independent
    discrepancy: Discrepancy
    choices: tuple[Choice, ...]


def doubt(problem: JointProblem, x: Array, inside: Mask, common: CommonForce, choices: bool) -> Doubt:
    """Return the doubt of the solution `x`; unknowns at a bound of the search (not `inside`) count as known."""
    r, J = problem.residual(x), problem.jacobian(x)
    names = tuple(n for n, i in zip(problem.names, inside, strict=True) if i)
    formal = np.zeros((x.size, x.size))
    formal[np.ix_(inside, inside)] = determine(J[:, inside], float(r @ r), names, x[inside]).covariance
    found, effects = discrepancy(problem, x, inside, common.share_std), Effects.of(problem, x, inside)
    covariance = effects.covariance(found)
    if common.ends is not None:
        low, high = (effects.difference(problem, end) for end in common.ends)
        change = effects.imitated((high - low)[:, None])[:, 0]
        covariance = covariance + np.outer(change, change) / 16
    others = tuple(_choices(problem, x, effects)) if choices else ()
    return Doubt(covariance, formal, found, others)


# --- choices -------------------------------------------------------------------------------------------------------


def _choices(problem: JointProblem, x: Array, effects: Effects) -> Iterator[Choice]:
    """Yield the fits of other dead bands and other laws, except laws that predict the angles worse."""
    s = problem.samples
    lowest = np.minimum(s.P1, s.P2)
    start = float(lowest.min())
    for further in _FURTHER:
        keep = lowest >= start + further
        if keep.all() or keep.sum() < max(_LEFT * s.n, x.size + 1):
            continue
        kept = problem.on(keep)
        if kept.pull is not None:  # the pull share of the muscles of x: the common force is treated separately
            kept = replace(kept, pull=kept.pull._replace(value=kept.pull_share(kept.unknowns(x)).real))
        there, _ = minimise(kept, x)
        yield _choice(effects, f"pressures from {(start + further) / BAR:.2g} bar", "dead band", kept, there)
    most = _AS_GOOD * rms(problem.angle_error(x))
    if "friction" in problem.extra:
        choice = _choice(effects, "a constant hysteresis", "hysteresis", *_with_constant_hysteresis(problem, x))
        if choice.rms <= most:
            yield choice
    if not problem.free:
        return
    for name in LAWS:
        if name == type(problem.prototype).__name__:
            continue
        try:
            other, there = _with_law(problem, x, MODELS[name])
        except InvalidInput:  # this law gives no force at these contractions
            continue
        choice = _choice(effects, name, "law", other, there)
        if choice.rms <= most:
            yield choice


def _with_constant_hysteresis(problem: JointProblem, x: Array) -> tuple[JointProblem, Array]:
    """Return the problem with a constant angle in the direction of motion instead of friction, and its solution."""
    s, still = problem.samples.direction, problem.still()
    shifted, there = still, x
    for _ in range(_ROUNDS):
        there, _ = minimise(shifted, there)
        half = float(still.angle_error(there) @ s) / max(float(s @ s), 1.0)
        shifted = replace(still, samples=replace(still.samples, theta=still.samples.theta - half * s))
    return shifted, there


def _with_law(problem: JointProblem, x: Array, model: type[Muscle]) -> tuple[JointProblem, Array]:
    """Return the problem with another law, and its solution, searched from the law fitted to the forces found."""
    u, s = problem.unknowns(x), problem.samples
    P, eps = s.muscles(u.zero)
    with np.errstate(all="ignore"):
        F = u.muscle.law(P, eps)
    every = max(1, eps.size // _MOST_PSEUDO)
    muscle = fit(model, eps[::every], P[::every], F[::every], folds=0).muscle
    recipe = model.recipe(eps, P, np.ones(P.size))
    free = recipe.free(muscle.parameters)
    extra, bounds = slice(len(problem.free), None), (problem.lower, problem.upper)
    lower, upper = (np.append(own, ends[extra]) for own, ends in zip(recipe.limits(free), bounds, strict=True))
    other = replace(problem, prototype=replace(muscle, covariance=None), free=free, lower=lower, upper=upper)
    start = np.append([muscle.parameters[p] for p in free], x[extra])
    found, _ = minimise(other, start)
    return other, found


def _choice(effects: Effects, name: str, kind: str, other: JointProblem, there: Array) -> Choice:
    u, n = other.unknowns(there), effects.problem.samples.n
    error, change = other.angle_error(there), effects.difference(other, there)[:n]
    return Choice(name, kind, rms(error), u.ratio, u.zero, u.friction, rms(change))
