"""The doubt of a joint's fit is worked out here, from correlated errors and from what other choices give.

The errors of a fit to equilibria are mostly the law's and the friction's, not noise: neighbours in pressure err alike,
and so do the samples of a sweep. The formal covariance σ² (JᵀJ)⁻¹ takes them for independent and is far too small.
Three things are added up here, in the unknowns x:

1. The cluster-robust covariance (JᵀJ)⁻¹ (Σ_g J_gᵀ e_g e_gᵀ J_g) (JᵀJ)⁻¹, e_g = (I - H_gg)⁻¹ r_g, CR3 of Bell and
   McCaffrey (2002), over the clustering that gives the most: sweeps (length, direction, held pressure), or tiles of the
   plane of pressures; never less than the formal one in any direction. It is widened by (t / 1.96)², t the 97.5 %
   quantile of Student's distribution with (clusters - 1) degrees of freedom, so that ± 1.96 std is the 95 % interval.
2. What a greater dead band gives, and
3. what another law gives, or a hysteresis that is constant in the angle instead of friction in proportion to the pull,
   if it predicts the angles about as well: the change d of the unknowns that has the same effect on stiffness and
   forces, to first order. The mean of d dᵀ over the choices of a kind is added.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.identifiability import Determination, determine
from allocator.identification.joint.problem import JointProblem, Unknowns
from allocator.identification.joint.search import minimise
from allocator.identification.muscle.fit import fit
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import MODELS, Muscle
from allocator.units import BAR

LAWS = ("Sarosi2012", "AffinePolynomial", "Hildebrandt2005", "MartensBoblan2017")  # compared as (3)
_FURTHER = (0.5 * BAR, 1.5 * BAR)  # by how much the dead band is raised as (2) [Pa]
_LEFT = 0.5  # of the samples have to be left by a greater dead band
_AS_GOOD = 1.25  # times the error of the fit that another law may have
_NORMAL = 1.959963984540054  # 97.5 % quantile
_LEVERAGE = 0.9  # greatest eigenvalue of H_gg that is believed: a cluster that alone decides something says nothing
_TILES = 3  # a side of the plane of pressures
_FORCE_WEIGHT = 0.3  # of a relative change of force, in that of a stiffness
_MOST_PSEUDO = 300  # forces to which another law is fitted first
_ROUNDS = 3  # in which a constant hysteresis and the unknowns are fitted in turn
_RANK = 1e-6  # of the effects of the unknowns on stiffness and forces


class Choice(NamedTuple):
    """A choice could have been made otherwise; this is what the fit would have been."""

    name: str
    kind: str  # "dead band", "hysteresis" or "law"
    rms: float  # [rad]
    ratio: float  # [-]
    zero: float  # [rad]
    friction: float  # [-]
    stiffness: float  # RMS relative change of K (of K/K_ref without a force scale) at the samples [-]
    change: Array  # of the unknowns of the fit, with the same effect (m,)


@dataclass(frozen=True)
class Doubt:
    """A doubt is the covariance of the unknowns and where it comes from."""

    covariance: Array  # (m, m), all three together; 0 for unknowns at a bound
    robust: Array  # (m, m), the first alone: what the angles tell if the law is right
    formal: Array  # (m, m), σ² (JᵀJ)⁻¹, as if all errors were independent
    clusters: int  # over which it is robust
    clustering: str  # what they are
    choices: tuple[Choice, ...]


def doubt(problem: JointProblem, x: Array, inside: Mask, choices: bool = True) -> Doubt:
    """Return the doubt of the solution `x`; unknowns not `inside` the bounds of the search count as known."""
    r, J = problem.residual(x), problem.jacobian(x)
    names = tuple(n for n, i in zip(problem.names, inside, strict=True) if i)
    found = determine(J[:, inside], float(r @ r), names, x[inside])
    formal = found.covariance
    robust, clusters, clustering = _robust(r, J[:, inside], found, _clusterings(problem))
    others = tuple(_choices(problem, x, inside)) if choices else ()
    covariance = robust.copy()
    for kind in ("dead band", "hysteresis", "law"):
        covariance += _spread([choice for choice in others if choice.kind == kind], inside)
    total, alone, assumed = (_full(C, inside) for C in (covariance, robust, formal))
    return Doubt(total, alone, assumed, clusters, clustering, others)


def _spread(choices: list[Choice], inside: Mask) -> Array:
    """Return the mean of d dᵀ (m, m) over the choices, one that predicts the angles better counting as 1/rms²."""
    weights = np.array([1 / choice.rms**2 for choice in choices])
    changes = np.array([choice.change[inside] for choice in choices]).reshape(-1, int(inside.sum()))
    return np.asarray((changes.T * weights) @ changes / max(float(weights.sum()), 1e-300))


def _full(covariance: Array, inside: Mask) -> Array:
    full = np.zeros((inside.size, inside.size))
    full[np.ix_(inside, inside)] = covariance
    return full


# --- clusters ------------------------------------------------------------------------------------------------------


def _clusterings(problem: JointProblem) -> dict[str, NDArray[np.intp]]:
    """Return the label (n,) of each sample's cluster, in several ways."""
    s = problem.samples
    way = np.sign(s.direction) + 1
    side = np.sign(s.torque) + 1
    held1, held2 = (np.round(P / (0.5 * BAR)) for P in (s.P1, s.P2))
    return {
        "sweeps with P1 held": _labels(s.group, way, side, held1),
        "sweeps with P2 held": _labels(s.group, way, side, held2),
        "tiles of the plane of pressures": _labels(side, _thirds(s.P1 + s.P2), _thirds(s.P1 - s.P2)),
    }


