"""Smooth error of a fitted force law, after Kennedy and O'Hagan (2001), Bayesian calibration of computer models.

The muscles pull with F(P, ε; p) + g(P, ε). The discrepancy g is a random field: products of Legendre polynomials of
pressure and contraction, scaled to the measured region, up to the total degree 5,

    g = F̄ Σ c_ij L_i(P) L_j(ε),   c_ij ~ N(0, τ² (9/16)^(i+j)),   F̄ the mean force

To first order in the change dx of the unknowns and in c, the errors r of the fit are

    r = X dx + B c + N b + e,   X = ∂θ_eq/∂x,   B = ∂θ_eq/∂c,   e ~ N(0, σ² I)                        (D1)

N b is an error of the friction model: a quadratic in the pressures times the direction of motion. dx and b have wide
priors about the fit. The restricted likelihood of (D1) is evaluated on a grid of τ²/σ², σ² being profiled; the
posterior averages over the grid, with a log-normal prior of τ that makes laws wrong by some per cent.

The fit stays at dx = 0, so its error in a quantity with the gradient G has the second moment

    E[(G z)²] = G M Gᵀ,   M = E[z zᵀ],   z = (dx, c, b)                                               (D2)

M contains the noise, and the error of the law, both as shown by the residuals and as invisible to the angles. Beyond
the measured region the polynomials grow, and with them G M Gᵀ.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from allocator.calculus import Array, Mask
from allocator.identification.joint.problem import FITTED_GRAVITY, JointProblem, Unknowns
from allocator.identification.joint.samples import JointSamples
from allocator.identification.least_squares import rms, unit_columns
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.geometry import Geometry

_DEGREE = 5
_DECAY = 0.75  # of the standard deviation of c, per degree
_USUAL, _FACTOR = 0.02, 3.0  # median of τ [-], and the factor of one standard deviation
_GRID = np.geomspace(1e-8, 1e8, 65)  # τ²/σ², in units of 1/(mean squared singular value of B)
_LOOSE = {"log_ratio": 0.5, "zero": 0.35, "friction": 0.3}  # standard deviations beforehand [-], [rad], [-]
_LOOSE |= dict.fromkeys(FITTED_GRAVITY, 10.0)  # [N·m]
_PARAMETER = 5.0  # … of a muscle's parameter, relative [-]
_FRICTION = 0.1  # … of b [rad]
_LEAST = 1e-6  # [rad] errors assumed of exact data
_NEGLIGIBLE = 1e-4  # weight of a point of the grid, relative to the greatest
_RANK = 1e-9
_APART = 1e-8  # smaller singular values belong to directions common to X and N


@dataclass(frozen=True)
class ForceField:
    """Basis of the discrepancy g over the measured region of pressures and contractions."""

    pressures: tuple[float, float]  # middle and half width [Pa]
    contractions: tuple[float, float]  # middle and half width [-]
    force: float  # F̄ [N]

    @classmethod
    def of(cls, problem: JointProblem, u: Unknowns) -> "ForceField":
        """Return the basis for the samples of the problem."""
        P, eps = problem.samples.muscles(u.zero)
        return cls(_middle(P), _middle(eps), float(np.abs(problem.measured_forces(u)).mean()))

    def outside(self, P: Array, eps: Array) -> Array:
        """Return the distance of pressures and contractions (n,) from the measured region (n,), in its half widths."""
        (p0, p), (e0, e) = self.pressures, self.contractions
        return np.asarray(np.maximum(np.maximum(np.abs(P - p0) / p, np.abs(eps - e0) / e) - 1, 0.0))

    def values(self, P: Array, eps: Array) -> tuple[Array, Array]:
        """Return ∂g/∂c (n, k) [N] and ∂²g/∂c∂ε (n, k) [N], c in units of its prior standard deviation over τ."""
        (p0, p), (e0, e) = self.pressures, self.contractions
        in_P = legendre.legvander((P - p0) / p, _DEGREE)
        at = (eps - e0) / e
        in_eps = legendre.legvander(at, _DEGREE)
        slopes = legendre.legval(at, legendre.legder(np.eye(_DEGREE + 1))).T
        size = self.force * _DECAY ** (_I + _J)
        return size * in_P[:, _I] * in_eps[:, _J], size / e * in_P[:, _I] * slopes[:, _J]

    def effects(self, geometry: Geometry, u: Unknowns, theta: Array, P1: Array, P2: Array) -> tuple[Array, ...]:
        """Return ∂K/∂c (n, k) [N·m/rad], ∂F1/∂c and ∂F2/∂c (n, k) [N] at the true angles `theta` (n,)."""
        one, two = AntagonistJoint(geometry, u.muscle, u.muscle, min_contraction=-0.3).sides(theta)
        effects = []
        for side, P in ((one, P1), (two, P2)):
            g, slope = self.values(P, np.asarray(side.contraction) + 0 * P)
            stiff = -np.square(np.asarray(side.arm) + 0 * P)[:, None] / side.rest_length * slope
            effects.append((stiff + (np.asarray(side.bend) + 0 * P)[:, None] * g, g))
        (K1, F1), (K2, F2) = effects
        return K1 + u.ratio * K2, F1, u.ratio * F2


_I, _J = (a.ravel() for a in np.meshgrid(np.arange(_DEGREE + 1), np.arange(_DEGREE + 1), indexing="ij"))
_I, _J = _I[_I + _J <= _DEGREE], _J[_I + _J <= _DEGREE]


def _middle(values: Array) -> tuple[float, float]:
    low, high = float(values.min()), float(values.max())
    return (low + high) / 2, max((high - low) / 2, 1e-9 * max(abs(high), 1.0))


class Evidence(NamedTuple):
    """Model (D1) with the rows of all equations of the fit."""

    r: Array  # (rows,) [rad]
    X: Array  # (rows, m)
    B: Array  # (rows, k)
    N: Array  # (rows, 6)
    free: int  # degrees of freedom of the residuals


@dataclass(frozen=True)
class FrictionError:
    """Error of the friction model: a quadratic in standardised pressures times the direction of motion."""

    total: tuple[float, float]  # mean and standard deviation of P1 + P2 [Pa]
    difference: tuple[float, float]  # of P1 - P2 [Pa]

    @classmethod
    def of(cls, s: JointSamples) -> "FrictionError":
        """Return the error model for these samples."""
        return cls(*((float(P.mean()), max(float(P.std()), 1e-300)) for P in (s.P1 + s.P2, s.P1 - s.P2)))

    def columns(self, s: JointSamples) -> Array:
        """Return N (n, 6)."""
        (t0, t), (d0, d) = self.total, self.difference
        total, difference = (s.P1 + s.P2 - t0) / t, (s.P1 - s.P2 - d0) / d
        terms = (0 * total + 1, total, difference, total * difference, total**2, difference**2)
        return np.asarray(s.direction[:, None] * np.stack(terms, axis=1))


@dataclass(frozen=True)
class Discrepancy:
    """Posterior of the error of a fitted law."""

    field: ForceField
    friction: FrictionError
    root: Array  # A (m + k + 6, p) with M = A Aᵀ; zero for unknowns at a bound
    law: float  # RMS of g over the measured region, relative to the mean force [-]
    noise: float  # σ [rad]

    @property
    def terms(self) -> int:
        """Number k of the terms of g."""
        return int(_I.size)

    def angle_variance(self, problem: JointProblem, x: Array) -> Array:
        """Return the mean squared error (n,) [rad²] of the predicted angles at the samples of `problem`."""
        s = problem.samples
        G = np.hstack([-problem.jacobian(x)[: s.n], angle_effect(problem, x, self.field), self.friction.columns(s)])
        return np.asarray(np.square(G @ self.root).sum(axis=1))

    def outside(self, problem: JointProblem, x: Array) -> Array:
        """Return the muscles' distance from the measured region at the predicted angles (n,), in half widths."""
        s = problem.samples
        (eps1, *_), (eps2, *_), _ = s.routes(problem.equilibrium(problem.unknowns(x))[0])
        return np.maximum(self.field.outside(s.P1, eps1), self.field.outside(s.P2, eps2))


