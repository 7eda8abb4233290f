"""The slacks have to be so dear that the soft limits of `mpc.tracking.controller` are as good as hard ones.

A penalty ρ s is exact, that is the soft problem has the hard one's solution and s = 0, when ρ is no less than the sum
of the multipliers of the rows that share s (Nocedal & Wright, Numerical Optimization, 2006, section 17.2). These grow
beyond bounds towards the states from which no limit could be kept; so they are measured over states near the limits,
and a weight takes a margin above what is met there.
"""

from collections.abc import Iterator
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.model.plant import NU
from mpc.tracking.controller import TrackingMPC
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.linearise import Predictor
from mpc.tracking.plan import PlanStatus
from mpc.tracking.qp.condense import SLACKS, condense
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver
from mpc.tracking.qp.step import certified

_EDGE = 0.15  # from an end of the joint range [rad]
_SPEED = 1.0  # standard deviation [rad/s]
_STEP = 0.3  # of the reference away from the state, standard deviation [rad]
_SPREAD = 0.05  # of the pressures away from rest, standard deviation, of the supply's range
_STIFFNESS = (1.0, 12.0)  # asked, beyond what joints have on either side [N·m/rad]


class Hard(NamedTuple):
    """A hard solution is that of a QP of the controller where no slack may be used."""

    qp: QP
    z: Array  # (n,)
    theta: float  # sum of the multipliers of the joint range [cost]/[rad]: ρ has to be as much
    force: float  # of the muscle forces [cost]/[N]: ρ_F has to be as much


def hard_solutions(controller: TrackingMPC, states: int, seed: int = 0) -> Iterator[Hard]:
    """Yield what `controller` would do with hard limits in `states` random states near them, where that is possible."""
    for qp in _near_limits(controller, states, np.random.default_rng(seed)):
        hard = replace(qp, upper=np.append(qp.upper[:-SLACKS], SLACKS * [0.0]))
        answer = certified(solver("daqp"), hard, inf, controller.problem.curvature)
        if answer.status is PlanStatus.OPTIMAL:
            pushes = np.abs(answer.multipliers[qp.f.size :])
            theta, force = (float(pushes @ (column != 0)) for column in qp.R[:, -SLACKS:].T)
            yield Hard(qp, answer.z, theta, force)


def _near_limits(controller: TrackingMPC, states: int, rng: np.random.Generator) -> Iterator[QP]:
    plant, dt, N = controller.plant, controller.dt, controller.N
    inverse, predictor = InverseDynamics(plant, dt, N, controller.min_force), Predictor(plant, dt, N)
    left, right = plant.joint.angle_range
    low, high = plant.joint.pressure_limits
    for _ in range(states):
        theta = rng.choice([rng.uniform(left, right), left + _EDGE * rng.random(), right - _EDGE * rng.random()])
        x = plant.at_rest(theta, rng.uniform(*_STIFFNESS))
        x[1] = _SPEED * rng.normal()
        x[2:] = np.clip(x[2:] + _SPREAD * (high - low) * rng.normal(size=NU), low, high)
        ones = np.ones(N + 1)
        feed = inverse((theta + _STEP * rng.normal()) * ones, rng.uniform(*_STIFFNESS) * ones)
        model = predictor.linearise(x, controller.limits.limited(x[2:], feed.u))
        yield condense(controller.problem, model, feed, x[2:], feed.u[0])