def _labels(*columns: NDArray[np.generic]) -> NDArray[np.intp]:
    return np.unique(np.stack([c.astype(float) for c in columns]), axis=1, return_inverse=True)[1].ravel()


def _thirds(values: Array) -> NDArray[np.intp]:
    return np.searchsorted(np.quantile(values, np.arange(1, _TILES) / _TILES), values, side="right")


def _robust(
    r: Array, J: Array, found: Determination, clusterings: dict[str, NDArray[np.intp]]
) -> tuple[Array, int, str]:
    """Return the widest of the robust covariances, its number of clusters and what they are."""
    size = np.sqrt(np.maximum(np.diag(found.covariance), 1e-300))
    widest, clusters, clustering = found.covariance, r.size, "single samples"
    for name, label in clusterings.items():
        alone = label.max() + 1 + np.arange(r.size - label.size)  # tautness and convention belong to no sweep
        covariance = _clustered(r, J, found, np.append(label, alone))
        if np.trace(covariance / np.outer(size, size)) > np.trace(widest / np.outer(size, size)):
            widest, clusters, clustering = covariance, int(label.max()) + 1, name
    return widest, clusters, clustering


def _clustered(r: Array, J: Array, found: Determination, label: NDArray[np.intp]) -> Array:
    """Return the covariance (m, m) that is robust to correlation within clusters, with Student's quantile in it.

    In the coordinates in which the formal covariance is σ² I no eigenvalue is let below σ².
    """
    from scipy.stats import t

    rows = int((J != 0).any(axis=1).sum())
    sigma2 = float(r @ r) / max(rows - found.rank, 1)
    root = _root(found.covariance / max(sigma2, 1e-300))
    Q = J @ root  # (rows, m), QᵀQ = I on what is determined
    parts = [Q[label == g].T @ _without_itself(Q[label == g], r[label == g]) for g in range(label.max() + 1)]
    scores = np.array([part for part in parts if part.any()]).reshape(-1, J.shape[1])
    count = len(scores)
    widened = (t.ppf(0.975, max(min(count - 1, rows - found.rank), 1)) / _NORMAL) ** 2
    values, vectors = np.linalg.eigh(scores.T @ scores * (count - 1) / max(count, 1))
    half = root @ vectors
    return np.asarray((half * np.maximum(values * widened, sigma2)) @ half.T)


def _without_itself(Q: Array, r: Array) -> Array:
    """Return (I - H)⁻¹ r, H = Q Qᵀ, by the eigenvectors of QᵀQ; the errors that the others predict, less the cut."""
    values, vectors = np.linalg.eigh(Q.T @ Q)
    values = np.clip(values, 0.0, None)
    seen = values > 1e-12
    U = Q @ vectors[:, seen] / np.sqrt(values[seen])
    h = np.minimum(values[seen], _LEVERAGE)
    return np.asarray(r + U @ ((h / (1 - h)) * (U.T @ r)))


def _root(covariance: Array) -> Array:
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    return np.asarray(scale[:, None] * vectors * np.sqrt(np.maximum(values, 0.0)))


# --- choices -------------------------------------------------------------------------------------------------------


