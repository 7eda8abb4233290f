"""Encoders and pressure sensors of a machine: steps, noise, offsets and faults."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism.routes.base import per_muscle
from mpc.model.faults import Fault


class Readings(NamedTuple):
    """Sensor readings of a machine; velocities are not measured."""

    q: Array  # encoders (n,) [rad, or m of slides]
    P: Array  # pressure sensors (m,) [Pa]


class Sensors:
    """Sensors of n joints and m muscles.

    Encoders have steps of `encoder` [rad or m]. Pressure sensors have the offset `pressure_offset` [Pa], a number or a
    row (m,), and noise of the standard deviation `pressure_noise` [Pa]. `faults` are made with `joints=n, muscles=m`.
    """

    def __init__(
        self, n: int, m: int, encoder: float, pressure_noise: float, pressure_offset: ArrayLike, faults: Sequence[Fault]
    ) -> None:
        """Check the numbers. Raises `InvalidInput`."""
        self.n, self.m = n, m
        self.encoder = checks.not_negative("encoder", encoder, "rad")
        self.pressure_noise = checks.not_negative("pressure_noise", pressure_noise, "Pa")
        self.pressure_offset = per_muscle("pressure_offset", pressure_offset, m, "Pa")
        self.faults = tuple(faults)
        for fault in self.faults:
            if not isinstance(fault, Fault) or (fault.joints, fault.muscles) != (n, m):
                raise InvalidInput(f"faults: {fault!r} is not one of joints={n}, muscles={m}; give it these numbers")
        self.begin(0)

    @property
    def exact(self) -> bool:
        """Whether the readings are exact."""
        return not (self.encoder or self.pressure_noise or self.pressure_offset.any() or self.faults)

    def begin(self, seed: int) -> None:
        """Restart with the noise of the `seed`."""
        self._noise = np.random.default_rng(seed)
        self._said = np.full(2 * self.n + self.m, np.nan)

    def active(self, t: float) -> list[Fault]:
        """Return the faults that are active at the time `t` [s]."""
        return [fault for fault in self.faults if fault.active(t)]

    def broken(self, t: float) -> tuple[Array, Mask]:
        """Return the remaining shares (m,) of the muscles' forces at the time `t` [s], and the valves (m,) shut by
        faults.
        """
        pulling, shut = np.ones(self.m), np.zeros(self.m, bool)
        for fault in self.active(t):
            pulling, shut = pulling * np.array(fault.pulling), shut | np.array(fault.shut)
        return pulling, shut

    def effective(self, command: Array, P: Array, t: float) -> Array:
        """Return the regulators' inputs (m,) [Pa] instead of a `command` at the pressures `P` and the time `t`."""
        for fault in self.active(t):
            command = fault.effective(command, P)
        return command

    def read(self, q: Array, P: Array, t: float) -> Readings:
        """Return the readings of the angles `q` (n,) and pressures `P` (m,) at the time `t` [s]."""
        if self.encoder:
            q = self.encoder * np.round(q / self.encoder)
        P = P + self.pressure_offset + self.pressure_noise * self._noise.standard_normal(self.m)
        y = np.concatenate([q, np.full(self.n, np.nan), P])
        for fault in self.active(t):
            y = fault.read(y + fault.offset(t), self._said)
        self._said = y
        return Readings(y[: self.n], y[2 * self.n :])


def encoders_of(model: Any, source: str) -> NDArray[np.intp]:
    """Return the joints of a MuJoCo `model` that have encoders: hinges and slides. Raises `InvalidFile`."""
    import mujoco

    if model.na and not model.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_ACTUATION):
        raise InvalidFile(source, "has actuators with states, which are not integrated; switch actuation off")
    if not model.ntendon:
        raise InvalidFile(source, "has no tendons; the tendons of the model are the muscles")
    kinds = [int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE)]
    turning = np.flatnonzero(np.isin(model.jnt_type, kinds))
    if not turning.size:
        raise InvalidFile(source, "has neither hinges nor slides, which is where encoders are")
    return turning
