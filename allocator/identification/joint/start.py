"""Where the search for a joint's muscles starts: an equation error, linear in what the muscles are made of.

At the measured angles the equilibrium G = 0 is linear in every parameter c in which the force is linear, the others q
held. With the conventions of the problem (force scale, pull share φ*) as equations beside it,

    minimise over q   min over c  Σ (G_i / K_i)²,   K_i ∝ P1 + P2                               (variable projection)

the linear ones are eliminated. That is repeated from the q of physically different muscles, which the model's recipe
names. Models without linear parameters start from a muscle F = P A(ε) with A = α0 + α1 ε + α2 ε²: any model is fitted
to its forces as if they had been measured, which puts its parameters where the angles are about right.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import CONVENTIONAL_AREA, JointProblem
from allocator.identification.joint.samples import JointSamples
from allocator.identification.least_squares import solve, unit_columns
from allocator.identification.muscle.fit import fit
from allocator.muscles import Muscle, Recipe
from allocator.muscles.recipe import among

_CONVENTION_WEIGHT = 1e3
_SHARE_WEIGHT = 0.1  # of the pull share: weak, as some laws have one that cannot be changed
_MOST_SAMPLES = 300  # of the pseudo-measurement
_EVALUATIONS = 30
_PULL_SHARE = 0.5  # where the problem sets none
_FRICTION = 0.05


class PseudoForces(NamedTuple):
    """Pseudo-forces are those that explain the equilibria roughly."""

    contraction: Array  # (k,) [-]
    pressure: Array  # (k,) [Pa]
    force: Array  # (k,) [N]


def pseudo_forces(samples: JointSamples) -> PseudoForces:
    """Return the forces of both muscles at the samples."""
    (eps1, a1, _), (eps2, a2, _), _ = samples.routes(np.clip(samples.theta, *samples.reach()))
    one, two = _basis(samples.P1, eps1), _basis(samples.P2, eps2)  # (n, 3)
    still = samples.torque == 0 if (samples.torque == 0).sum() > 3 else np.ones(samples.n, bool)
    rows = (a1[:, None] * one - a2[:, None] * two)[still]
    convention = _basis(1.0, eps1).mean(axis=0)
    _, size = unit_columns(rows)
    scale = np.linalg.norm(rows) / np.linalg.norm(convention)
    A = np.vstack([rows, _CONVENTION_WEIGHT * scale * convention])
    b = np.append(np.zeros(still.sum()), _CONVENTION_WEIGHT * scale)
    p = np.linalg.lstsq(A / size, b, rcond=1e-9)[0] / size
    F = np.concatenate([one @ p, two @ p]) * CONVENTIONAL_AREA
    return PseudoForces(np.concatenate([eps1, eps2]), np.concatenate([samples.P1, samples.P2]), F)


def _basis(P: Array | float, eps: Array) -> Array:
    return np.stack([P + 0 * eps, P * eps, P * eps**2], axis=1)


def starting_muscle(model: type[Muscle], samples: JointSamples, hold: Mapping[str, float]) -> Muscle:
    """Return the muscle of this model that comes nearest to the pseudo-forces."""
    eps, P, F = pseudo_forces(samples)
    every = max(1, eps.size // _MOST_SAMPLES)
    try:
        return fit(model, eps[::every], P[::every], F[::every], hold=hold, folds=0).muscle
    except InvalidInput as error:
        raise InvalidInput(
            f"no start for {model.__name__} was found in these equilibria ({error}); pass start="
        ) from None


def first_guess(problem: JointProblem) -> Array:
    """Return the prototype's parameters, and no ratio, zero or constant friction yet."""
    values = problem.prototype.parameters
    return np.array([values.get(name, _FRICTION if name == "friction" else 0.0) for name in problem.names])


