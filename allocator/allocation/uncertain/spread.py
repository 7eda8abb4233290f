"""The parameters' uncertainty is carried into force, torque and stiffness here (delta method).

The muscles' parameters p have the covariance C = L Lᵀ. A quantity with the gradient g = ∂/∂p has the standard deviation
‖Lᵀ g‖. Two equal muscles are one law used twice: they share their parameters, and their gradients are added. A joint
that was fitted as a whole has a covariance of its own, of the parameters of both muscles together.
"""

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
    """A `Spread` is Lᵀ∂/∂p of n answers; the norm of a row is a standard deviation."""

    torque: Array  # (n, m) [N·m]
    stiffness: Array  # (n, m) [N·m/rad]
    forces: tuple[Array, Array]  # (n, m1), (n, m2) [N]


def spread(problem: Problem, P1: Array, P2: Array) -> Spread:
    """Return the spread of everything at the pressures; a muscle without covariance counts as exactly known."""
    (one, two), joint = problem.sides, problem.joint
    root1, root2 = roots(joint)
    share, drag = _of_hysteresis(problem, P1 + P2)
    torque1, stiffness1, force1 = _of_muscle(one, P1, root1, share)
    torque2, stiffness2, force2 = _of_muscle(two, P2, root2, share)
    stiffness1, stiffness2 = stiffness1 + drag * torque1, stiffness2 - drag * torque2
    if joint.covariance is not None or joint.agonist == joint.antagonist:
        return Spread(torque1 + torque2, stiffness1 + stiffness2, (force1, force2))
    return Spread(np.hstack([torque1, torque2]), np.hstack([stiffness1, stiffness2]), (force1, force2))


def stiffness_std(problem: Problem, P1: Array, P2: Array) -> Array | None:
    """Return the standard deviation of K [N·m/rad] from the covariance of fitted muscles; None if neither has one."""
    if not _is_known(problem.joint):
        return None
    return np.asarray(np.linalg.norm(spread(problem, P1, P2).stiffness, axis=1))


def forces_std(problem: Problem, P1: Array, P2: Array) -> tuple[Array, Array] | None:
    """Return the standard deviations of both forces [N] from the covariance of fitted muscles; None without one."""
    if not _is_known(problem.joint):
        return None
    one, two = (np.asarray(np.linalg.norm(part, axis=1)) for part in spread(problem, P1, P2).forces)
    return one, two


def _is_known(joint: AntagonistJoint) -> bool:
    """Return whether there is a covariance of the joint or of one of its muscles."""
    return any(fitted.covariance is not None for fitted in (joint, joint.agonist, joint.antagonist))


def _of_hysteresis(problem: Problem, filled: Array) -> tuple[Array, float]:
    """Return the share (n,) of K and the share [1/rad] of the pull that hysteresis adds to the stiffness."""
    if problem.felt is None:
        share, drag = (0.0, 0.0) if problem.push is None else problem.push
        return np.full(filled.shape, share), drag
    return problem.felt.affine_at(filled)[0], problem.felt.drag


def _of_muscle(side: OneMuscle, P: Array, root: Array, share: Array) -> tuple[Array, Array, Array]:
    """Return (torque, stiffness, force) of one muscle, each (n, m), by its `root` (parameters, m).

    Hysteresis adds a `share` (n,) of the isobaric stiffness.
    """
    _, force, slope = parameter_sensitivities(side.muscle, P, side.contraction)
    force, slope = force @ root, slope @ root
    arm, bend = side.arm[:, None], side.bend[:, None]
    stiffness = (1 + share[:, None]) * (-(arm**2) / side.rest_length * slope + bend * force)
    if side.share is not None:
        stiffness = stiffness + np.asarray(side.share)[:, None] * (_trapped_gradient(side, P) @ root)
    return arm * force, stiffness, force


def _trapped_gradient(side: OneMuscle, P: Array) -> Array:
    """Return the derivatives of the trapped gas's stiffness by the muscle's parameters (n, parameters)."""
    return parameter_gradient(side.muscle, lambda m: replace(side, muscle=m).trapped(P), P.shape)


def roots(joint: AntagonistJoint) -> tuple[Array, Array]:
    """Return the rows of L (parameters, m) that belong to the agonist and to the antagonist."""
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
