"""Changes of stiffness and forces at the samples, and the changes of a fit's unknowns that imitate them.

A joint carries its uncertainty as a covariance of parameters. What errs besides the parameters (the form of the law,
the common force) is therefore evaluated in K, F1 and F2 at the samples, relative, and in the unknowns that are no
parameters of the muscle (ratio, zero, friction). The change d of the unknowns that comes nearest to it is

    minimise |G d - t|²,   G = ∂(K/K, w F1/F̄, w F2/F̄, extra)/∂x

by a truncated singular value decomposition: directions of d that move stiffness and forces by less than a
thousandth of what single unknowns do are left alone, since an error of the linearisation would become a huge change
along them.
"""

from dataclasses import dataclass
from typing import Self

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.joint import gradients
from allocator.identification.joint.doubt.discrepancy import Discrepancy
from allocator.identification.joint.problem import JointProblem, Unknowns
from allocator.identification.joint.report import parameter_jacobian
from allocator.identification.least_squares import solve, unit_columns
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import force_gradient, scaled

_FORCE_WEIGHT = 0.3  # w, of a relative change of force, in that of a stiffness
_RANK = 1e-3  # singular values of G, its columns scaled to one, in the greatest
_WIDENED = 1.25  # standard deviations: what the linearisation misses, from benchmarks.joint_coverage, seeds below 1000
_LEAST_STIFFNESS = 0.3  # of the median, that a change of K is divided by


@dataclass(frozen=True)
class Effects:
    """Stiffness and forces of a fit at the measured angles and pressures, and their gradients."""

    problem: JointProblem
    x: Array  # (m,)
    inside: Mask  # (m,) unknowns that are not at a bound
    theta: Array  # true angles of the fit (n,) [rad]
    scale: Array  # (3n,) that K [N·m/rad], F1 and F2 [N] are divided by
    gradient: Array  # G (3n + extra, m inside)

    @classmethod
    def of(cls, problem: JointProblem, x: Array, inside: Mask) -> Self:
        """Return the effects at the solution `x`."""
        u, s = problem.unknowns(x), problem.samples
        theta = s.theta - u.zero
        values, slopes = np.empty((3, s.n)), np.empty((3, s.n, x.size))
        J = parameter_jacobian(problem, u)
        for here, joint in _joints(problem, u):
            at = theta[here], s.P1[here], s.P2[here]
            K = gradients.stiffness(joint, *at)
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
        """Return what another fit, or another law, changes (3n + extra,)."""
        now, u, s = self.problem.unknowns(self.x), other.unknowns(there), self.problem.samples
        changes = np.empty((3, s.n))
        for (here, one), (_, two) in zip(_joints(self.problem, now), _joints(self.problem, u), strict=True):
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
        """Return the covariance of the unknowns (m, m) that stands for the error of the fit and of its law."""
        u, s = self.problem.unknowns(self.x), self.problem.samples
        field = np.zeros((3, s.n, found.terms))
        for i, (_, geometry) in enumerate(s.groups):
            here = s.group == i
            field[:, here] = found.field.effects(geometry, u, self.theta[here], s.P1[here], s.P2[here])
        targets = self.gradient @ self._with_friction(found)[self.inside]
        of_field = found.root[self.x.size : self.x.size + found.terms]
        targets[: 3 * s.n] += field.reshape(3 * s.n, -1) @ of_field / self.scale[:, None]
        root = self.imitated(targets)
        left = (targets - self.gradient @ root[self.inside])[: s.n]  # of K, what no change of the unknowns imitates
        lost = float(np.square(left).sum(axis=1).mean())
        return np.asarray(_WIDENED**2 * (root @ root.T + lost * self._even()))

    def _with_friction(self, found: Discrepancy) -> Array:
        """Return the root (m, p) of the unknowns, μ with the part of the friction error that μ would describe."""
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


def _joints(problem: JointProblem, u: Unknowns) -> list[tuple[Mask, AntagonistJoint]]:
    """Return the samples and the joint of each group."""
    s, antagonist = problem.samples, scaled(u.muscle, float(u.ratio))
    return [
        (s.group == i, AntagonistJoint(group.geometry, u.muscle, antagonist, min_contraction=-0.3))
        for i, group in enumerate(s.groups)
    ]


def _values(joint: AntagonistJoint, theta: Array, P1: Array, P2: Array) -> Array:
    """Return K, F1 and F2 (3, n)."""
    one, two = joint.sides(theta)
    with np.errstate(all="ignore"):
        F1, F2 = one.force(P1), two.force(P2)
        return np.stack([one.stiffness(P1) + two.stiffness(P2), F1, F2])


def _scale(values: Array) -> Array:
    """Return what K, F1 and F2 (3, n) are divided by (3n,)."""
    K, F1, F2 = values
    force = float(np.abs(np.concatenate([F1, F2])).mean()) / _FORCE_WEIGHT
    least = _LEAST_STIFFNESS * float(np.median(np.abs(K)))
    return np.concatenate([np.maximum(np.abs(K), least), np.full(2 * K.size, force)])
