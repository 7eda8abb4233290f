"""The tracking problem of an arm is that of a joint, with the sizes of n joints and m muscles."""

from collections.abc import Sequence

import numpy as np

from mpc.arm.model import Arm
from mpc.arm.tracking.prediction import predictor_of
from mpc.tracking.cost import diagonal
from mpc.tracking.limits import Limits
from mpc.tracking.qp.condense import TrackingProblem
from mpc.tracking.terminal import Middle, value_factor
from mpc.tracking.weights import Weights


def problem_of(arm: Arm, dt: float, weights: Weights, limits: Limits, blocks: Sequence[int]) -> TrackingProblem:
    """Return the problem of `arm` at the sample time `dt` [s]."""
    sizes = arm.n, arm.m, arm.stiffnesses
    L = value_factor(arm_middle(arm, dt), dt, weights, diagonal(weights, *sizes))
    return TrackingProblem(weights, limits, L, tuple(blocks), dt, *sizes)


def arm_middle(arm: Arm, dt: float) -> Middle:
    """Return the arm about rest in the middle, moved by no torque: gravity is held from outside."""
    q, P = arm.middle, np.full(arm.m, np.mean(arm.pressure_limits))
    x = np.concatenate([q, np.zeros(arm.n), P])
    held = arm.bodies.gravity_torque(q) - arm.mechanism.torque(q, P)
    model = predictor_of(arm, dt, 1).linearise(x, P[None], held[None])
    return Middle(model.A[0], model.B[0], model.slope[0])
