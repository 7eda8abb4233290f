"""Experiments on a `MujocoPlant`: closed loops, pushes at rest, which measure its stiffness, and point masses that its
last body carries from the beginning or catches in motion.
"""

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from mpc.arm.mujoco_plant import MujocoPlant

_STILL = 1e-9  # [rad/s] greatest speed of a pushed machine at rest
_LONGEST_REST = 60.0  # [s] longest wait for a rest
_BETWEEN = 10  # steps between checks
_SLOWEST = 1.0  # [1/s] rate that determines the brake of motions without a muscle
_FINE, _COARSE = 0.3, 0.01  # steps while it settles: times the fastest mode, and [s] at most


class MujocoExperiment:
    """Experiment on a `MujocoPlant` in a closed loop.

    Sensors without an encoder's step and without noise measure the whole state, velocities included.
    """

    def __init__(self, plant: "MujocoPlant", dt: float) -> None:
        self._plant, self._dt = plant, dt

    @property
    def x(self) -> Array:
        """True state (2n + m,)."""
        plant = self._plant
        return np.concatenate([plant.q, plant.omega, plant.P])

    def measure(self) -> Array:
        """Read the sensors (2n + m,); NaN for unmeasured velocities."""
        plant = self._plant
        read = plant.measure()
        return np.concatenate([read.q, plant.omega if plant.sensors.exact else np.full(plant.n, np.nan), read.P])

    def advance(self, u: Array, d: ArrayLike = 0.0) -> None:
        """Advance by one sample with the commands `u` (m,) [Pa] and the external torques `d` [N·m]."""
        self._plant.step(u, self._dt, d)


def settle(plant: "MujocoPlant", load: Array, shut: bool) -> Array:
    """Let `plant` come to rest under a `load` (n,) [N·m], see its method `settle`; return the angles (n,)."""
    if shut and plant.pneumatics.gas is None:
        raise InvalidInput("shut valves trap gas, and this plant has none: say gas=True")
    begin, (brake, step) = plant.time, _brake(plant)
    while plant.time - begin < _LONGEST_REST:
        plant.held(load, _BETWEEN, step, brake, shut)
        if np.abs(plant.data.qvel).max() < _STILL:
            return plant.q
    raise InvalidInput(f"the machine does not come to rest within {_LONGEST_REST:g} s: its stiffness holds no posture")


def pushed_stiffness(plant: "MujocoPlant", push: float, load: Array, shut: bool) -> Array:
    """Return the stiffness (n, n) [N·m/rad] from pushes of ± `push` [N·m], see the plant's method."""
    kept = plant.kept()
    settle(plant, load, shut)
    rest, compliance = plant.kept(), np.empty((plant.n, plant.n))
    for i, unit in enumerate(np.eye(plant.n)):
        ends = []
        for sign in (+1.0, -1.0):
            plant.restore(rest)
            ends.append(settle(plant, load + sign * push * unit, shut))
        compliance[:, i] = (ends[0] - ends[1]) / (2 * push)
    plant.restore(kept)
    K = np.linalg.inv(compliance)
    return np.asarray((K + K.T) / 2)


def _brake(plant: "MujocoPlant") -> tuple[Array, float]:
    """Return a damping (nv, nv) [N·m·s/rad] with which no mode swings, and a fine enough step [s] for it."""
    from scipy.linalg import eigh

    M = mass_matrix(plant)
    squares, modes = eigh(plant.own_stiffness(), M)
    rates = np.sqrt(np.maximum(squares, _SLOWEST**2))
    moved = M @ modes
    step = max(min(_FINE / float(rates.max()), _COARSE), float(plant.model.opt.timestep))
    return (2 * rates * moved) @ moved.T, step


def mass_matrix(plant: "MujocoPlant") -> Array:
    """Return M (nv, nv) [kg·m²] of MuJoCo's coordinates at the plant's posture."""
    import mujoco

    M = np.zeros((plant.model.nv, plant.model.nv))
    for row, unit in zip(M, np.eye(plant.model.nv), strict=True):
        mujoco.mj_mulM(plant.model, plant.data, row, unit)
    return M


def carry(plant: "MujocoPlant", mass: float, at: ArrayLike, velocity: ArrayLike | None = None) -> None:
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
    plant: "MujocoPlant", time: float, mass: float, at: ArrayLike, velocity: ArrayLike | None = None
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
