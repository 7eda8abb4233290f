"""The closed loop of an arm is a controller and a plant on MuJoCo against each other, sample by sample.

The plant begins in the reference's first state of motion, or at rest at its first posture. Between sensors and
controller stands an observer, or nothing: then the controller is told the true state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from allocator.allocation import allocate
from allocator.calculus import Array
from allocator.joint.gas import Stiffness
from mpc.arm.model import Arm
from mpc.arm.mujoco_plant import MujocoPlant
from mpc.arm.tracking.observer import ArmObserver
from mpc.arm.trials.reference import ArmReference
from mpc.tracking.plan import Plan

_DIFFERENCE = 1e-3  # [s] over which a reference's first velocity and acceleration are taken


class ArmController(Protocol):
    """A controller has what `simulate_arm` asks of it."""

    dt: float

    @property
    def ahead(self) -> int:
        """Return the samples of preview that it wants after the present one."""

    def reset(self) -> None:
        """Forget the past."""

    def step(self, x: Any, q_ref: Any, K_ref: Any, d: Any = 0.0) -> Plan:
        """Return the plan from the state (2n + m,) for previews (ahead + 1, …) under torques `d` (n,) [N·m]."""


@dataclass(frozen=True, eq=False)
class ArmRun:
    """An `ArmRun` is what happened in M steps; time runs along the first axis."""

    arm: Arm  # the model that the controller has
    dt: float  # [s]
    t: Array  # (M+1,) [s]
    x: Array  # (M+1, 2n + m) true states
    u: Array  # (M, m) commands, u[k] sent at t[k] [Pa]
    q_ref: Array  # (M+1, n) [rad]
    K_ref: Array  # (M+1, k, k)
    K: Array  # (M+1, k, k) as it is tracked: the joints' [N·m/rad], or the endpoint's [N/m]
    forces: Array  # (M+1, m) [N]
    d: Array  # (M, n) torques that the controller was told [N·m]
    step_time: Array  # (M,) [s]
    status: NDArray[np.int64]  # (M,) PlanStatus
    rung: NDArray[np.int64]  # (M,) Rung
    slack: Array  # (M,) [rad]
    K_joints: Any = None  # (M+1, n, n) stiffness (M2) of the plant's muscles [N·m/rad]; None: K is that

    @property
    def q(self) -> Array:
        """Return the angles (M+1, n) [rad]."""
        return self.x[:, : self.arm.n]

    @property
    def P(self) -> Array:
        """Return the pressures (M+1, m) [Pa]."""
        return self.x[:, 2 * self.arm.n :]


def simulate_arm(
    plant: MujocoPlant,
    arm: Arm,
    controller: ArmController,
    reference: ArmReference,
    *,
    observer: ArmObserver | None = None,
    load: Callable[[float], Any] | None = None,
    seed: int = 0,
    caught: bool = True,
    watch: Callable[[], None] | None = None,
) -> ArmRun:
    """Run `controller`, whose model is `arm`, on `plant` along `reference`.

    `load(t)` are torques (n,) [N·m] from outside of which nobody tells. `caught`: the plant begins in the
    motion of the reference, else at rest. `watch` is called after every sample, for a camera.
    """
    dt, n = controller.dt, arm.n
    steps = round(reference.duration / dt)
    begin(plant, arm, reference, seed, caught)
    controller.reset()
    if observer is not None:
        observer.reset()
    u, read = plant.P, plant.measure()
    x, forces, rows = [_state(plant)], [plant.forces], []
    offsets = np.linspace(0.0, dt * controller.ahead, controller.ahead + 1)
    for k in range(steps):
        if observer is None:
            seen, d = x[-1], np.zeros(n)
        else:
            seen, d = observer.estimate(read.q, read.P, u)
        previews = reference.sampled(k * dt + offsets)
        began = perf_counter()
        plan = controller.step(seen, *previews, d)
        took = perf_counter() - began
        u = plan.u[0].copy()
        read = plant.step(u, dt, 0.0 if load is None else load(k * dt))
        x.append(_state(plant))
        forces.append(plant.forces)
        rows.append((u, d, took, int(plan.status), int(plan.rung), plan.slack))
        if watch is not None:
            watch()
    t = np.linspace(0.0, dt * steps, steps + 1)
    states, (sent, told, took_all, status, rung, slack) = np.array(x), map(np.array, zip(*rows, strict=True))
    gains = np.asarray(plant.pneumatics.force_gains, float)
    joints = _stiffness(arm, states, gains)
    K = arm.seen(states[:, :n], joints)
    return ArmRun(
        arm,
        dt,
        t,
        states,
        sent,
        *reference.sampled(t),
        K,
        np.array(forces),
        told,
        took_all,
        status,
        rung,
        slack,
        joints,
    )


def begin(plant: MujocoPlant, arm: Arm, reference: ArmReference, seed: int = 0, caught: bool = True) -> None:
    """Put `plant` where `reference` begins."""
    q, K = reference.sampled(np.linspace(0.0, 2 * _DIFFERENCE, 3))
    omega = (-1.5 * q[0] + 2 * q[1] - 0.5 * q[2]) / _DIFFERENCE if caught else np.zeros(arm.n)
    alpha = (q[0] - 2 * q[1] + q[2]) / _DIFFERENCE**2 if caught else np.zeros(arm.n)
    torque = arm.bodies.torque_for(q[0], omega, alpha)
    held = allocate(q[0], K[0], torque, joint=arm.mechanism, stiffness=Stiffness(endpoint=arm.endpoint))
    plant.reset(q[0], held.P, omega=omega, seed=seed)


def _state(plant: MujocoPlant) -> Array:
    return np.concatenate([plant.q, plant.omega, plant.P])


def _stiffness(arm: Arm, x: Array, gains: Array) -> Array:
    """Return the stiffness of muscles that pull `gains` (m,) times as hard as their laws say   (M2)"""
    q, P = x[:, : arm.n], x[:, 2 * arm.n :]
    gains = np.broadcast_to(gains, (arm.m,))
    muscles = zip(arm.mechanism.at(q), P.T, gains.tolist(), strict=True)
    return np.asarray(sum(gain * muscle.stiffness(pressure) for muscle, pressure, gain in muscles))