def discrepancy(problem: JointProblem, x: Array, inside: Mask, share_std: float) -> Discrepancy:
    """Return the discrepancy of the law at the solution `x`.

    Unknowns not `inside` the search count as known, the pull share φ (see `problem`) to ± `share_std`.
    """
    field, friction = ForceField.of(problem, problem.unknowns(x)), FrictionError.of(problem.samples)
    root, tau, sigma = _posterior(_evidence(problem, x, inside, field, share_std))
    rows = np.append(np.flatnonzero(inside), np.arange(x.size, x.size + root.shape[0] - inside.sum()))
    everything = np.zeros((rows[-1] + 1, root.shape[1]))
    everything[rows] = root
    return Discrepancy(field, friction, everything, tau * RMS_OF_FIELD, sigma)


RMS_OF_FIELD = float(np.sqrt(np.sum(_DECAY ** (2.0 * (_I + _J)) / ((2 * _I + 1) * (2 * _J + 1)))))  # of g/(F̄ τ)


def angle_effect(problem: JointProblem, x: Array, field: ForceField) -> Array:
    """Return ∂θ_eq/∂c (n, k) [rad]."""
    u, s = problem.unknowns(x), problem.samples
    theta, _ = problem.equilibrium(u)
    routes = s.routes(theta)
    (eps1, *_), (eps2, *_), _ = routes
    _, K, _, (pull1, pull2) = problem.balance(u, theta, routes)
    g1, g2 = field.values(s.P1, eps1)[0], u.ratio * field.values(s.P2, eps2)[0]
    with np.errstate(all="ignore"):
        effect = (pull1[:, None] * g1 - pull2[:, None] * g2) / K[:, None]
    return np.nan_to_num(effect, posinf=0.0, neginf=0.0)


