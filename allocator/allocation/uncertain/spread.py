"""Standard deviations of force, torque and stiffness from the covariance of the muscles' parameters (delta method).

The muscles' parameters p have the covariance C = L Lᵀ. A quantity with the gradient g = ∂/∂p has the standard deviation
‖Lᵀ g‖. Equal muscles are one law used several times: they share their parameters, so their gradients add up. A joint
fitted as a whole has its own covariance of the parameters of both muscles.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator import checks
from allocator.allocation.two_muscles.problem import Problem
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles import Muscle, parameter_sensitivities
from allocator.muscles.uncertainty import covariance_root, parameter_gradient


class Spread(NamedTuple):
    """Lᵀ∂/∂p of N answers along the last axis; its norm is a standard deviation."""

    torque: Array  # (N, r) of a joint, (N, n, r) of a mechanism [N·m]
    stiffness: Array  # (N, r), (N, n, n, r) [N·m/rad]
    forces: tuple[Array, ...]  # (N, r_j) of each muscle [N]

    @property
    def stiffness_std(self) -> Array:
        """Standard deviation of K (N,) or (N, n, n) [N·m/rad]."""
        return np.asarray(np.linalg.norm(self.stiffness, axis=-1))

    @property
    def forces_std(self) -> Array:
        """Standard deviations of the forces (N, m) [N]."""
        return np.stack([np.linalg.norm(force, axis=-1) for force in self.forces], axis=-1)


def spread(problem: Problem, P1: Array, P2: Array) -> Spread:
    """Return the spread of two muscles at the pressures; a muscle without covariance counts as exact."""
    joint, hysteresis = problem.joint, _of_hysteresis(problem, P1 + P2)
    law = (0, 0) if joint.covariance is not None or joint.agonist == joint.antagonist else (0, 1)
    return spread_of(problem.sides, (P1, P2), roots(joint), law, hysteresis)


def spread_of(
    muscles: Sequence[OneMuscle],
    pressures: Sequence[Array],
    roots: Sequence[Array],
    laws: Sequence[int],
    hysteresis: tuple[Array | float, float] = (0.0, 0.0),
) -> Spread:
    """Return the spread of muscles at pressures (N,) each, by the rows of L of each muscle.

    Muscles with the same number in `laws` share their parameters. `hysteresis` adds a share of the isobaric stiffness
    and a share [1/rad] of the pull.
    """
    found = [_of_muscle(*given, *hysteresis) for given in zip(muscles, pressures, roots, strict=True)]

    def added(which: int) -> Array:
        groups = (
            [part[which] for part, own in zip(found, laws, strict=True) if own == law] for law in sorted(set(laws))
        )
        return np.concatenate([sum(group) for group in groups], axis=-1)

    return Spread(added(0), added(1), tuple(part[2] for part in found))


def of_joint(problem: Problem, P1: Array, P2: Array) -> Spread | None:
    """Return the spread by the covariance of a fitted joint or of its muscles; None if none of them has one."""
    return spread(problem, P1, P2) if _is_known(problem.joint) else None


def of_mechanism(muscles: Sequence[OneMuscle], pressures: Sequence[Array]) -> Spread | None:
    """Return the spread by the covariances of a mechanism's muscles; None if none of them has one."""
    laws = [side.muscle for side in muscles]
    if all(law.covariance is None for law in laws):
        return None
    return spread_of(muscles, pressures, list(map(_root_of, laws)), [laws.index(law) for law in laws])


def _is_known(joint: AntagonistJoint) -> bool:
    """Return whether there is a covariance of the joint or of one of its muscles."""
    return any(fitted.covariance is not None for fitted in (joint, joint.agonist, joint.antagonist))


def _of_hysteresis(problem: Problem, filled: Array) -> tuple[Array | float, float]:
    """Return the share (n,) of K and the share [1/rad] of the pull that hysteresis adds to the stiffness."""
    if problem.felt is None:
        return (0.0, 0.0) if problem.push is None else problem.push
    return problem.felt.affine_at(filled)[0], problem.felt.drag


def _of_muscle(side: OneMuscle, P: Array, root: Array, share: Array | float, drag: float) -> tuple[Array, Array, Array]:
    """Return (torque, stiffness, force) of one muscle, parameters' directions last, by its `root` (parameters, r)."""
    shape = np.broadcast_shapes(P.shape, np.shape(side.contraction))
    P, eps = np.broadcast_to(P, shape), np.broadcast_to(side.contraction, shape)
    _, force, slope = parameter_sensitivities(side.muscle, P, eps)
    force, slope = force @ root, slope @ root
    columns = [side.added(F, -k / side.rest_length) for F, k in zip(force.T, slope.T, strict=True)]
    torque, stiffness = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in zip(*columns, strict=True))
    if np.any(share) or drag:
        pull = drag * side.moment_arm[:, None] * force
        stiffness = (1 + np.asarray(share)[..., None]) * stiffness + pull
    if side.share is not None:
        trapped = _trapped_gradient(replace(side, contraction=eps), P)  # (N, …, parameters)
        stiffness = stiffness + np.asarray(side.share).reshape(-1, *[1] * (trapped.ndim - 1)) * (trapped @ root)
    return torque, stiffness, force


def _trapped_gradient(side: OneMuscle, P: Array) -> Array:
    """Return the derivatives of the trapped gas's stiffness by the muscle's parameters, which come last."""
    return parameter_gradient(side.muscle, lambda m: replace(side, muscle=m).trapped(P), np.shape(side.trapped(P)))


def roots(joint: AntagonistJoint) -> tuple[Array, Array]:
    """Return the rows of L (parameters, m) of the agonist and of the antagonist."""
    if joint.covariance is None:
        return _root_of(joint.agonist), _root_of(joint.antagonist)
    root = covariance_root(joint.covariance)
    split = len(joint.agonist.parameters)
    return root[:split], root[split:]


def _root_of(muscle: Muscle) -> Array:
    if muscle.covariance is None:
        return np.zeros((len(muscle.parameters), 1))
    return covariance_root(muscle.covariance)


def with_covariance(joint: AntagonistJoint, uncertainty: object) -> AntagonistJoint:
    """Return the joint with the covariance of its muscles' parameters: their own (True), one matrix or a pair."""
    if not joint.affine:
        raise InvalidInput("uncertainty needs muscles affine in pressure: only then the problem is convex")
    if uncertainty is True:
        if not _is_known(joint):
            raise InvalidInput("uncertainty = True, but the muscles have no covariance: fit them, or pass a matrix")
        return joint
    pair = uncertainty if isinstance(uncertainty, tuple) else (uncertainty, uncertainty)
    if len(pair) != 2:
        raise InvalidInput("uncertainty has to be True, a covariance matrix, or a pair of them (agonist, antagonist)")
    one, two = (checks.covariance("uncertainty", matrix) for matrix in pair)
    agonist, antagonist = replace(joint.agonist, covariance=one), replace(joint.antagonist, covariance=two)
    return replace(joint, agonist=agonist, antagonist=antagonist, covariance=None)
