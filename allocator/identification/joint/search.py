"""Search for the unknowns of a joint's fit: least squares from several starts, and a test of convergence.

A search has converged if no Gauss–Newton step, full or shortened, lowers the cost by 1 % of σ² =
cost/(rows - unknowns): the unknowns are then about a tenth of a standard deviation from the local minimum. The step
changes the unknowns without an active bound, in the directions that the equations determine. If it helps after SciPy's
trust region has stopped in a curved valley, the search continues from there. Only the best of several starts is
followed to convergence.

The starts come from an equation error. At the measured angles the equilibrium G = 0 is linear in every parameter c in
which the force is linear, at constant other parameters q. With the conventions of the problem (force scale, pull share
φ*) as further equations,

    minimise over q   min over c  Σ (G_i / K_i)²,   K_i ∝ P1 + P2                               (variable projection)

the linear ones are eliminated. That is repeated from the q of physically different muscles in the model's recipe.
Models without linear parameters start from a muscle F = P A(ε) with A = α0 + α1 ε + α2 ε²: the model is fitted to its
forces as if they had been measured, so that its angles are approximately correct.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.joint.problem import CONVENTIONAL_AREA, FITTED_GRAVITY, JointProblem
from allocator.identification.joint.samples import JointSamples, Routes
from allocator.identification.least_squares import solve, unit_columns
from allocator.identification.muscle.fit import fit
from allocator.joint.gravity import NO_GRAVITY
from allocator.muscles import Muscle, Recipe, scaled
from allocator.muscles.recipe import among
from allocator.units import DEG

_TOLERANCE = 1e-6
_TINY = 1e-10
_FIRST_EVALUATIONS = 25
_EVALUATIONS = 100
_ROUNDS = 5
_GAIN = 0.01  # of σ²
_EXACT = 1e-16  # [rad²] a smaller cost per row is zero: simulated data without noise
_PARTS = (1.0, 0.3, 0.1, 0.03)  # of a Gauss–Newton step
_KNOWN = 1e-8  # singular values below this share of the greatest belong to no determined direction
_SEEN = 3.0  # standard deviations beyond which the deflection by a weight is significant
_WANTED = 0.05  # relative accuracy of the deflection by a useful weight
_CONVENTION_WEIGHT = 1e3
_SHARE_WEIGHT = 0.1  # of the pull share: weak, as it is fixed in some laws
_MOST_SAMPLES = 300  # of the pseudo-measurement
_PROJECTIONS = 30  # evaluations
_PULL_SHARE = 0.5  # if the problem sets none
_FRICTION = 0.05


def minimise(problem: JointProblem, x: Array, rounds: int = _ROUNDS) -> tuple[Array, bool]:
    """Return x at the least cost found from `x` in `rounds` rounds, and whether it converged."""
    if not x.size:
        return x, True
    for _ in range(rounds):
        x = _searched(problem, x, _EVALUATIONS)
        better = _improved(problem, x)
        if better is None:
            return x, True
        x = better
    return x, False


def best_start(problem: JointProblem, starts: Iterable[Array]) -> Array:
    """Return the x of the search from the `starts` (m,) that leads after some steps."""
    begun = [_searched(problem, x, _FIRST_EVALUATIONS) for x in starts]
    costs = [float(r @ r) for r in map(problem.residual, begun)]
    return begun[int(np.argmin(costs))]


def _searched(problem: JointProblem, x: Array, evaluations: int) -> Array:
    from scipy.optimize import least_squares

    if not x.size:
        return x
    width = problem.upper - problem.lower
    edge = 1e-4 * np.where(np.isfinite(width), width, np.maximum(np.abs(x), 1e-9))
    inside = np.clip(x, problem.lower + edge, problem.upper - edge)
    with np.errstate(all="ignore"):  # SciPy handles vanishing singular values itself
        found = least_squares(
            problem.residual,
            inside,
            problem.jacobian,
            bounds=(problem.lower, problem.upper),
            x_scale="jac",
            ftol=_TOLERANCE,
            xtol=_TINY,
            gtol=_TINY,
            max_nfev=evaluations,
        )
    return np.asarray(found.x)


def _improved(problem: JointProblem, x: Array) -> Array | None:
    r = problem.residual(x)
    cost, rows = float(r @ r), max(problem.samples.n - x.size, 1)
    enough = max(_GAIN * cost / rows, _EXACT * rows)
    step, promised = _gauss_newton(problem, x, r)
    if promised <= enough:
        return None
    for part in _PARTS:
        moved = np.clip(x + part * step, problem.lower, problem.upper)
        there = problem.residual(moved)
        if cost - float(there @ there) > enough:
            return moved
    return None


def _gauss_newton(problem: JointProblem, x: Array, r: Array) -> tuple[Array, float]:
    """Return the step (m,) of the unknowns without an active bound, and its decrease of the linearised cost."""
    J = problem.jacobian(x)
    width = np.where(np.isfinite(problem.upper - problem.lower), problem.upper - problem.lower, 0.0)
    near, downhill = 1e-4 * np.maximum(np.abs(x), 1e-2 * width), -J.T @ r
    free = ~(((x - problem.lower < near) & (downhill < 0)) | ((problem.upper - x < near) & (downhill > 0)))
    step = np.zeros(x.size)
    step[free] = -solve(J[:, free], r, rcond=_KNOWN)
    gain = J[:, free] @ step[free]
    return step, float(gain @ gain)


class Unscaled(InvalidInput):
    """The deflections by weights give a shape no force scale; `scatter` [rad] is their error."""

    def __init__(self, reason: str, scatter: float) -> None:
        super().__init__(reason)
        self.scatter = scatter


def scale_shape(problem: JointProblem, x: Array) -> Array:
    """Return the unknowns `x` of a shape, on the force scale that gives the measured deflections by weights.

    Raises `Unscaled`.
    """
    hung = replace(problem.on(problem.samples.torque != 0), gravity=NO_GRAVITY)  # the muscles of a shape contain it
    unloaded = replace(hung, samples=replace(hung.samples, torque=0 * hung.samples.torque))
    u = problem.unknowns(x)
    theta, _ = unloaded.equilibrium(u)
    K = unloaded.balance(u, theta).stiffness
    factor = _force_scale(hung.samples, hung.samples.theta - unloaded.predicted(u), -hung.samples.torque / K)
    values = scaled(replace(u.muscle), factor).parameters
    values |= {name: factor * getattr(u, name) for name in ("coulomb", *FITTED_GRAVITY)}
    return np.array([values.get(name, value) for name, value in zip(problem.names, x.tolist(), strict=True)])


def _pseudo_forces(samples: JointSamples) -> tuple[Array, Array, Array]:
    """Return contraction [-], pressure [Pa] and force [N] of both muscles (2n,) that roughly explain the equilibria."""
    (eps1, a1, _), (eps2, a2, _), _ = samples.routes(samples.true_angles(samples.zero))
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
    return np.concatenate([eps1, eps2]), np.concatenate([samples.P1, samples.P2]), F


def _basis(P: Array | float, eps: Array) -> Array:
    return np.stack([P + 0 * eps, P * eps, P * eps**2], axis=1)


def starting_muscle(model: type[Muscle], samples: JointSamples, hold: Mapping[str, float]) -> Muscle:
    """Return the muscle of this model nearest to the pseudo-forces."""
    eps, P, F = _pseudo_forces(samples)
    every = max(1, eps.size // _MOST_SAMPLES)
    try:
        return fit(model, eps[::every], P[::every], F[::every], hold=hold, folds=0).muscle
    except InvalidInput as error:
        raise InvalidInput(
            f"no start for {model.__name__} was found in these equilibria ({error}); pass start="
        ) from None


def first_guess(problem: JointProblem) -> Array:
    """Return the prototype's parameters and the samples' rough zero, without ratio or constant friction."""
    values = problem.prototype.parameters | {"friction": _FRICTION, "zero": problem.samples.zero}
    return np.array([values.get(name, 0.0) for name in problem.names])


def starts(problem: JointProblem, recipe: Recipe[Muscle]) -> Iterator[Array]:
    """Yield starts of the search (m,): the prototype, then variable projections of it and of the recipe."""
    guess = first_guess(problem)
    linear = np.array(
        [name in FITTED_GRAVITY or (name in problem.free and among(name, recipe.linear)) for name in problem.names],
        bool,
    )
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
    """Equation error of a problem with the linear unknowns eliminated."""

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
        """Return all unknowns (m,) at the least equation error found from `q`."""
        from scipy.optimize import least_squares

        if q.size:
            with np.errstate(all="ignore"):
                found = least_squares(
                    lambda v: self._eliminated(v)[1], q, bounds=self._bounds, x_scale="jac", max_nfev=_PROJECTIONS
                )
            q = found.x
        return np.clip(self._eliminated(q)[0], self.problem.lower, self.problem.upper)

    def _eliminated(self, q: Array) -> tuple[Array, Array]:
        """Return all unknowns (m,) with the best linear ones, and the remaining equation errors (n + 2,)."""
        x = np.zeros(self.linear.size)
        x[~self.linear] = q
        s, zero = self.problem.samples, self.problem.unknowns(x).zero
        routes = s.routes(s.true_angles(zero))  # the same for all linear unknowns
        b = self._equations(x, routes)
        columns = []
        for i in np.flatnonzero(self.linear):
            x[i] = 1.0
            columns.append(self._equations(x, routes) - b)
            x[i] = 0.0
        A = np.stack(columns, axis=1)
        good = np.isfinite(A).all(axis=1) & np.isfinite(b)
        x[self.linear] = solve(A[good], -b[good], rcond=1e-10)
        left = A @ x[self.linear] + b
        return x, np.where(np.isfinite(left), left, _CONVENTION_WEIGHT)

    def _equations(self, x: Array, routes: Routes) -> Array:
        """Return the equation errors (n,) and the conventions (2,), affine in the linear unknowns."""
        problem, s = self.problem, self.problem.samples
        u = problem.unknowns(x)
        theta, (eps1, a1, _), (eps2, *_), _ = s.true_angles(u.zero), *routes
        lacking, (one, two), _ = problem.torques(u, theta, routes)
        with np.errstate(all="ignore"):
            given = s.P1 * u.muscle.gain(s.P1, eps1), u.ratio * s.P2 * u.muscle.gain(s.P2, eps2)
        arm = np.mean(a1)
        usual = float(self._pressure * arm) * CONVENTIONAL_AREA  # [N·m]
        share = _SHARE_WEIGHT * (one.sum() + two.sum() - self.share * (given[0].sum() + given[1].sum()))
        conventions = [share / (s.n * usual / arm)]
        if problem.conventional:
            conventions.append(_CONVENTION_WEIGHT * (problem.mean_area(u).real / CONVENTIONAL_AREA - 1))
        return np.concatenate([self.weight * lacking / usual, conventions])

    @cached_property
    def _pressure(self) -> float:
        """Mean pressure of the agonist [Pa]."""
        return float(np.mean(self.problem.samples.P1))


def _force_scale(samples: JointSamples, deflection: Array, expected: Array) -> float:
    """Return the force scale [-] of a shape, from the `deflection` and the `expected` one (n,) [rad] under weights.

    Refuses a weight that pulls in the wrong direction, or has a deflection below the scatter, and suggests another.
    """
    compliance = float(deflection @ expected / (expected @ expected))
    error = deflection - compliance * expected
    scatter = float(np.sqrt(error @ error / max(samples.n - 1, 1)))
    std = scatter / float(np.linalg.norm(expected))
    if compliance > _SEEN * std:
        return 1 / compliance
    W, most = float(np.abs(samples.torque).max()), float(np.abs(expected).max())
    if compliance < -_SEEN * std:
        raise Unscaled(
            f"torque of {W:.3g} N·m moves the joint by {-compliance * most / DEG:.2g}° the wrong way: it has to be "
            "positive where the weight pulls θ down; turn its sign",
            scatter,
        )
    wanted = W * std / _WANTED / max(abs(compliance), std)
    raise Unscaled(
        f"torque of {W:.3g} N·m moves the joint by {compliance * most / DEG:.2g}° ± {std * most / DEG:.2g}°, which "
        f"drowns in a scatter of {scatter / DEG:.2g}°: the force scale would be chance; hang about {wanted:.2g} N·m on "
        "either side",
        scatter,
    )