def _evidence(problem: JointProblem, x: Array, inside: Mask, field: ForceField, share_std: float) -> Evidence:
    """Return the equations of the fit, φ being one of them with its own standard deviation."""
    s, u = problem.samples, problem.unknowns(x)
    problem = replace(problem, pull=None)
    angles = rms(problem.angle_error(x))
    weight = max(angles, _LEAST) / share_std
    share = weight * problem.gradient(lambda v: np.array([problem.pull_share(v)]), x)
    r, X = np.append(problem.residual(x), 0.0), np.vstack([-problem.jacobian(x), -share])[:, inside]
    B = np.zeros((r.size, _I.size))
    B[: s.n] = angle_effect(problem, x, field)
    g1, g2 = np.split(field.values(*s.muscles())[0], 2)
    given = problem.measured_forces(u).sum() / np.real(problem.pull_share(u))
    B[-1] = -weight * ((g1.sum(axis=0) + u.ratio * g2.sum(axis=0)) / given)  # ∂φ/∂c at constant gain of the law
    if problem.sag is not None:
        P, eps = problem.sag.muscles(u.zero)
        B[-1 - P.size : -1] = -problem.sag_weight * field.values(P, eps)[0] / u.muscle.gain(P, eps)[:, None]
    N = np.zeros((r.size, 6))
    N[: s.n] = FrictionError.of(s).columns(s)
    names = np.array(problem.names)[inside].tolist()
    loose = [_LOOSE.get(name, _PARAMETER * (abs(v) or 1.0)) for name, v in zip(names, x[inside].tolist(), strict=True)]
    m, prior = len(names), max(angles, _LEAST) / np.array([*loose, *[_FRICTION] * 6])
    free = int((X != 0).any(axis=1).sum()) - m - 6
    X, N = np.vstack([X, np.diag(prior)[:, :m]]), np.vstack([N, np.diag(prior)[:, m:]])
    return Evidence(np.append(r, 0 * prior), X, np.vstack([B, np.zeros((m + 6, _I.size))]), N, max(free, 1))


