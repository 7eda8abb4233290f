"""Muscles and valves of a machine: forces and pressures from lengths and commands, for any mechanics of the links.

    F_j = g_j max(F(P_j, ε_j), 0),     ε_j = (L_j - l_j)/L_j
    P_j' = (u_j - P_j)/τ_j - κ (P_j + p_a) V_j'/V_j^eff,     V_j' = -F_P l_j'                                    (G3)

The second term applies only with `gas` and to cables under tension: a slack one moves no muscle.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array, Mask, Value
from allocator.errors import InvalidInput
from allocator.joint.gas import AIR, Gas
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism.routes.base import per_muscle, rest_lengths
from allocator.muscles import Muscle
from mpc.model.pressures import fall, gas_of


@dataclass(frozen=True)
class Pneumatics:
    """Muscles (m of them) with regulators; immutable. SI units.

    Every argument but `muscles` is a number for all muscles or a row (m,); `muscles` is one for all or m of them.
    """

    muscles: tuple[Muscle, ...]
    rest_length: Value  # L [m]
    lag: Value = 0.1  # τ of the regulators [s]
    gas: Gas | bool | None = None  # True: air; None: regulators hold the pressures against every motion
    force_gains: Value = 1.0  # g [-]: factors on the forces of the muscle models

    def __post_init__(self) -> None:
        """Check the parts and convert them to rows."""
        m = len(self.muscles)
        object.__setattr__(self, "muscles", tuple(self.muscles))
        if not m or not all(isinstance(muscle, Muscle) for muscle in self.muscles):
            raise InvalidInput(f"muscles = {checks.brief(self.muscles)} have to be one or more muscles")
        object.__setattr__(self, "rest_length", np.array(rest_lengths("muscles", self.rest_length, m)))
        for name, unit, least in (("lag", "s", 1e-6), ("force_gains", "-", 0.0)):
            row = per_muscle(name, getattr(self, name), m, unit)
            if (wrong := row < least).any():
                raise InvalidInput(f"{name}{checks.at(row, wrong)} {unit} has to be {least:g} or more")
            object.__setattr__(self, name, row)
        if (wrong := self.lag > _SLOWEST).any():
            raise InvalidInput(f"lag{checks.at(self.lag, wrong)} s is no regulator's; if milliseconds, divide by 1000")
        gas = gas_of("gas", self.gas, AIR)
        object.__setattr__(self, "gas", gas)
        if gas is not None:
            self.volumes(self.rest_length, np.zeros(m))  # raises if they are unknown

    @property
    def m(self) -> int:
        """Number of muscles."""
        return len(self.muscles)

    @cached_property
    def _kinds(self) -> tuple[tuple[Muscle, Sequence[int] | NDArray[np.intp]], ...]:
        """Distinct muscles and their places, for one call of each model."""
        kinds = list(dict.fromkeys(self.muscles))
        places = [np.array([j for j, muscle in enumerate(self.muscles) if muscle == kind]) for kind in kinds]
        return tuple(zip(kinds, places, strict=True))

    def contraction(self, length: Array) -> Array:
        """Return ε (…, m) [-] of muscles that are `length` (…, m) [m] long."""
        return np.asarray(1 - length / self.rest_length)

    def laws(self, length: Array, P: Array) -> Array:
        """Return the forces (…, m) [N] of the muscle models; negative if a cable is slack."""
        eps = self.contraction(length)
        if len(self._kinds) == 1:
            return np.asarray(self.force_gains * self.muscles[0].law(P, eps))
        said = np.empty(np.broadcast_shapes(P.shape, eps.shape))
        for muscle, at in self._kinds:
            said[..., at] = self.force_gains[at] * muscle.law(P[..., at], eps[..., at])
        return said

    def forces(self, length: Array, P: Array) -> Array:
        """Return the forces F ≥ 0 (…, m) [N] at `length` (…, m) [m] and `P` (…, m) [Pa]; of a slack cable 0."""
        return np.maximum(self.laws(length, P), 0.0)

    def force_slopes(self, length: Array, P: Array) -> Array:
        """Return ∂F/∂P (…, m) [N/Pa] of the muscle models at `length` (…, m) [m] and `P` (…, m) [Pa]."""
        eps, gains = self.contraction(length), np.empty(P.shape)
        for muscle, at in self._kinds:
            gains[..., at] = self.force_gains[at] * muscle.gain(P[..., at], eps[..., at])
        return gains

    def own_stiffness(self, length: Array, P: Array) -> Array:
        """Return the muscles' own stiffness k = ∂F/∂l (m,) [N/m] at constant pressures `P` (m,)."""
        eps, k = self.contraction(length), np.empty(self.m)
        for muscle, at in self._kinds:
            k[at] = -self.force_gains[at] / self.rest_length[at] * muscle.slope(P[at], eps[at])
        return k

    def volumes(self, length: Array, P: Array) -> Array:
        """Return the volumes of the gas (…, m) [m³]. Raises `InvalidInput` if a muscle has no radius."""
        eps = self.contraction(length)
        V = np.empty(np.broadcast_shapes(P.shape, length.shape))
        for muscle, at in self._kinds:
            V[..., at] = muscle.volume(P[..., at], eps[..., at], self.rest_length[at])
        return V

    def rate(self, P: Array, u: Array, length: Array, speed: Array, forces: Array, shut: Mask | bool = False) -> Array:
        """Return P' (m,) [Pa/s] for the commands `u` (m,), of muscles whose lengths change by `speed` (m,) [m/s].

        Regulators do not act on muscles with `shut` valves, all or (m,).
        """
        held = np.where(shut, 0.0, (u - P) / self.lag)
        if self.gas is not None:
            held += (forces > 0) * self.squeezed(P, length, speed)  # a slack cable moves no muscle
        return np.asarray(held)

    def squeezed(self, P: Array, length: Array, speed: Array) -> Array:
        """Return the rise of the pressures (…, m) [Pa/s] as the muscles lengthen by `speed` (…, m) [m/s]   (G3)"""
        eps = self.contraction(length)
        rise = np.empty(np.broadcast_shapes(P.shape, eps.shape))
        for muscle, at in self._kinds:
            side = OneMuscle(muscle, "muscle", self.rest_length[at], eps[..., at], 1.0, 0.0, 1.0, self._filled)
            rise[..., at] = fall(side, P[..., at], self.force_gains[at]) * speed[..., at]
        return rise

    @property
    def _filled(self) -> Gas:
        assert isinstance(self.gas, Gas)  # callers check this
        return self.gas


def beyond(e: Array, rest: float) -> Array:
    """Return the errors `e` minus a dead band of ±`rest`."""
    return np.asarray(e - np.clip(e, -rest, rest))


_SLOWEST = 100.0  # [s]
