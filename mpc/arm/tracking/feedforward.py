"""The feed-forward of an arm would follow a preview exactly, if the model were right and nothing limited.

The motion needs the torques τ = M(q) q'' + C(q, q') + D q' + g(q) - d; the batch allocation turns (q, K, τ) at all N+1
samples into pressures, bringing what cannot be reached to the nearest that can; and the lag over a sample of constant
command, P_{k+1} = α P_k + (1 - α) u_k, α = exp(-dt/τ), is inverted for the commands.
"""

from typing import Any

import numpy as np

from allocator.allocation import allocate
from allocator.calculus import Array
from allocator.joint.gas import Stiffness
from allocator.joint.limits import Limits
from allocator.mechanism import warm_up
from mpc.arm.model import Arm
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.plan import Moved


class ArmInverseDynamics:
    """The inverse dynamics of `arm` are its feed-forward, for previews of N+1 samples, `dt` [s] apart.

    Its muscles pull `min_force` [N] at least. Raises `InvalidInput` for muscles that are not affine in the pressure.
    """

    def __init__(self, arm: Arm, dt: float, N: int, min_force: float = 0.0) -> None:
        from scipy.interpolate import CubicSpline

        arm.mechanism.check_affine("the feed-forward of an arm")
        self.arm, self.min_force = arm, min_force
        # the derivatives of a spline are linear in its samples: matrices (N+1, N+1), made once
        spline = CubicSpline(dt * np.arange(N + 1), np.eye(N + 1))
        self.slopes = spline(spline.x, 1), spline(spline.x, 2)
        self.alpha = np.exp(-dt / arm.lags)  # (m,)

    def __deepcopy__(self, memo: dict[int, Any]) -> "ArmInverseDynamics":
        """Return itself: nothing in it changes."""
        return self

    def ready(self) -> "ArmInverseDynamics":
        """Return itself, with everything compiled that else would be in the first control step."""
        warm_up()
        return self

    def __call__(self, q: Array, K: Array, d: Array) -> FeedForward:
        """Return the feed-forward for previews `q` (N+1, n) [rad], `K` (N+1, n, n), and torques `d` (N+1, n) [N·m]."""
        arm, asked = self.arm, q
        q = np.clip(asked, *arm.angle_limits)
        omega, alpha = (D @ q for D in self.slopes)
        T = arm.bodies.torque_for(q, omega, alpha) - d
        held = allocate(
            q,
            K,
            T,
            joint=arm.mechanism,
            limits=Limits(min_force=self.min_force),
            along=0,
            stiffness=Stiffness(endpoint=arm.endpoint),
        )
        u = (held.P[1:] - self.alpha * held.P[:-1]) / (1 - self.alpha)
        if arm.gas is not None:  # the regulators work against what the motion does to the pressures
            squeezed = arm.squeezed(q, omega, held.P)
            u -= arm.lags * (squeezed[1:] + squeezed[:-1]) / 2
        given, missed = (held.K, held.K_error) if arm.endpoint is None else (held.K_x, held.K_x_error)
        y = np.hstack([arm.svec(given), np.zeros_like(held.P)])
        moved = Moved(*(float(np.abs(gap).max()) for gap in (asked - q, missed, held.T_error)))
        return FeedForward(np.hstack([q, omega, held.P]), y, u, moved)
