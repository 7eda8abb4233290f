"""The closed loop: controller and plant against each other, sample by sample.

The plant starts at rest, in equilibrium at the reference's first point with the stiffness asked there, unless another
state is given: a reference that starts in motion has to be caught up with, and the errors of that count. Commands are
held over each sample (zero-order hold) while the plant is integrated in fine steps.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.buffered import Buffered
from mpc.plan import Plan
from mpc.plant import NU, NX, Plant
from mpc.reference import Reference


class Controller(Protocol):
    """What `simulate` asks of a controller."""

    dt: float
    N: int

    def reset(self) -> None:
        """Forget the past."""

    def step(self, x: Any, theta_ref: Any, K_ref: Any) -> Plan:
        """The plan from the state `x` for the previews (N+1,)."""


@dataclass(frozen=True, eq=False)
class Run:
    """What happened in M steps; time runs along the first axis."""

    plant: Plant
    dt: float  # [s]
    t: Array  # (M+1,) [s]
    x: Array  # (M+1, 4) states
    u: Array  # (M, 2) commands, u[k] from t[k] to t[k+1] [Pa]
    theta_ref: Array  # (M+1,) [rad]
    K_ref: Array  # (M+1,) [N·m/rad]
    K: Array  # (M+1,) isobaric stiffness of the plant [N·m/rad]
    forces: Array  # (M+1, 2) muscle forces [N]; negative: slack
    step_time: Array  # (M,) time that the controller took [s]
    rung: NDArray[np.int64]  # (M,) Rung
    status: NDArray[np.int64]  # (M,) PlanStatus
    slack: Array  # (M,) predicted excursion from the joint range [rad]

    @property
    def theta(self) -> Array:
        """Joint angle (M+1,) [rad]."""
        return self.x[:, 0]

    @property
    def P(self) -> Array:
        """Pressures (M+1, 2) [Pa]."""
        return self.x[:, 2:]


def simulate(
    plant: Plant, controller: Controller, reference: Reference, *, x0: Any = None, progress: bool = False
) -> Run:
    """Let `controller` drive `plant` along `reference` from its first sample to its last; see the module's text."""
    dt, N = controller.dt, controller.N
    wanted = reference.resampled(dt)
    steps = wanted.t.size - 1
    integrate = Buffered(plant.discrete(dt, resolution=0.02))
    x = np.empty((steps + 1, NX))
    x[0] = plant.at_rest(float(wanted.theta[0]), float(wanted.K[0])) if x0 is None else _state(x0)
    u, took, slack = np.empty((steps, NU)), np.empty(steps), np.empty(steps)
    rung, status = np.empty(steps, int), np.empty(steps, int)

    controller.reset()
    for k in _counted(steps, progress):
        began = perf_counter()
        plan = controller.step(x[k], *wanted.preview(k, N))
        took[k] = perf_counter() - began
        u[k], rung[k], status[k], slack[k] = plan.u[0], plan.rung, plan.status, plan.slack
        x[k + 1] = integrate(x[k], u[k], 0.0)[0][0]

    K, forces = plant.stiffness(x.T), np.stack(plant.forces(x.T), axis=1)
    return Run(plant, dt, wanted.t, x, u, wanted.theta, wanted.K, K, forces, took, rung, status, slack)


def _state(x0: Any) -> Array:
    x = np.asarray(x0, float)
    if x.shape != (NX,) or not np.isfinite(x).all():
        raise InvalidInput(f"x0 = {x0!r} has to be 4 finite numbers (theta [rad], omega [rad/s], P1 [Pa], P2 [Pa])")
    return x


def _counted(steps: int, progress: bool) -> Iterable[int]:
    if not progress:
        return range(steps)
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    hidden = not console.is_terminal
    return track(range(steps), description="simulating", console=console, transient=True, disable=hidden)


__all__ = ["Controller", "Run", "simulate"]