def _posterior(e: Evidence) -> tuple[Array, float, float]:
    """Return the root A (m + k + 6, p) of M in (D2), and the posterior means of τ and σ [rad].

    With the singular value decomposition X = U S Vᵀ and y = S Vᵀ dx all factors but the last, from y to dx, are well
    scaled. M is never formed: the unknowns differ by many orders of magnitude.
    """
    X, size = unit_columns(e.X)
    U, values, Vt = np.linalg.svd(X, full_matrices=False)
    known = values > _RANK * values.max(initial=0.0)
    to_x = Vt[known].T / values[known] / size[:, None]  # (m, rank)
    length = np.maximum(np.linalg.norm(e.N, axis=0), 1e-300)
    N = e.N / length
    W, flat, Wt = np.linalg.svd(np.hstack([U[:, known], N]), full_matrices=False)
    apart = flat > _APART
    Q = W[:, apart]
    solve = Wt[apart].T / flat[apart]  # (rank + 6, …): (y, b) = solve Qᵀ (r - B c - e), b in units of 1/length
    C, tau, sigma = _field(e.r - Q @ (Q.T @ e.r), e.B - Q @ (Q.T @ e.B), e.free)
    k, rank = e.B.shape[1], int(known.sum())
    values, vectors = np.linalg.eigh(C)
    of_field = vectors * np.sqrt(np.maximum(values, 0.0))  # root of C
    flat_part = solve @ np.hstack([Q.T @ np.column_stack([e.r, -e.B]) @ of_field, sigma * np.eye(Q.shape[1])])
    field_part = np.hstack([of_field[1:], np.zeros((k, Q.shape[1]))])
    return np.vstack([to_x @ flat_part[:rank], field_part, flat_part[rank:] / length[:, None]]), tau, sigma


def _field(y: Array, Z: Array, free: int) -> tuple[Array, float, float]:
    """Return E[(1, c)(1, c)ᵀ] (1 + k, 1 + k), τ and σ [rad] from y = Z c + e with `free` degrees of freedom."""
    Uz, sz, Vz = np.linalg.svd(Z, full_matrices=False)
    a = Uz.T @ y
    rest = max(float(y @ y - a @ a), 0.0) + _LEAST**2 * free
    C, tau, variance = np.zeros((1 + Z.shape[1],) * 2), 0.0, 0.0
    for weight, ratio, s2 in _weighted(a, sz, rest, free):
        shrunk = 1 + ratio * sz**2
        mean = np.append(1.0, Vz.T @ (ratio * sz / shrunk * a))
        C += weight * np.outer(mean, mean)
        C[1:, 1:] += weight * ratio * s2 * (np.eye(Z.shape[1]) - (Vz.T * (ratio * sz**2 / shrunk)) @ Vz)
        tau, variance = tau + weight * float(np.sqrt(ratio * s2)), variance + weight * s2
    return C, tau, float(np.sqrt(variance))


def _weighted(a: Array, sz: Array, rest: float, free: int) -> list[tuple[float, float, float]]:
    """Return the posterior weight, τ²/σ² and the profiled σ² [rad²] of each point of the grid that matters."""
    ratios = _GRID / max(float(np.mean(sz**2)), 1e-300)
    shrunk = 1 + ratios[:, None] * sz**2
    s2 = ((a**2 / shrunk).sum(axis=1) + rest) / free
    away = np.log(np.sqrt(ratios * s2) / _USUAL) / np.log(_FACTOR)
    score = -(free * np.log(s2) + np.log(shrunk).sum(axis=1) + away**2) / 2
    weight = np.exp(score - score.max())
    weight[weight < _NEGLIGIBLE] = 0.0
    weight /= weight.sum()
    used = weight > 0
    return list(zip(weight[used].tolist(), ratios[used].tolist(), s2[used].tolist(), strict=True))
