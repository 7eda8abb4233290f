"""Mechanism of n joints moved by m muscles.

At the posture q ∈ Rⁿ muscle j pulls with F_j(P_j, ε_j) along its arm r_j = -∇l_j; its own stiffness is
k_j = -F_ε/L_j and its bend H_j = ∇²l_j. By virtual work

    τ(q, P) = Σ_j r_j F_j                                                               (M1)
    K(q, P) = -∂τ/∂q |P = Σ_j ( k_j r_j r_jᵀ + F_j H_j )      symmetric                 (M2)

and, with y = (τ, the upper triangle of K), y(P) = Σ_j c_j(P_j) is a sum of one curve per muscle   (M3); for muscles
affine in the pressure y = y0(q) + M(q) P.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gas import AIR, Gas, Shares, StiffnessKind, Valves, checked_gas
from allocator.joint.limits import TAUT, Limits, PressureInterval, checked_contraction, checked_supply
from allocator.joint.one_muscle import OneMuscle
from allocator.mechanism.routes import Routes
from allocator.mechanism.routes.pulleys import routes_of
from allocator.muscles import Muscle
from allocator.muscles.cabled import checked_cables
from allocator.units import BAR

Indices = NDArray[np.intp]


class TargetsMap(NamedTuple):
    """y(P) = y0 + M P at postures (…), d = n + n(n+1)/2: τ, then K11, K12, …, K1n, K22, …, Knn."""

    y0: Array  # (…, d) [N·m], [N·m/rad]
    M: Array  # (…, d, m) [N·m/Pa], [N·m/rad/Pa]


@dataclass(frozen=True)
class Mechanism:
    """Routes + m muscles + limits; immutable.

    `muscles` may be a single one for all m. Postures are (…, n), pressures (…, m); leading axes broadcast.
    """

    routes: Routes
    muscles: tuple[Muscle, ...]
    pressure_limits: tuple[float, float] = (0.0, 5 * BAR)  # of the supply [Pa]
    angle_limits: tuple[tuple[float, float], ...] | None = None  # end stops of each joint [rad], within any table
    min_contraction: float = 0.025  # ε_threshold [-], below it no model is valid
    muscle_names: tuple[str, ...] = ()  # (m,), by default "muscle 1", …
    joint_names: tuple[str, ...] = ()  # (n,), by default "joint 1", …
    gas: Gas = AIR  # in the muscles

    def __post_init__(self) -> None:
        """Check the parts against each other."""
        checks.instance("routes", self.routes, Routes, "Routes, such as Pulleys(…)")
        n, m = self.n, self.m
        muscles = (self.muscles,) * m if isinstance(self.muscles, Muscle) else tuple(self.muscles)
        for muscle in muscles:
            checks.instance("muscles: an entry", muscle, Muscle, "a Muscle, such as named_muscle(name)")
        if len(muscles) != m:
            raise InvalidInput(f"muscles: {len(muscles)} given; the routes lead m = {m} muscles over n = {n} joints")
        checked_cables(muscles, self.routes.rest_length)
        object.__setattr__(self, "muscles", muscles)
        object.__setattr__(self, "pressure_limits", checked_supply(self.pressure_limits))
        object.__setattr__(self, "min_contraction", checked_contraction(self.min_contraction))
        object.__setattr__(self, "angle_limits", _angle_limits(self.angle_limits, self.routes))
        object.__setattr__(self, "muscle_names", _names("muscle", self.muscle_names, m))
        object.__setattr__(self, "joint_names", _names("joint", self.joint_names, n))
        checked_gas(self.gas)

    def __repr__(self) -> str:
        laws = " and ".join(dict.fromkeys(type(muscle).__name__ for muscle in self.muscles))
        low, high = (P / BAR for P in self.pressure_limits)
        return (
            f"Mechanism: {self.n} joint{'s' * (self.n > 1)}, {self.m} muscles {laws} on {type(self.routes).__name__}, "
            f"{low:g} … {high:g} bar"
        )

    @classmethod
    def from_joint(cls, joint: AntagonistJoint) -> Self:
        """Return an antagonistic joint as a mechanism with n = 1 and m = 2, without its friction."""
        return cls(
            routes_of(joint.geometry),
            (joint.agonist, joint.antagonist),
            joint.pressure_limits,
            angle_limits=(joint.angle_range,),
            min_contraction=joint.min_contraction,
            muscle_names=("agonist", "antagonist"),
            gas=joint.gas,
        )

    @classmethod
    def from_mjcf(
        cls,
        file: str | PathLike[str] | object,
        muscles: Muscle | Sequence[Muscle],
        rest_length: ArrayLike | None = None,
        *,
        cable: ArrayLike | None = None,
        contraction: ArrayLike | None = None,
        pressure_limits: tuple[float, float] = (0.0, 5 * BAR),
    ) -> Self:
        """Return the mechanism whose muscles are the tendons of a MuJoCo model, with the model's names.

        `file` may also be MJCF text or an `MjModel`. Spatial tendons through sites become `Sites`, fixed ones
        `Pulleys`. `rest_length` and `cable` [m] (the part of the tendon that is cable, by default 0) are numbers or
        rows (m,), required unless `mpc.arm.mjcf.to_mjcf` wrote the model. The muscles' `contraction` [-] in the model's
        own posture may replace `cable`. Joints have to be hinges or slides; their
        ranges become angle limits if all have one. Needs `antagonist[mujoco]`. Raises `InvalidFile`, also for a model
        without tendons, `InvalidInput` and `MissingBackend`.
        """
        from allocator.mechanism.routes.mjcf import read_mjcf

        model = read_mjcf(file, rest_length, cable, contraction)
        return cls(
            model.routes,
            muscles,  # type: ignore[arg-type]  # one or a sequence, see __post_init__
            pressure_limits,
            angle_limits=model.ranges,
            muscle_names=model.muscles,
            joint_names=model.joints,
        )

    @cached_property
    def n(self) -> int:
        """Number of joints."""
        return self.routes.n

    @cached_property
    def m(self) -> int:
        """Number of muscles."""
        return self.routes.m

    @property
    def pressure_span(self) -> float:
        """Width of the supply range [Pa]; tolerances are given in fractions of it."""
        return self.pressure_limits[1] - self.pressure_limits[0]

    @cached_property
    def affine(self) -> bool:
        """Whether all muscles are affine in pressure."""
        return not self.not_affine

    @cached_property
    def not_affine(self) -> tuple[str, ...]:
        """Names of the muscles that are not affine in pressure."""
        at = self.at(np.zeros(self.n))
        return tuple(name for name, muscle in zip(self.muscle_names, at, strict=True) if not muscle.affine)

    @cached_property
    def upper_triangle(self) -> tuple[Indices, Indices]:
        """Rows and columns of K11, K12, …, Knn: the order of a `TargetsMap`."""
        return np.triu_indices(self.n)

    # --- at postures ------------------------------------------------------------------------------------------------

    def at(self, q: Array, shares: Shares | None = None) -> tuple[OneMuscle, ...]:
        """Return every muscle at the postures `q` (…, n), without checks.

        Their stiffness is isobaric, or includes these `shares` (m,) of the trapped gas   (G5)
        """
        routed = self.routes.at(q)
        eps = self.routes.contraction(routed.length)
        return tuple(
            OneMuscle(
                *(muscle, name, L, eps[..., j], routed.arm[..., j, :], routed.bend[..., j, :, :]),
                share=shares[j] if shares is not None and shares[j] else None,
                gas=self.gas,
                vector=True,
            )
            for j, (muscle, name, L) in enumerate(
                zip(self.muscles, self.muscle_names, self.routes.rest_length, strict=True)
            )
        )

    def lengths(self, q: ArrayLike) -> Array:
        """Return the muscles' lengths l (…, m) [m] at the postures `q` (…, n)."""
        return self.routes.at(self.posture(q)).length

    def contractions(self, q: ArrayLike) -> Array:
        """Return the muscles' contractions ε = (L - l)/L (…, m) [-] at the postures `q` (…, n)."""
        return self.routes.contraction(self.lengths(q))

    def arms(self, q: ArrayLike) -> Array:
        """Return the arms r = -∇l (…, m, n) [m] at the postures `q` (…, n)."""
        return self.routes.at(self.posture(q)).arm

    def forces(self, q: ArrayLike, P: ArrayLike) -> Array:
        """Return the muscles' forces F (…, m) [N]; negative for a slack muscle."""
        muscles, pressures = self._held(q, P)
        return np.stack([muscle.force(pressures[..., j]) for j, muscle in enumerate(muscles)], axis=-1)

    def torque(self, q: ArrayLike, P: ArrayLike) -> Array:
        """Return the torques τ = Σ r F (…, n) [N·m]   (M1)"""
        muscles, pressures = self._held(q, P)
        return np.asarray(sum(muscle.torque(pressures[..., j]) for j, muscle in enumerate(muscles)))

    def stiffness(
        self, q: ArrayLike, P: ArrayLike, valves: Valves = "open", frequency: object = None, lag: object = None
    ) -> Array:
        """Return the stiffness (…, n, n) [N·m/rad]: the isobaric K = -∂τ/∂q at constant pressures, or with its gas.

        `valves` "open" is isobaric   (M2); "shut", or a truth value for each muscle, adds the stiffness of the trapped
        gas, κ (P + p_a)/V^eff g gᵀ with g = r F_P   (G2). With a `frequency` [Hz] and the regulators' `lag` [s], a
        number or (m,), it is the stiffness against small motions at this frequency, the real part of the dynamic
        stiffness   (G5). Raises `InvalidInput` for invalid arguments, for a muscle of unknown volume and if V^eff ≤ 0.
        """
        muscles, pressures = self._held(q, P, self.kind(valves, frequency, lag).fixed)
        for j, muscle in enumerate(muscles):
            if muscle.share is not None:
                muscle.check_effective_volume(pressures[..., j])
        return np.asarray(sum(muscle.stiffness(pressures[..., j]) for j, muscle in enumerate(muscles)))

    def kind(self, valves: object = "open", frequency: object = None, lag: object = None) -> StiffnessKind:
        """Return the kind of stiffness of these arguments of `stiffness`. Raises `InvalidInput`."""
        return StiffnessKind.of(valves, frequency, lag, self.muscle_names).of_gas(self.gas, self.affine)

    def targets_map(self, q: ArrayLike) -> TargetsMap:
        """Return y(P) = y0 + M P, torques and stiffnesses over the pressures [Pa], at the postures `q` (…, n).

        Raises `InvalidInput` for muscles that are not affine in the pressure.
        """
        self.check_affine("targets_map")
        return self.map_of(self.at(self.posture(q)))

    def map_of(self, muscles: tuple[OneMuscle, ...]) -> TargetsMap:
        """Return the map of affine muscles at postures."""
        zero = np.zeros(())
        rows, columns = self.upper_triangle
        y0, M = np.zeros(()), []
        for muscle in muscles:
            y0 = np.asarray(y0 + _stacked(muscle.torque(zero), muscle.stiffness(zero), rows, columns))
            M.append(_stacked(muscle.torque_gain(zero), muscle.stiffness_gain(zero), rows, columns))
        return TargetsMap(y0, np.stack(M, axis=-1))

    def stacked(self, torque: Array, stiffness: Array) -> Array:
        """Return y (…, d) from τ (…, n) and K (…, n, n)."""
        return _stacked(torque, stiffness, *self.upper_triangle)

    def pressure_box(self, q: ArrayLike, limits: Limits = TAUT) -> tuple[Array, Array]:
        """Return the least and the greatest pressures (…, m) [Pa] allowed by supply, model and `limits`."""
        now, step = limits.previous, limits.max_step
        slew = None if now is None else tuple(np.moveaxis(self.pressures("previous", now), -1, 0))
        step = None if step is None else checks.positive_pressure("max_step", step)
        each = [Limits(low, high, None, slew, step) for low, high in self.force_limits(limits)]
        box = self.intervals(self.at(self.posture(q)), each)
        return np.stack([side.lo for side in box], axis=-1), np.stack([side.hi for side in box], axis=-1)

    def intervals(
        self, muscles: tuple[OneMuscle, ...], limits: Sequence[Limits] | None = None
    ) -> tuple[PressureInterval, ...]:
        """Return the interval of every muscle's pressure under its own `limits`; the slew limit has all m muscles."""
        found = []
        for j, muscle in enumerate(muscles):
            own = TAUT if limits is None else limits[j]
            if own.previous is not None:
                own = own._replace(previous=(own.previous[j],))
            found.append(muscle.interval(self.pressure_limits, own))
        return tuple(found)

    def within(self, q: Array) -> Array:
        """Return the postures `q` (…, n), moved within the angle limits."""
        return q if self.angle_limits is None else np.clip(q, *np.transpose(self.angle_limits))

    def whole(self, triangle: Array) -> Array:
        """Return the stiffness K (…, n, n) from its upper triangle (…, n(n+1)/2)."""
        rows, columns = self.upper_triangle
        K = np.empty((*triangle.shape[:-1], self.n, self.n))
        K[..., rows, columns] = K[..., columns, rows] = triangle
        return K

    # --- checks -----------------------------------------------------------------------------------------------------

    def posture(self, q: object, name: str = "q") -> Array:
        """Return the checked postures `q` (…, n) [rad], called `name` in messages. Raises `InvalidInput`."""
        return self.sized(name, checks.angle(name, q), self.n, "joint angles [rad]")

    def pressures(self, name: str, P: object) -> Array:
        """Return the checked pressures `P` (…, m) [Pa]. Raises `InvalidInput`."""
        return self.sized(name, checks.pressure(name, P), self.m, "pressures [Pa]")

    def force_limits(self, limits: Limits) -> list[tuple[float | None, float | None]]:
        """Return the least and the greatest force of each muscle [N]. Raises `InvalidInput`, also for a floor on P."""
        if limits.min_cocontraction is not None:
            raise InvalidInput("min_cocontraction bounds the mean of two pressures, of an AntagonistJoint only")
        lows, highs = self.each("min_force", limits.min_force), self.each("max_force", limits.max_force)
        for name, low, high in zip(self.muscle_names, lows, highs, strict=True):
            if high is not None and high <= (low or 0.0):
                raise InvalidInput(f"max_force = {high:g} N of {name} has to exceed min_force = {low or 0.0:g} N")
        return list(zip(lows, highs, strict=True))

    def each(self, name: str, force: object) -> list[float | None]:
        """Return a force limit [N] for each of the m muscles, from one number, a row (m,), or None."""
        if force is None:
            return [None] * self.m
        array = checks.real(name, force, "N")
        if array.shape not in ((), (self.m,)) or (array < 0).any():
            raise InvalidInput(f"{name} = {checks.brief(force)} has to be one force, or m = {self.m}, not negative [N]")
        return np.broadcast_to(array, (self.m,)).tolist()  # type: ignore[no-any-return]  # floats

    def check_affine(self, what: str) -> None:
        """Raise `InvalidInput` if muscles are not affine in pressure, with their names; `what` needs affine ones."""
        if self.not_affine:
            named = zip(self.muscle_names, self.muscles, strict=True)
            curved = sorted({type(muscle).__name__ for name, muscle in named if name in self.not_affine})
            raise InvalidInput(
                f"{', '.join(self.not_affine)}: not affine in the pressure ({', '.join(curved)}); {what} is for affine "
                "muscles only, such as Sarosi2012 or Hildebrandt2005"
            )

    def sized(self, name: str, array: Array, size: int, what: str) -> Array:
        """Raise `InvalidInput` unless the last axis of `array` has the length `size`."""
        if array.ndim == 0 or array.shape[-1] != size:
            raise InvalidInput(
                f"{name} has the shape {array.shape}; expected (…, {size}), {what} of a mechanism with n = {self.n} "
                f"joints and m = {self.m} muscles"
            )
        return array

    def _held(self, q: object, P: object, shares: Shares | None = None) -> tuple[tuple[OneMuscle, ...], Array]:
        q, P = self.posture(q), self.pressures("P", P)
        try:
            np.broadcast_shapes(q.shape[:-1], P.shape[:-1])
        except ValueError:
            raise InvalidInput(f"shapes do not broadcast: q {q.shape}, P {P.shape} but for their last axes") from None
        return self.at(q, shares), P

    def with_muscles(self, muscles: Muscle | Sequence[Muscle]) -> Self:
        """Return the same mechanism with other muscles, one for all or m of them."""
        return replace(self, muscles=muscles)  # type: ignore[arg-type]  # one or a sequence


