"""Point masses that the last body of a `MujocoPlant` carries from the beginning or catches in motion."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from mpc.arm.experiments import mass_matrix
from mpc.arm.mujoco_plant import MujocoPlant


def carry(plant: MujocoPlant, mass: float, at: ArrayLike, velocity: ArrayLike | None = None) -> None:
    """Put a point `mass` [kg] at a place `at` (3,) [m] of the last body, in that body's frame.

    A mass that arrives with a `velocity` (3,) [m/s] in the world is caught without bouncing: its momentum and that of
    the joints give the new velocities. None: it already moves with the body. Raises `InvalidInput` for invalid numbers.
    """
    import mujoco

    mass, place = checks.positive("mass", mass, "kg"), checks.floats("at", at, "m")
    model, data, last = plant.model, plant.data, plant.model.nbody - 1
    if velocity is not None:
        J, M = np.zeros((3, model.nv)), mass_matrix(plant)
        point = data.xpos[last] + data.xmat[last].reshape(3, 3) @ place
        mujoco.mj_jac(model, data, J, None, point, last)
        momentum = M @ data.qvel + mass * J.T @ checks.floats("velocity", velocity, "m/s")
        data.qvel[:] = np.linalg.solve(M + mass * J.T @ J, momentum)
    own, centre = float(model.body_mass[last]), model.body_ipos[last].copy()
    whole = own + mass
    inertia = _inertia(model, last) + own * mass / whole * _about(place - centre)
    model.body_inertia[last], axes = np.linalg.eigh(inertia)
    axes[:, 2] *= np.sign(np.linalg.det(axes))
    mujoco.mju_mat2Quat(model.body_iquat[last], axes.ravel())
    model.body_ipos[last], model.body_mass[last] = (own * centre + mass * place) / whole, whole
    model.body_simple[:] = 0  # frames of bodies and of their inertias may differ now
    model.body_sameframe[last] = 0
    kept = data.qpos.copy(), data.qvel.copy(), data.time
    mujoco.mj_setConst(model, data)
    data.qpos[:], data.qvel[:], data.time = kept


def arriving(
    plant: MujocoPlant, time: float, mass: float, at: ArrayLike, velocity: ArrayLike | None = None
) -> Callable[[], None]:
    """Return a `watch` for `simulate` that lets a mass arrive at a `time` [s]; see `carry`."""
    waiting = [time]

    def watch() -> None:
        if waiting and plant.time >= waiting[0] - 1e-9:
            waiting.clear()
            carry(plant, mass, at, velocity)

    return watch


def _inertia(model: object, body: int) -> Array:
    """Return the inertia (3, 3) [kg·m²] of a body about its centre, in its frame."""
    import mujoco

    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])  # type: ignore[attr-defined]
    R = axes.reshape(3, 3)
    return np.asarray(R @ np.diag(model.body_inertia[body]) @ R.T)  # type: ignore[attr-defined]


def _about(away: Array) -> Array:
    """Return the inertia (3, 3) of a unit mass at the distance `away` (3,) from the centre."""
    return np.asarray(away @ away * np.eye(3) - np.outer(away, away))
