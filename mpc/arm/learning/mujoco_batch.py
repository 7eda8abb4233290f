"""Batch of arms on MuJoCo's bodies: slower than `ArmBatch`, but an independent implementation."""

from collections.abc import Callable
from dataclasses import replace
from math import atan2

import numpy as np

from allocator.calculus import Array, Mask
from mpc.arm.learning.plant import RESOLUTION, Touch, VariedArm, Wall, views
from mpc.arm.mjcf import DRAWN, model_of, row
from mpc.arm.mujoco_plant import MujocoPlant

_SIZE, _SEEN_THROUGH = (0.01, 0.25, 0.04), "0.35 0.5 0.65 0.6"  # [m] halves of a drawn wall, and its colour


class MujocoBatch:
    """N simulated arms on MuJoCo, with the interface of `ArmBatch`."""

    def __init__(self, varied: VariedArm, size: int, dt: float) -> None:
        """Prepare `size` nominal arms. Raises `MissingBackend` without MuJoCo."""
        arm = varied.arm
        self.varied, self.dt = varied, float(dt)
        self.x, self.v = np.zeros((size, arm.size)), np.tile(varied.nominal, (size, 1))
        self.q, self.omega, self.P = views(self.x, arm.n)
        self.plants = [plant_of(varied) for _ in range(size)]
        if varied.wall is not None:
            touch = Touch(varied, 1)
            for plant, v in zip(self.plants, self.v, strict=True):
                plant.touch = lambda q, omega, v=v: touch(q, omega, v).torque[0]
        model = self.plants[0].model
        self._nominal = model.body_mass.copy(), model.body_inertia.copy(), model.dof_damping.copy()

    def renew(self, which: Mask) -> None:
        """Apply changed states and values of the arms `which` (N,)."""
        import mujoco

        n, at, kinds = self.varied.arm.n, self.varied.places, self.varied.kinds
        mass, inertia, damping = self._nominal
        for i in np.flatnonzero(which):
            plant, v = self.plants[i], self.v[i]
            own = {kind: kind.unchecked(v[at[f"kind {k}"]].tolist()) for k, kind in enumerate(kinds)}
            muscles = tuple(own.get(muscle, muscle) for muscle in self.varied.arm.mechanism.muscles)
            plant.pneumatics = replace(plant.pneumatics, muscles=muscles, lag=v[at["lags"]], force_gains=v[at["gains"]])
            plant.model.body_mass[:], plant.model.body_inertia[:] = v[at["mass"]] * mass, v[at["mass"]] * inertia
            plant.model.dof_damping[:] = v[at["damping"]] * damping
            mujoco.mj_setConst(plant.model, plant.data)
            plant.reset(self.x[i, :n], self.x[i, 2 * n :], omega=self.x[i, n : 2 * n])

    def advance(self, u: Array, d: Array) -> None:
        """Advance all arms by a sample under the commands `u` (N, m) [Pa] and the torques `d` (N, n) [N·m]."""
        for plant, x, command, load in zip(self.plants, self.x, u, d, strict=True):
            plant.step(command, self.dt, load)
            x[:] = np.concatenate([plant.q, plant.omega, plant.P])


class WalledPlant(MujocoPlant):
    """Plant with a load that depends on the motion, such as the torques of a wall."""

    touch: Callable[[Array, Array], Array] | None = None  # (q, omega) (n,) ↦ torques (n,) [N·m]

    def _rates(self, P: Array, brake: Array | None = None, shut: bool = False) -> tuple[Array, Array]:
        """Return q'' (nv,) and P' (m,) in the state of `data`."""
        if self.touch is None:
            return super()._rates(P, brake, shut)
        constant, self._load = self._load, self._load.copy()
        self._load[self._speeds] += self.touch(self.q, self.omega)
        rates = super()._rates(P, brake, shut)
        self._load = constant
        return rates


def plant_of(varied: VariedArm) -> WalledPlant:
    """Return the nominal arm on MuJoCo; a wall is drawn and touches nothing."""
    arm, limits = varied.arm, varied.arm.mechanism.pressure_limits
    model, lengths = model_of(arm)
    if varied.wall is not None and varied.hand.dim == 2 and isinstance(model, str):
        model = model.replace("</worldbody>", f"{_drawn(varied.wall)}</worldbody>")
    plant = WalledPlant(model, arm.mechanism.muscles, **lengths, pressure_limits=limits, lag=arm.lags, gas=varied.gas)
    plant.model.opt.timestep = min(plant.model.opt.timestep, RESOLUTION / varied.fastest_rate)
    return plant


def _drawn(wall: Wall) -> str:
    """Return the geom of a wall in the plane."""
    (x, y), behind = wall.normal, wall.offset + _SIZE[0]
    place = f'pos="{row(behind * x, behind * y, 0.0)}" euler="{row(0.0, 0.0, atan2(y, x))}" size="{row(*_SIZE)}"'
    return f'<geom class="{DRAWN}" type="box" {place} rgba="{_SEEN_THROUGH}"/>'