def _stacked(torque: Array, stiffness: Array, rows: Indices, columns: Indices) -> Array:
    return np.concatenate([torque, stiffness[..., rows, columns]], axis=-1)


def _angle_limits(value: object, routes: Routes) -> tuple[tuple[float, float], ...] | None:
    """Return the checked end stops within the reach of the routes. Raises `InvalidInput`."""
    if value is None:
        return routes.reach
    array = checks.angle("angle_limits", value)
    if array.shape != (routes.n, 2) or not (array[:, 0] < array[:, 1]).all():
        raise InvalidInput(f"angle_limits have to be (lower, upper) of each of n = {routes.n} joints, increasing [rad]")
    if routes.reach is not None:
        low, high = np.transpose(routes.reach)
        array = np.stack([np.maximum(array[:, 0], low), np.minimum(array[:, 1], high)], axis=1)
        if not (array[:, 0] < array[:, 1]).all():
            raise InvalidInput("angle_limits lie outside the angles of the routes' table")
    return tuple((float(low), float(high)) for low, high in array)


def _names(kind: str, names: Sequence[str], count: int) -> tuple[str, ...]:
    if not names:
        return tuple(f"{kind} {i + 1}" for i in range(count))
    if isinstance(names, str) or len(names) != count or len(set(names)) != count:
        raise InvalidInput(f"{kind}_names = {names!r} have to be {count} different names")
    return tuple(map(str, names))