def starts(problem: JointProblem, recipe: Recipe[Muscle]) -> Iterator[Array]:
    """Yield where to start the search (m,): the prototype, then what variable projection makes of it and the recipe."""
    guess = first_guess(problem)
    linear = np.array([name in problem.free and among(name, recipe.linear) for name in problem.names], bool)
    if not linear.any() or guess[linear].any():
        yield guess
    if not linear.any():
        return
    projection = Projection.of(problem, linear)
    different = [projection.rest(guess)]
    for muscle in recipe.starts:
        values = dict(zip(problem.names, guess.tolist(), strict=True)) | muscle.parameters
        different.append(projection.rest(np.array([values[name] for name in problem.names])))
    yielded: list[Array] = []
    for q in np.unique(np.array(different), axis=0):
        x = projection.solved(q)
        if not any(np.allclose(x, other, rtol=1e-3) for other in yielded):
            yielded.append(x)
            yield x


@dataclass(frozen=True)
class Projection:
    """A `Projection` is the equation error of a problem with the linear unknowns eliminated."""

    problem: JointProblem
    linear: Mask  # (m,) marks the unknowns c; the others are q
    weight: Array  # 1/K_i (n,), up to a factor
    share: float  # φ*

    @classmethod
    def of(cls, problem: JointProblem, linear: Mask) -> "Projection":
        """Return the projection of this problem's equations."""
        s, pull = problem.samples, problem.pull
        total = s.P1 + s.P2
        share = _PULL_SHARE if pull is None else pull.value
        return cls(problem, linear, total.mean() / np.maximum(total, 0.1 * total.mean()), share)

    def rest(self, x: Array) -> Array:
        """Return the unknowns q of x, inside their bounds."""
        q, (low, high) = x[~self.linear], self._bounds
        width = np.where(np.isfinite(high - low), high - low, np.abs(q) + 1.0)
        return np.clip(q, low + 1e-3 * width, high - 1e-3 * width)

    @property
    def _bounds(self) -> tuple[Array, Array]:
        return self.problem.lower[~self.linear], self.problem.upper[~self.linear]

    def solved(self, q: Array) -> Array:
        """Return all unknowns (m,) at the least equation error that is found from `q`."""
        from scipy.optimize import least_squares

        if q.size:
            with np.errstate(all="ignore"):
                found = least_squares(
                    lambda v: self._eliminated(v)[1], q, bounds=self._bounds, x_scale="jac", max_nfev=_EVALUATIONS
                )
            q = found.x
        return np.clip(self._eliminated(q)[0], self.problem.lower, self.problem.upper)

    def _eliminated(self, q: Array) -> tuple[Array, Array]:
        """Return all unknowns (m,) with the best linear ones, and the equation errors (n + 2,) left."""
        x = np.zeros(self.linear.size)
        x[~self.linear] = q
        b = self._equations(x)
        columns = []
        for i in np.flatnonzero(self.linear):
            x[i] = 1.0
            columns.append(self._equations(x) - b)
            x[i] = 0.0
        A = np.stack(columns, axis=1)
        good = np.isfinite(A).all(axis=1) & np.isfinite(b)
        x[self.linear] = solve(A[good], -b[good], rcond=1e-10)
        left = A @ x[self.linear] + b
        return x, np.where(np.isfinite(left), left, _CONVENTION_WEIGHT)

    def _equations(self, x: Array) -> Array:
        """Return the equation errors (n,) and the conventions (2,), affine in the linear unknowns."""
        problem, s = self.problem, self.problem.samples
        u = problem.unknowns(x)
        routes = s.routes(np.clip(s.theta - u.zero, *s.reach()))
        (eps1, a1, _), (eps2, *_), _ = routes
        balance = problem.balance(u, s.theta, routes)
        one, two = balance.forces
        with np.errstate(all="ignore"):
            given = s.P1 * u.muscle.gain(s.P1, eps1), u.ratio * s.P2 * u.muscle.gain(s.P2, eps2)
        usual = float(np.mean(s.P1) * np.mean(a1)) * CONVENTIONAL_AREA  # [N·m]
        share = _SHARE_WEIGHT * (one.sum() + two.sum() - self.share * (given[0].sum() + given[1].sum()))
        conventions = [share / (s.n * usual / np.mean(a1))]
        if problem.conventional:
            conventions.append(_CONVENTION_WEIGHT * (problem.mean_area(u).real / CONVENTIONAL_AREA - 1))
        return np.concatenate([self.weight * balance.lacking / usual, conventions])
