"""Tendons and bodies evaluated by MuJoCo, posture by posture: tendons round geoms, fluids, ….

`MujocoTendons` are the routes and `MujocoBodies` the bodies of an `Arm` without formulas; its controller uses
differences. Contacts, stops, dry friction and actuators of a model are not included.
"""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array
from allocator.mechanism.routes.base import RoutedLengths, Routes, per_muscle, rest_lengths

if TYPE_CHECKING:
    from mujoco import MjData, MjModel

_DIFFERENCE = 1e-5  # [rad] of central differences; their error is of its square


class Mechanics:
    """Copy of a model to evaluate at stacks of postures; two threads must not use it at the same time."""

    def __init__(self, model: "MjModel") -> None:
        """Copy the model without parts that are not smooth functions of the posture."""
        from copy import copy

        import mujoco

        self.model = copy(model)
        self.model.opt.disableflags |= int(
            mujoco.mjtDisableBit.mjDSBL_CONSTRAINT | mujoco.mjtDisableBit.mjDSBL_ACTUATION
        )
        self.data = mujoco.MjData(self.model)
        self._jacobian = TendonJacobian(self.model, self.data)
        self._places, self._speeds = self.model.jnt_qposadr, self.model.jnt_dofadr
        self._units = np.eye(self.model.nv)

    def tendons(self, q: Array) -> tuple[Array, Array]:
        """Return lengths (k, m) [m] and slopes ∂l/∂q (k, m, n) [m/rad] at the postures `q` (k, n)."""
        found = []
        for row in q:
            self._pose(row)
            found.append((self.data.ten_length.copy(), self._jacobian()[:, self._speeds].copy()))
        lengths, slopes = zip(*found, strict=True)
        return np.array(lengths), np.array(slopes)

    def masses(self, q: Array) -> Array:
        """Return M (k, n, n) [kg·m²] at the postures `q` (k, n)."""
        found = []
        for row in q:
            self._pose(row)
            found.append(self._mass())
        return np.array(found)

    def bias(self, q: Array, omega: Array) -> Array:
        """Return the torques (k, n) [N·m] of motions (k, n) without acceleration, springs and damping included."""
        found = []
        for row, speed in zip(q, omega, strict=True):
            self._pose(row)
            found.append(self._rubbing(speed))
        return np.array(found)

    def moving(self, q: Array, omega: Array) -> tuple[Array, Array, Array, Array]:
        """Return `tendons`, `masses` and `bias` at one posture and velocity (n,), without the axis k."""
        self._pose(q)
        slope = self._jacobian()[:, self._speeds].copy()
        return self.data.ten_length.copy(), slope, self._mass(), self._rubbing(omega)

    def _mass(self) -> Array:
        import mujoco

        M = np.zeros((self.model.nv, self.model.nv))
        for unit, line in zip(self._units, M, strict=True):
            mujoco.mj_mulM(self.model, self.data, line, unit)
        return np.asarray(M[self._speeds][:, self._speeds])

    def _rubbing(self, omega: Array) -> Array:
        import mujoco

        self.data.qvel[self._speeds] = omega
        mujoco.mj_fwdVelocity(self.model, self.data)
        return np.asarray((self.data.qfrc_bias - self.data.qfrc_passive)[self._speeds])

    def _pose(self, q: Array) -> None:
        import mujoco

        self.data.qpos[self._places] = q
        mujoco.mj_fwdPosition(self.model, self.data)

    def __deepcopy__(self, memo: dict[int, object]) -> "Mechanics":
        """Return a copy with its own data."""
        return Mechanics(self.model)