def _choices(problem: JointProblem, x: Array, inside: Mask) -> Iterator[Choice]:
    """Yield what other dead bands and other laws give; a law that predicts the angles worse is no choice."""
    effect = _Effect(problem, x, inside)
    s = problem.samples
    lowest = np.minimum(s.P1, s.P2)
    start = float(lowest.min())
    for further in _FURTHER:
        keep = lowest >= start + further
        if keep.all() or keep.sum() < max(_LEFT * s.n, x.size + 1):
            continue
        kept = _with_same_forces(problem.on(keep), x)
        there, _ = minimise(kept, x)
        yield effect.choice(f"pressures from {(start + further) / BAR:.2g} bar", "dead band", kept, there)
    most = _AS_GOOD * float(np.sqrt(np.mean(problem.angle_error(x) ** 2)))
    if "friction" in problem.extra:
        choice = effect.choice("a constant hysteresis", "hysteresis", *_with_constant_hysteresis(problem, x))
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
        choice = effect.choice(name, "law", other, there)
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
    (eps1, *_), (eps2, *_), _ = s.routes(np.clip(s.theta - u.zero, *s.reach()))
    with np.errstate(all="ignore"):
        F1, F2 = u.muscle.law(s.P1, eps1), u.muscle.law(s.P2, eps2)
    eps, P, F = (np.concatenate(pair) for pair in ((eps1, eps2), (s.P1, s.P2), (F1, F2)))
    every = max(1, eps.size // _MOST_PSEUDO)
    muscle = fit(model, eps[::every], P[::every], F[::every], folds=0).muscle
    recipe = model.recipe(eps, P, np.ones(P.size))
    free = tuple(p for p in muscle.parameters if not {p, p.partition("[")[0]} & set(recipe.conventional))
    bounds = [recipe.bounds.get(name, (-np.inf, np.inf)) for name in free]
    extra = slice(len(problem.free), None)
    lower, upper = (
        np.append([b[end] for b in bounds], ends[extra]) for end, ends in enumerate((problem.lower, problem.upper))
    )
    other = replace(problem, prototype=replace(muscle, covariance=None), free=free, lower=lower, upper=upper)
    start = np.append([muscle.parameters[p] for p in free], x[extra])
    found, _ = minimise(other, start)
    return other, found


class _Effect:
    """An effect is what stiffness, forces and the other unknowns are at the samples, relative, (k,), and ∂/∂x."""

    def __init__(self, problem: JointProblem, x: Array, inside: Mask) -> None:
        self.problem, self.x, self.inside = problem, x, inside
        self.values = self._values(problem.unknowns(x))
        self.gradient = np.stack([self._slope(i) for i in np.flatnonzero(inside).tolist()], axis=1)

    def _values(self, u: Unknowns) -> Array:
        s = self.problem.samples
        parts = []
        for i, (_, geometry) in enumerate(s.groups):
            here = s.group == i
            joint = AntagonistJoint(geometry, u.muscle, u.muscle, min_contraction=-0.3)
            one, two = joint.sides(s.theta[here] - u.zero)
            P1, P2 = s.P1[here], s.P2[here]
            with np.errstate(all="ignore"):
                K = one.stiffness(P1) + u.ratio * two.stiffness(P2)
                parts.append(np.stack([K, one.force(P1), u.ratio * two.force(P2)]))
        return np.concatenate(parts, axis=1)

    def _slope(self, i: int) -> Array:
        h = 1e-5 * max(abs(self.x[i]), 1e-3 if i >= len(self.problem.free) else 1e-9)
        ahead, behind = (
            self._relative(self.problem.unknowns(self.x + step * (np.arange(self.x.size) == i))) for step in (h, -h)
        )
        return np.asarray((ahead - behind) / (2 * h))

    def _relative(self, u: Unknowns) -> Array:
        """Return K/K and F/F̄, weighted, then what else is unknown: log ρ, z, μ."""
        now = self._values(u)
        K, F1, F2 = now
        K0, *F0 = self.values
        size = np.abs(np.concatenate(F0)).mean()
        n = K.size
        scale = np.sqrt(n)
        return np.concatenate(
            [K / K0, _FORCE_WEIGHT * F1 / size, _FORCE_WEIGHT * F2 / size]
            + [[scale * (np.log(u.ratio) if name == "log_ratio" else getattr(u, name))] for name in self.problem.extra]
        )

    def choice(self, name: str, kind: str, other: JointProblem, there: Array) -> Choice:
        """Return what another fit says, and the change of the unknowns x with the same effect, by least squares."""
        u, here = other.unknowns(there), self.problem.unknowns(self.x)
        difference = self._relative(u) - self._relative(here)
        difference = np.where(np.isfinite(difference), difference, 0.0)
        size = np.linalg.norm(self.gradient, axis=0)
        size[size == 0] = 1.0
        change = np.zeros(self.x.size)
        change[self.inside] = np.linalg.lstsq(self.gradient / size, difference, rcond=_RANK)[0] / size
        n = self.problem.samples.n
        error = other.angle_error(there)
        return Choice(
            name,
            kind,
            float(np.sqrt(np.mean(error**2))),
            u.ratio,
            u.zero,
            u.friction,
            float(np.sqrt(np.mean(difference[:n] ** 2))),
            change,
        )


__all__ = ["Choice", "Doubt", "doubt"]
