"""Controller of an arm that takes no compiler."""

import numpy as np

from mpc.tracking.limits import Limits
from mpc.tracking.plan import Plan, PlanStatus, Rung, Times


class ArmPD:
    """Controller by the pressures for the torque of the reference and of its error."""

    ahead = 2

    def __init__(self, plant, dt):
        self.plant, self.dt, self._limits = plant, dt, Limits.of(plant, dt)
        self.reset()

    def reset(self):
        self._sent = None

    def step(self, x, q_ref, K_ref, d=0.0):
        n, (q, K) = (
            self.plant.n,
            (np.reshape(q_ref, (-1, self.plant.n)), np.reshape(K_ref, (-1, *np.shape(K_ref)[-2:]))),
        )
        ahead = q[-1] - q[0]
        alpha = (q[-1] - 2 * q[len(q) // 2] + q[0]) / self.dt**2 if len(q) == 3 else 0.0 * ahead
        back = np.nan_to_num(20.0 * (q[0] - x[:n]) + 2.0 * (ahead / self.dt / 2 - x[n : 2 * n]))
        T = self.plant.torque_for(q[0], 0.0 * ahead, alpha) + back
        wanted = self.plant.held(q[:1], K[:1], T[None], 0.0).P
        last = x[2 * n :] if self._sent is None else self._sent
        self._sent = self._limits.limited(last, wanted)[0]
        moved = np.stack([x, x]), self.plant.along(np.stack([x, x]))[0]
        return Plan(self._sent[None].copy(), *moved, PlanStatus.CLOSED_FORM, Rung.ALLOCATION, 0.0, Times(*5 * (0.0,)))
