"""Uncertainty of the unknowns of a joint's fit, and other fits that the same data allow.

The errors of a fit to equilibria are mostly those of the force law and of the friction, not noise: neighbours in
pressure err alike. The formal covariance σ² (JᵀJ)⁻¹ takes them for independent and is far too small. The covariance of
a fit has two parts, each evaluated in stiffness and forces and carried by the unknowns as in `effects`:

1. the second moment of noise and of a smooth error of the law, see `discrepancy`;
2. what the force common to both muscles changes between the ends of its interval, see `common_force`: the mean square
   if these are four standard deviations apart.

A fit without the lowest pressures, with constant hysteresis or with another law is a *choice*. Choices are reported
with what they change. They add nothing to the covariance: the discrepancy contains every smooth law.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.identifiability import determine
from allocator.identification.joint.doubt.common_force import CommonForce
from allocator.identification.joint.doubt.discrepancy import Discrepancy, discrepancy
from allocator.identification.joint.doubt.effects import Effects
from allocator.identification.joint.problem import JointProblem
from allocator.identification.joint.search import minimise
from allocator.identification.least_squares import rms
from allocator.identification.muscle.fit import fit
from allocator.muscles import MODELS, Muscle
from allocator.units import BAR

LAWS = ("Sarosi2012", "AffinePolynomial", "Hildebrandt2005", "MartensBoblan2017")  # compared as choices
_FURTHER = (0.5 * BAR, 1.5 * BAR)  # by how much the dead band is raised [Pa]
_LEFT = 0.5  # of the samples have to be left by a greater dead band
_AS_GOOD = 1.25  # times the error of the fit that another law may have
_MOST_PSEUDO = 300  # forces to which another law is fitted first
_ROUNDS = 3  # in which a constant hysteresis and the unknowns are fitted in turn


class Choice(NamedTuple):
    """Fit that another choice of dead band, hysteresis or law gives."""

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


def doubt(problem: JointProblem, x: Array, inside: Mask, common: CommonForce, choices: bool = True) -> Doubt:
    """Return the doubt of the solution `x`; unknowns not `inside` the bounds of the search count as known."""
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
    """Yield the fits of other dead bands and other laws; a law that predicts the angles worse is no choice."""
    s = problem.samples
    lowest = np.minimum(s.P1, s.P2)
    start = float(lowest.min())
    for further in _FURTHER:
        keep = lowest >= start + further
        if keep.all() or keep.sum() < max(_LEFT * s.n, x.size + 1):
            continue
        kept = _with_same_forces(problem.on(keep), x)
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
        except InvalidInput:  # this law has no force at these contractions: it is no choice
            continue
        choice = _choice(effects, name, "law", other, there)
        if choice.rms <= most:
            yield choice


def _with_same_forces(problem: JointProblem, x: Array) -> JointProblem:
    """Return the problem on fewer samples with the pull share that the muscles of `x` have on these, if one is held.

    The common force is not doubted here but in `allocator.identification.joint.doubt.common_force`.
    """
    if problem.pull is None:
        return problem
    return replace(problem, pull=problem.pull._replace(value=problem.pull_share(problem.unknowns(x)).real))


def _with_constant_hysteresis(problem: JointProblem, x: Array) -> tuple[JointProblem, Array]:
    """Return the problem without friction, a constant angle taken off in the direction of motion, and its solution."""
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
    """Return the choice with the solution `there` of the problem `other`."""
    u, n = other.unknowns(there), effects.problem.samples.n
    error, change = other.angle_error(there), effects.difference(other, there)[:n]
    return Choice(name, kind, rms(error), u.ratio, u.zero, u.friction, rms(change))
