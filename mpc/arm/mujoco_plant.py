"""Plant with MuJoCo's bodies: muscles pull along the tendons of a model, and their pressures are states.

With the tendons' lengths l(q) and their slopes, MuJoCo's `ten_J`, muscle j pulls with F_j along its tendon:

    M(q) q'' = -(∂l/∂q)ᵀ F + friction + load + the model's other torques (gravity, damping, limits, contacts, …)    (M1)

The state (q, q', P) is integrated by the classical Runge–Kutta method in steps of at most the model's `timestep`.
"""

from collections.abc import Sequence
from copy import copy
from math import ceil, inf
from typing import Any, Self, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.assumption import filled
from allocator.joint.gas import Gas
from allocator.mechanism.routes.base import per_muscle, rest_lengths
from allocator.mechanism.routes.mjcf import Source, load, said, tendon_lengths
from allocator.muscles import Muscle
from allocator.units import BAR
from mpc.arm.experiments import MujocoExperiment, pushed_stiffness, settle
from mpc.arm.mjcf import model_of
from mpc.arm.rig import Given, Readings, Rubbing, Supply, encoders_of, loads
from mpc.model.arm.model import Arm
from mpc.model.arm.mujoco_mechanics import TendonJacobian
from mpc.model.arm.pneumatics import Pneumatics, beyond
from mpc.model.experiment import NODES, SHARES
from mpc.model.faults import Fault, Sensors

Kept: TypeAlias = tuple[float, Array, Array, Array, Array, list[tuple[float, Array]], Any]