@dataclass(frozen=True, eq=False)
class MujocoTendons(Routes):
    """Muscles along any tendons of a model; SI units.

    Lengths and arms are MuJoCo's. Bends are central differences of the arms, also for the infinite slopes of arms where
    a tendon touches or leaves a geom.
    """

    cable: tuple[float, ...]  # (m,) [m]
    mechanics: Mechanics = field(repr=False)

    @classmethod
    def of(cls, mechanics: Mechanics, rest_length: ArrayLike, cable: ArrayLike) -> "MujocoTendons":
        """Return the tendons with these rest lengths and cables [m], numbers or rows (m,). Raises `InvalidInput`."""
        m = int(mechanics.model.ntendon)
        lengths = rest_lengths("MujocoTendons", rest_length, m)
        return cls(lengths, tuple(per_muscle("MujocoTendons: cable", cable, m, "m").tolist()), mechanics)

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.mechanics.model.njnt)

    def ways(self, q: Array) -> tuple[Array, Array]:
        """Return lengths (…, m) [m] and arms (…, m, n) [m] at the postures `q` (…, n)."""
        flat = q.reshape(-1, self.n)
        length, slope = self.mechanics.tendons(flat)
        shape = q.shape[:-1]
        return (length - self.cable).reshape(*shape, self.m), -slope.reshape(*shape, self.m, self.n)

    def at(self, q: Array) -> RoutedLengths:
        """Return lengths, arms and bends of all muscles at the postures `q` (…, n)."""
        h = _DIFFERENCE * np.eye(self.n)
        ahead, behind = (self.ways(q[..., None, :] + step)[1] for step in (h, -h))  # (…, n, m, n)
        bend = np.moveaxis(behind - ahead, -3, -1) / (2 * _DIFFERENCE)
        return RoutedLengths(*self.ways(q), (bend + bend.swapaxes(-1, -2)) / 2)


@dataclass(frozen=True, eq=False)
class MujocoBodies:
    """Bodies of a model with n hinges, evaluated by MuJoCo; for numbers only."""

    mechanics: Mechanics = field(repr=False)

    @property
    def model(self) -> "MjModel":
        """Model that they were read from."""
        return self.mechanics.model

    @property
    def n(self) -> int:
        """Number of joints."""
        return int(self.mechanics.model.njnt)

    @property
    def damping(self) -> Array:
        """Damping of the hinges (n,) [N·m·s/rad]."""
        return np.array(self.mechanics.model.dof_damping[self.mechanics.model.jnt_dofadr])

    @property
    def summary(self) -> str:
        """Short description."""
        return f"{float(np.sum(self.mechanics.model.body_mass)):.3g} kg on {self.n} hinges, as MuJoCo has them"

    def mass_matrix(self, q: Array) -> Array:
        """Return M(q) (…, n, n) [kg·m²] at the postures `q` (…, n)."""
        return self.mechanics.masses(q.reshape(-1, self.n)).reshape(*q.shape, self.n)

    def bias(self, q: Array, omega: Array) -> Array:
        """Return the torques (…, n) [N·m] of a motion without acceleration."""
        q, omega = np.broadcast_arrays(q, omega)
        return self.mechanics.bias(q.reshape(-1, self.n), omega.reshape(-1, self.n)).reshape(q.shape)

    def gravity_torque(self, q: Array) -> Array:
        """Return g(q) (…, n) [N·m], the torques that balance gravity and springs."""
        return self.bias(q, np.zeros_like(q))

    def gravity_stiffness(self, q: Array) -> Array:
        """Return ∂g/∂q (…, n, n) [N·m/rad], by central differences."""
        h = _DIFFERENCE * np.eye(self.n)
        ahead, behind = (self.gravity_torque(q[..., None, :] + step) for step in (h, -h))
        slope = (ahead - behind) / (2 * _DIFFERENCE)
        return np.asarray((slope + slope.swapaxes(-1, -2)) / 2)

    def torque_for(self, q: Array, omega: Array, alpha: Array) -> Array:
        """Return the joints' torques τ (…, n) [N·m] of a motion (inverse dynamics)."""
        return np.asarray((self.mass_matrix(q) @ np.asarray(alpha)[..., None])[..., 0] + self.bias(q, omega))


class TendonJacobian:
    """Jacobian ∂l/∂q (m, nv) [m] of all tendons, which newer versions of MuJoCo store as a sparse matrix."""

    def __init__(self, model: "MjModel", data: "MjData") -> None:
        self._data, self._dense = data, np.zeros((model.ntendon, model.nv))
        self._sparse = np.asarray(data.ten_J).shape != self._dense.shape
        if self._sparse:
            import mujoco

            self._to_dense = mujoco.mju_sparse2dense
            holder = data if hasattr(data, "ten_J_rownnz") else model
            self._layout = [getattr(holder, f"ten_J_{part}").ravel() for part in ("rownnz", "rowadr", "colind")]

    def __call__(self) -> Array:
        """Return the present Jacobian; valid until the next call."""
        if not self._sparse:
            return np.asarray(self._data.ten_J)
        self._to_dense(self._dense, self._data.ten_J.ravel(), *self._layout)
        return self._dense
