"""Experiments on a `MujocoPlant`: in a closed loop, and pushes at rest, which measure its stiffness."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

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
