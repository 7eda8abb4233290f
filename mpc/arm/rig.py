"""Parts of a simulated machine's rig that MuJoCo lacks: the path of the commands, and friction.

Sensors and faults are those of any simulated machine (`mpc.model.faults.Sensors`). Commands reach the regulators
through supply, slew and dead time. The friction models are those of one joint
(`mpc.model.friction.contact.Hysteresis`). They act along the coordinates s = (q, l): the angles of the joints, and the
lengths of the muscles. With J = ∂s/∂q the torques at the joints are

    τ = -Jᵀ f,    f_i = T_f,i of the path of s_i

The loads of a muscle are its force, twice its pressure and its own stiffness; its friction is in N, its lengths in m.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.joint.limits import checked_supply
from mpc.model.friction.contact import CROSSES, Hysteresis, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import friction_of


class Readings(NamedTuple):
    """Sensor readings of a machine; velocities are not measured."""

    q: Array  # encoders (n,) [rad, or m of slides]
    P: Array  # pressure sensors (m,) [Pa]


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


class Supply:
    """Delayed commands to regulators within `limits` [Pa] and `slew` [Pa/s], after a `dead_time` [s]."""

    def __init__(self, limits: tuple[float, float], slew: float, dead_time: float) -> None:
        """Check the numbers. Raises `InvalidInput`."""
        self.limits = checked_supply(limits)
        self.slew = inf if slew == inf else checks.number("slew", slew, "Pa/s")
        if self.slew <= checks.LOOKS_LIKE_BAR[1]:
            raise InvalidInput(f"slew = {self.slew:g} Pa/s is next to nothing; if bar/s was meant, multiply by 1e5")
        self.dead_time = checks.delay("dead_time", dead_time, "regulator")

    def begin(self, P: Array) -> None:
        """Begin with regulators that follow the pressures `P` (m,) [Pa]."""
        self.command = P.copy()
        self.waiting: list[tuple[float, Array]] = []  # delayed commands with their times of arrival

    def pieces(self, now: float, asked: Array, dt: float) -> Iterator[float]:
        """Yield the pieces [s] of a sample of `dt` [s] from `now` [s] on; `command` is the regulators' input in each.

        The commands `asked` (m,) [Pa] are given now.
        """
        asked, reach = np.clip(asked, *self.limits), self.slew * dt
        last = self.waiting[-1][1] if self.waiting else self.command
        end = now + dt
        self.waiting.append((now + self.dead_time, np.clip(asked, last - reach, last + reach)))
        arriving = [max(t, now) for t, _ in self.waiting if t < end - 1e-9 * dt]
        for begin, until in zip([now, *arriving], [*arriving, end], strict=True):
            if until - begin > 1e-9 * dt:
                yield until - begin
            if until in arriving:
                self.command = self.waiting.pop(0)[1]


Given = Hysteresis | Sequence[Hysteresis] | None  # one for all, one each, or none


class Rubbing:
    """Friction of n joints and m muscles, and its memory."""

    def __init__(self, joints: Given, muscles: Given, n: int, m: int) -> None:
        """Check the models. Raises `InvalidInput` for a number of models other than n or m."""
        self._models = *_each("friction", joints, n), *_each("muscle_friction", muscles, m)
        self._places = [i for i, model in enumerate(self._models) if not model.absent]
        self.absent = not self._places
        self.begin(np.zeros(n + m))

    def begin(self, s: Array) -> None:
        """Forget the past: nothing has moved from `s` (n + m,) [rad, m]."""
        self._from = s.copy()
        self._memories = [model.begun(at) for model, at in zip(self._models, s.tolist(), strict=True)]

    def forces(self, s: Array, loads: Array) -> Array:
        """Return f (n + m,) [N·m, N] at `s` (n + m,), on the path from the `s` of the last `go_on`.

        `loads` (n + m, 3) are those of `mpc.model.friction.contact.Loads`.
        """
        f = np.zeros(s.size)
        for i, memory, own in self._moved(s, loads):
            f[i] = self._models[i].torque(memory, own)
        return f

    def go_on(self, s: Array, loads: Array) -> None:
        """Update the memory by a motion to `s` (n + m,) in one direction."""
        for i, memory, _ in self._moved(s, loads):
            self._memories[i] = memory
        self._from = s.copy()

    @property
    def kept(self) -> tuple[Array, list[Any]]:
        """Memory, for `restore`."""
        return self._from, list(self._memories)

    def restore(self, kept: tuple[Array, list[Any]]) -> None:
        """Restore the memory `kept`."""
        self._from, self._memories = kept[0], list(kept[1])

    def _moved(self, s: Array, loads: Array) -> list[tuple[int, Any, Loads]]:
        """Return index, memory and loads of every friction that is not absent, at `s` (n + m,)."""
        motion, given = (s - self._from).tolist(), loads.tolist()
        found = []
        for i in self._places:
            own = Loads(*given[i])
            found.append((i, self._models[i].moved(self._memories[i], motion[i], own), own))
        return found


def loads(arms: Array, k: Array, forces: Array, P: Array) -> Array:
    """Return the loads (n + m, 3) at joints and muscles, in the order of `Loads`.

    Muscles with the `arms` (m, n) [m] and own stiffness `k` (m,) [N/m] pull with `forces` (m,) [N] at the pressures
    `P` (m,) [Pa]. The curvature of the tendon routes is neglected in the joint stiffness.
    """
    r = np.abs(arms)
    crossing = r > CROSSES
    filled = 2 * (P @ crossing) / np.maximum(crossing.sum(axis=0), 1)
    joints = np.stack([forces @ r, filled, k @ r**2], axis=1)
    return np.vstack([joints, np.stack([forces, 2 * P, k], axis=1)])


def _each(name: str, given: Given, count: int) -> tuple[Hysteresis, ...]:
    if given is None or not isinstance(given, Sequence):
        return (Friction() if given is None else friction_of(given),) * count
    if len(given) != count:
        raise InvalidInput(f"{name}: {len(given)} models given for {count}; give one for all, or one each")
    return tuple(map(friction_of, given))