class MujocoPlant:
    """Simulated machine: a MuJoCo model with pneumatic muscles as tendons.

    Its m muscles are all tendons of the model, its n encoders are on all hinges and slides. Every step changes the
    plant; `copy.deepcopy` makes copies.
    """

    def __init__(
        self,
        model: Source,
        muscles: Muscle | Sequence[Muscle],
        rest_length: ArrayLike | None = None,
        *,
        cable: ArrayLike | None = None,
        pressure_limits: tuple[float, float] = (0.0, 5 * BAR),
        lag: ArrayLike = 0.1,
        slew: float = inf,
        gas: Gas | bool | None = True,
        force_gains: ArrayLike = 1.0,
        dead_time: float = 0.0,
        dead_band: float = 0.0,
        friction: Given = None,
        muscle_friction: Given = None,
        encoder: float = 0.0,
        pressure_noise: float = 0.0,
        pressure_offset: ArrayLike = 0.0,
        faults: Sequence[Fault] = (),
        nominal: Arm | None = None,
    ) -> None:
        """Load and check a model.

        Parameters
        ----------
        model
            A file, MJCF text, or an `mujoco.MjModel`, which is copied. All tendons of MuJoCo are supported:
            through sites, round geoms, over pulleys, or fixed. Their stiffness, damping and limits are kept.
        muscles
            One for all tendons or m of them, in the order of the tendons.
        rest_length, cable
            Rest length, and the length of cable in the tendon [m], numbers or rows (m,); models of `to_mjcf` have both.
        pressure_limits, lag, slew
            Limits of the supply [Pa], to which commands are clipped; time constants of the regulators [s], a number
            or a row (m,), and the greatest rate of their input [Pa/s].
        gas, force_gains
            Whether motions move the pressures (G3), a `Gas` or True for air, see `Arm`; and factors on the forces
            of the muscle models [-], a number or a row (m,).
        dead_time, dead_band
            Of the commands [s], and of the regulators [Pa], in total.
        friction, muscle_friction
            At the joints and in the muscles, see `mpc.arm.rig`: a `Friction` or `MaxwellSlip` for all, or one each.
        encoder, pressure_noise, pressure_offset, faults
            Of the sensors, see `mpc.arm.rig`; faults may also be those of valves and cables.
        nominal
            The arm with these bodies, as the controllers' model; `simulate` needs it.

        Raises
        ------
        InvalidInput
            For invalid numbers, and if no rest length is known.
        InvalidFile
            For a model that MuJoCo cannot read, or without tendons or joints.
        MissingPackage
            Without MuJoCo (`pip install 'antagonist[mujoco]'`).
        """
        import mujoco

        self.model = copy(load(model))
        turning = encoders_of(self.model, said(model))
        self._places, self._speeds = self.model.jnt_qposadr[turning], self.model.jnt_dofadr[turning]
        self.joint_names = tuple(str(self.model.joint(i).name) or str(i + 1) for i in turning)
        m = int(self.model.ntendon)
        self.muscle_names = tuple(str(self.model.tendon(j).name) or str(j + 1) for j in range(m))
        given = (muscles,) * m if isinstance(muscles, Muscle) else tuple(muscles)
        if len(given) != m:
            raise InvalidInput(f"muscles: {len(given)} given for m = {m} tendons of {said(model)}")
        length, cables = tendon_lengths(self.model, model, rest_length, cable)
        self.supply = Supply(pressure_limits, slew, dead_time)
        if gas:
            given, _ = filled(given, rest_lengths("muscles", length, m), self.supply.limits[1])
        self.pneumatics = Pneumatics(given, length, lag, gas, force_gains)
        self._cable = per_muscle("cable", cables, m, "m")
        self.dead_band = checks.not_negative("dead_band", dead_band, "Pa")
        self.rubbing = Rubbing(friction, muscle_friction, self.n, m)
        self.sensors = Sensors(self.n, m, encoder, pressure_noise, pressure_offset, faults)
        self._nominal = nominal
        self.model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)  # needed by older versions
        self.data = mujoco.MjData(self.model)
        self._jacobian = TendonJacobian(self.model, self.data)
        self.reset()

    @classmethod
    def of(cls, arm: Arm, source: Source | None = None, **effects: Any) -> Self:
        """Return bodies, muscles and gas of `arm` on MuJoCo, with unmodelled `effects` by name.

        `source` is the model that it was read from, with the parts that the arm leaves out.
        """
        own, lengths = model_of(arm)
        given = {"pressure_limits": arm.pressure_limits, "lag": arm.lag, "slew": arm.slew, "gas": arm.gas}
        return cls(
            own if source is None else source, arm.mechanism.muscles, **(lengths | given | {"nominal": arm} | effects)
        )

    def __repr__(self) -> str:
        return f"MujocoPlant: {self.n} joints, {self.m} muscles, steps of {1e3 * self.model.opt.timestep:g} ms or less"

    @property
    def n(self) -> int:
        """Number of encoders."""
        return len(self._places)

    @property
    def m(self) -> int:
        """Number of muscles."""
        return self.pneumatics.m

    @property
    def pressure_limits(self) -> tuple[float, float]:
        """Least and greatest pressure of the supply [Pa]."""
        return self.supply.limits

    # --- as a process that `simulate` runs --------------------------------------------------------------------------

    @property
    def nominal(self) -> Arm:
        """Arm as the controllers' model. Raises `InvalidInput` if it was not given."""
        if self._nominal is None:
            raise InvalidInput("MujocoPlant: set nominal=arm, or use MujocoPlant.of(arm)")
        return self._nominal

    def at_rest(self, theta: ArrayLike, K: ArrayLike) -> Array:
        """Return the rest (2n + m,) of the nominal arm."""
        return self.nominal.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> MujocoExperiment:
        """Begin an experiment from the state `x0` (2n + m,) with commands every `dt` [s]."""
        n = self.n
        self.reset(x0[:n], x0[2 * n :], omega=x0[n : 2 * n], seed=seed)
        return MujocoExperiment(self, dt)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the tracked stiffness (M, k, k) and the muscles' true forces (M, m) [N] in the states `x` (M, …)."""
        return self.nominal.along(x, self.pneumatics.force_gains)

    # --- time -------------------------------------------------------------------------------------------------------

    def reset(
        self, q: ArrayLike | None = None, P: ArrayLike | None = None, *, omega: ArrayLike = 0.0, seed: int = 0
    ) -> Readings:
        """Restart at the posture `q` (n,) [rad], by default the model's own, with the pressures `P` (m,) [Pa].

        Without `P` all muscles are at the supply's lower limit. `omega` (n,) [rad/s] are velocities, `seed` is that of
        the sensors' noise. Raises `InvalidInput`.
        """
        import mujoco

        mujoco.mj_resetData(self.model, self.data)
        if q is not None:
            self.data.qpos[self._places] = self._row("q", checks.angle("q", q), self.n, "rad")
        self.data.qvel[self._speeds] = self._row("omega", omega, self.n, "rad/s")
        self._P = self._row("P", self.pressure_limits[0] if P is None else checks.pressure("P", P), self.m, "Pa")
        self.sensors.begin(seed)
        self.supply.begin(self._P)
        self._followed, (self._pulling, self._shut) = self._P, self.sensors.broken(-inf)
        self._load = np.zeros(self.model.nv)
        self._look()
        self.rubbing.begin(self._rubs)
        return self.measure()

    def step(self, commands: ArrayLike, dt: float, load: ArrayLike = 0.0) -> Readings:
        """Advance by `dt` [s] with the `commands` (m,) [Pa] given now, and read the sensors.

        `load` [N·m] are external torques (n,). Raises `InvalidInput`, also if the motion is not finite.
        """
        pressures = self._row("commands", checks.pressure("commands", commands), self.m, "Pa")
        self._load[self._speeds] = self._row("load", load, self.n, "N·m")
        began, end = self.time, self.time + checks.positive("dt", dt, "s")
        self._pulling, self._shut = self.sensors.broken(began)
        for piece in self.supply.pieces(began, pressures, dt):
            self._followed = self.sensors.effective(self.supply.command, self._P, began)
            for _ in range(steps := ceil(piece / self.model.opt.timestep * (1 - 1e-12))):
                self._substep(piece / steps)
        self.data.time = end
        if not all(np.isfinite(state).all() for state in (self.data.qpos, self.data.qvel, self._P)):
            step = f"the model's timestep of {self.model.opt.timestep:g} s"
            raise InvalidInput(f"the motion is not finite at {end:.4g} s: {step} is too long, or it has no damping")
        self._look()
        return self.measure()

    def measure(self) -> Readings:
        """Read the sensors; every call draws new noise."""
        y = self.sensors.read(self.q, self._P, self.time)
        return Readings(y[: self.n], y[2 * self.n :])

    # --- the true state ---------------------------------------------------------------------------------------------

    @property
    def time(self) -> float:
        """Time since the beginning [s]."""
        return float(self.data.time)

    @property
    def q(self) -> Array:
        """True angles (n,) [rad]."""
        return np.array(self.data.qpos[self._places])

    @property
    def omega(self) -> Array:
        """True velocities (n,) [rad/s]."""
        return np.array(self.data.qvel[self._speeds])

    @property
    def P(self) -> Array:
        """True pressures (m,) [Pa]."""
        return self._P.copy()

    @property
    def lengths(self) -> Array:
        """Muscles' lengths l (m,) [m], without cables."""
        return np.asarray(self.data.ten_length - self._cable)

    @property
    def arms(self) -> Array:
        """Arms r = -∂l/∂q (m, n) [m] at the encoders' joints."""
        return -self._jacobian()[:, self._speeds]

    @property
    def tension(self) -> Array:
        """Tensions (m,) [N] of the muscles' cables; 0 for a slack one."""
        return self.pneumatics.forces(self.lengths, self._P)

    @property
    def torque(self) -> Array:
        """Muscles' torques (n,) [N·m]   (M1)"""
        return np.asarray(self.tension @ self.arms)

    @property
    def energy(self) -> tuple[float, float]:
        """Potential energy, of gravity and the model's springs, and the kinetic one [J]."""
        import mujoco

        mujoco.mj_energyPos(self.model, self.data)
        momentum = np.zeros(self.model.nv)
        mujoco.mj_mulM(self.model, self.data, momentum, self.data.qvel)
        return float(self.data.energy[0]), float(momentum @ self.data.qvel / 2)

    # --- pushing ----------------------------------------------------------------------------------------------------

    def settle(self, load: ArrayLike = 0.0, *, shut: bool = False) -> Array:
        """Let the machine come to rest with its pressures frozen, under a `load` (n,) [N·m]; return the angles (n,).

        With `shut` valves the gas is trapped instead, so that pressures follow the motion (needs `gas`). An artificial
        damping removes the energy. Raises `InvalidInput` if there is no rest within a minute.
        """
        return settle(self, self._row("load", load, self.n, "N·m"), shut)

    def pushed_stiffness(self, push: float = 0.05, load: ArrayLike = 0.0, *, shut: bool = False) -> Array:
        """Measure the stiffness (n, n) [N·m/rad] at rest under a `load` (n,) [N·m].

        With the pressures frozen (or the valves `shut`) every joint is pushed by ± `push` [N·m], and the matrix of
        compliances is inverted; the error is of second order in the push. The machine then returns to its former state.
        Raises `InvalidInput` like `settle`.
        """
        return pushed_stiffness(
            self, checks.positive("push", push, "N·m"), self._row("load", load, self.n, "N·m"), shut
        )

    def own_stiffness(self) -> Array:
        """Return the muscles' own share of the present stiffness of all degrees of freedom (nv, nv) [N·m/rad]."""
        J = self._jacobian()
        return np.asarray(J.T @ (self.pneumatics.own_stiffness(self.lengths, self._P)[:, None] * J))

    def held(self, load: Array, steps: int, step: float, brake: Array, shut: bool) -> None:
        """Advance by `steps` of `step` [s] with frozen or `shut` valves, under a `load` (n,) and a `brake` (nv, nv)."""
        self._load[self._speeds] = load
        for _ in range(steps):
            self._substep(step, brake, shut)
        self._look()

    def kept(self) -> Kept:
        """Return the state, for `restore`."""
        d = self.data
        state = float(d.time), d.qpos.copy(), d.qvel.copy(), self._P.copy(), self._load.copy()
        return *state, list(self.supply.waiting), self.rubbing.kept

    def restore(self, kept: Kept) -> None:
        """Restore the state `kept`."""
        d = self.data
        d.time, d.qpos[:], d.qvel[:] = kept[:3]
        self._P, self._load = kept[3].copy(), kept[4].copy()
        self.supply.waiting = list(kept[5])
        self.rubbing.restore(kept[6])
        self._look()

    # --- integration ------------------------------------------------------------------------------------------------

    def _substep(self, h: float, brake: Array | None = None, shut: bool = False) -> None:
        """Take a step of the classical Runge–Kutta method; MuJoCo integrates the angles of balls and free bodies.

        With a `brake` (nv, nv) [N·m·s/rad] no regulator works: pressures are frozen, or those of `shut` gas.
        """
        import mujoco

        d, m, place = self.data, self.model, mujoco.mj_integratePos
        q0, v0, P0 = d.qpos.copy(), d.qvel.copy(), self._P
        v, a, P_rate = np.zeros(m.nv), np.zeros(m.nv), np.zeros(self.m)
        moved, gained, filled = np.zeros(m.nv), np.zeros(m.nv), np.zeros(self.m)
        for node, share in zip(NODES, SHARES, strict=True):
            d.qpos[:] = q0
            place(m, d.qpos, v, node * h)
            d.qvel[:] = v0 + node * h * a
            P = P0 + node * h * P_rate
            v = d.qvel.copy()
            a, P_rate = self._rates(P, brake, shut)
            moved += share * v
            gained += share * a
            filled += share * P_rate
        d.qpos[:] = q0
        place(m, d.qpos, moved, h)
        d.qvel[:] = v0 + h * gained
        self._P = P0 + h * filled
        d.time += h
        if not self.rubbing.absent:
            mujoco.mj_fwdPosition(m, d)
            self.rubbing.go_on(self._rubs, self._loads(self._P, self.tension))

    def _rates(self, P: Array, brake: Array | None = None, shut: bool = False) -> tuple[Array, Array]:
        """Return q'' (nv,) and P' (m,) in the state of `data`."""
        import mujoco

        m, d = self.model, self.data
        mujoco.mj_fwdPosition(m, d)
        mujoco.mj_fwdVelocity(m, d)
        length = self.lengths
        forces = self._pulling * self.pneumatics.forces(length, P)
        d.qfrc_applied[:] = self._load - forces @ self._jacobian()
        if not self.rubbing.absent:
            rubbed = self.rubbing.forces(self._rubs, self._loads(P, forces))
            d.qfrc_applied[self._speeds] -= rubbed[: self.n]
            d.qfrc_applied[:] -= rubbed[self.n :] @ self._jacobian()
        if brake is not None:
            d.qfrc_applied[:] -= brake @ d.qvel
        mujoco.mj_fwdActuation(m, d)
        mujoco.mj_fwdAcceleration(m, d)
        mujoco.mj_fwdConstraint(m, d)
        if brake is not None and not shut:
            return d.qacc.copy(), np.zeros(self.m)
        closed = shut | (self._shut & (self.pneumatics.gas is not None))
        u = P + beyond(self._followed - P, self.dead_band / 2)
        return d.qacc.copy(), self.pneumatics.rate(P, u, length, d.ten_velocity, forces, closed)

    @property
    def _rubs(self) -> Array:
        """Coordinates (n + m,) along which friction acts: angles and lengths."""
        return np.concatenate([self.q, self.lengths])

    def _loads(self, P: Array, forces: Array) -> Array:
        return loads(self.arms, self.pneumatics.own_stiffness(self.lengths, P), forces, P)

    def _look(self) -> None:
        """Let MuJoCo compute all quantities of the state, without a motion."""
        self._rates(self._P)

    def _row(self, name: str, value: ArrayLike, size: int, unit: str) -> Array:
        array = checks.real(name, value, unit)
        if array.shape not in ((), (size,)):
            raise InvalidInput(f"{name} has the shape {array.shape}; expected ({size},) [{unit}]")
        return np.broadcast_to(array, (size,)).astype(float)
