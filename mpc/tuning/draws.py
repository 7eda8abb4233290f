"""Draws of real plants and arms from the posterior of a fit.

Each number is the file's value times exp(σ z), z ~ N(0, 1). σ is a spread. Without intervals it is the usual one of
data sheets, σ₀. The 95 % intervals of a file (table [intervals], written by `antagonist fit-motion`) narrow it,
1/σ² = 1/σ₀² + 1/σ_fit²: a log that hardly determines a number does not widen its spread. σ is never below `LEAST`,
since no model is exact. The draws form a Latin hypercube, so that a few of them cover the posterior.

Dead time and reading age of the file vary by the same factor, as only their sum affects the loop. The muscles of an arm
differ in strength and in the offsets of their sensors; all of them share the factors of lags, gas and dead time, and
all links those of masses and damping.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import hypot, sqrt
from typing import Any, Self

import numpy as np
from scipy.special import ndtri

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.files.text import FilePath
from allocator.files.toml import Table
from allocator.muscles import Muscle
from allocator.units import BAR, DEG
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Hysteresis
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.machine import Machine
from mpc.model.real import Real, RealArm, RealPlant

LEAST = 0.05  # relative error of any fitted number
_95 = 1.96  # standard deviations in half an interval of 95 %
_INTERVALS = {  # of `MotionFit.parameters`, by the spreads that they give
    "strength": ("gain",),
    "inertia": ("inertia",),
    "damping": ("damping",),
    "lag": ("lag_up", "lag_down"),
    "dead_time": ("dead_time",),
    "dead_band": ("dead_band",),
    "volume": ("volume",),
}


_LOGARITHMIC = "strength", "inertia", "damping", "volume", "dead_time", "dead_band"
_FACTORS = {"lag_up": "lag", "lag_down": "lag"} | {name: name for name in _LOGARITHMIC}  # spreads of drawn factors


@dataclass(frozen=True)
class Spreads:
    """Relative standard deviations of a plant's numbers, and ranges of effects; the defaults are those of data sheets.

    Raises `InvalidInput` for negative numbers, and for ranges out of order.
    """

    strength: float = 0.08  # of each muscle's force
    inertia: float = 0.15
    damping: float = 0.3
    lag: float = 0.2  # of each regulator's time constants
    dead_time: float = 0.25
    dead_band: float = 0.25
    volume: float = 0.15  # of the gas
    hysteresis: tuple[float, float] = (0.5, 1.5)  # share of the known friction, or of `width` if none is known
    width: float = 4 * DEG  # of a usual hysteresis loop [rad]
    offset: float = 0.03 * BAR  # of the pressure sensors at most [Pa]
    payload: tuple[float, float] = (6 * DEG, 15 * DEG)  # torque of a payload over the stiffness [rad]
    encoder: float = 0.05 * DEG  # [rad]
    pressure_noise: float = 0.01 * BAR  # [Pa]

    def __post_init__(self) -> None:
        """Check the numbers and ranges."""
        for f in fields(self):
            value = getattr(self, f.name)
            for one in value if isinstance(value, tuple) else (value,):
                checks.not_negative(f"Spreads: {f.name}", one, "")
            if isinstance(value, tuple) and not (len(value) == 2 and value[0] <= value[1]):
                raise InvalidInput(f"Spreads: {f.name} = {value} has to be two numbers in order")

    @classmethod
    def of(cls, intervals: Mapping[str, tuple[float, float]]) -> Self:
        """Return the usual spreads, narrowed by a fit's 95 % `intervals` of its parameters."""
        found: dict[str, Any] = {}
        for spread, names in _INTERVALS.items():
            ends = [intervals[name] for name in names if name in intervals and intervals[name][1] > 0]
            if ends:
                usual, relative = getattr(cls, spread), max((high - low) / (high + low) / _95 for low, high in ends)
                found[spread] = hypot(LEAST, usual * relative / hypot(usual, relative))
        return replace(cls(), **found)

    @classmethod
    def load(cls, path: FilePath) -> Self:
        """Return the spreads of the fit in a plant's file. Raises `InvalidFile`."""
        table = Table.read(path).table("intervals")
        if table is None:
            return cls()
        for name, ends in table.entries.items():
            if not (isinstance(ends, list) and len(ends) == 2 and all(isinstance(end, int | float) for end in ends)):
                raise table.fault(f"{name} has to be two numbers, the ends of an interval of 95 %")
            if not 0 <= ends[0] <= ends[1] < np.inf:
                raise table.fault(f"{name} = {ends} has to be two ends in order, 0 or more")
        return cls.of(table.entries)

    def felt_std(self, backbone: Value, felt: Value) -> Value:
        """Return the standard deviation of a model's `felt` stiffness, of which `backbone` is K (any shape) [N·m/rad].

        The backbone varies like the common strength of all muscles, and the rest like the hysteresis about 1. If the
        model does not know the hysteresis of the joint, the result is too small.
        """
        low, high = self.hysteresis
        share = hypot((high - low) / sqrt(12), (high + low) / 2 - 1)
        return np.hypot(self.strength * backbone, share * (felt - backbone))


def draws(plant: Machine, known: Compensation, n: int, seed: int, spreads: Spreads) -> tuple[Real, ...]:
    """Return `n` real machines, without payload, drawn about `plant` and its compensation `known`.

    Raises `InvalidInput` for an arm without formulas.
    """
    places = _places(plant.m)
    unit = _spread(n, places["venting"].stop, [seed, 33])
    widths = (MaxwellSlip.of_width(plant, spreads.width, joint=i) for i in range(plant.n))
    friction = tuple(widths) if known.frictionless else known.of_joints(plant.n)
    return tuple(
        _drawn(plant, known, friction, {name: row[at] for name, at in places.items()}, spreads) for row in unit
    )


def _spread(n: int, dimensions: int, seed: list[int]) -> Array:
    """Return `n` points (n, dimensions) of a Latin hypercube in the unit cube."""
    from scipy.stats import qmc  # takes a second to import, and only tuning needs it

    return np.asarray(qmc.LatinHypercube(dimensions, rng=np.random.default_rng(seed)).random(n), float)


def _places(m: int) -> dict[str, slice]:
    """Return the places of the numbers that differ between draws, in a row of a hypercube, for `m` muscles."""
    sizes = {"strength": m, "inertia": 1, "damping": 1, "lag_up": 1, "lag_down": 1, "volume": 1, "hysteresis": 1}
    sizes |= {"dead_time": 1, "dead_band": 1, "offset": m, "unused": 1, "venting": 1}  # unused: keeps a seed's plants
    ends = np.cumsum([0, *sizes.values()]).tolist()
    return {name: slice(begin, end) for name, begin, end in zip(sizes, ends[:-1], ends[1:], strict=True)}


def _drawn(
    plant: Machine, known: Compensation, friction: tuple[Hysteresis, ...], unit: Mapping[str, Array], s: Spreads
) -> Real:
    """Return the machine at one point of the unit cube, by the names of `_places`."""
    factors = {name: np.exp(getattr(s, of) * ndtri(unit[name])).tolist() for name, of in _FACTORS.items()}
    (inertia,), (damping,), (volume,) = (factors[name] for name in ("inertia", "damping", "volume"))
    share = s.hysteresis[0] + (s.hysteresis[1] - s.hysteresis[0]) * float(unit["hysteresis"][0])
    friction = tuple(one.share(share) for one in friction)
    effects = _effects(plant, known, factors, unit, s)
    if isinstance(plant, Arm):
        return RealArm(_swelling(plant, volume), friction=friction, mass=inertia, damping=damping, **effects)
    joint = plant.joint
    if plant.gas is not None:
        length, muscles = joint.geometry.rest_length, (joint.agonist, joint.antagonist)
        agonist, antagonist = (_holding(muscle, volume, length) for muscle in muscles)
        joint = replace(joint, agonist=agonist, antagonist=antagonist)
    own = replace(plant, joint=joint, inertia=plant.inertia * inertia, damping=plant.damping * damping)
    return RealPlant(own, friction=friction[0], **effects)


def _effects(
    plant: Machine, known: Compensation, factors: Mapping[str, list[float]], unit: Mapping[str, Array], s: Spreads
) -> dict[str, Any]:
    """Return the strengths of the muscles, the regulators and the sensors of a draw."""
    usual = np.mean(np.array(plant.lags_each_way), axis=1).tolist()
    up, down = known.lag_up or usual[0], known.lag_down or usual[1]
    if known.lag_down is None and up == down:
        down *= 1 + 0.5 * float(unit["venting"][0])  # venting takes longer
    return {
        "force_gains": tuple(factors["strength"]),
        "dead_time": known.dead_time * factors["dead_time"][0],
        "reading_age": known.reading_age * factors["dead_time"][0],
        "dead_band": known.dead_band * factors["dead_band"][0],
        "lag_up": up * factors["lag_up"][0],
        "lag_down": down * factors["lag_down"][0],
        "flow": known.flow,
        "encoder": s.encoder,
        "pressure_noise": s.pressure_noise,
        "pressure_offset": tuple((s.offset * (2 * unit["offset"] - 1)).tolist()),
    }


def payloads(n: int, seed: int, K: Value, spreads: Spreads) -> tuple[Value, ...]:
    """Return the torque [N·m] of a payload for each of `n` draws at the stiffness `K` [N·m/rad], of either sign.

    For an arm with the joints' stiffness `K` (n, n) they are torques (n,), K times a turn of every joint.
    """
    joints = len(np.atleast_2d(K))
    unit = _spread(n, joints, [seed, 34])
    low, high = spreads.payload
    signs = 1 - 2.0 * (np.arange(n)[:, None] >> np.arange(joints) & 1)
    turns = signs * (low + (high - low) * unit)
    return tuple((K * turns[:, 0]).tolist() if np.ndim(K) == 0 else map(tuple, (turns @ K).tolist()))


def _swelling(arm: Arm, factor: float) -> Arm:
    """Return the arm with `factor` times its volumes of gas at rest, if it has gas."""
    if arm.gas is None:
        return arm
    muscles = zip(arm.mechanism.muscles, arm.mechanism.routes.rest_length, strict=True)
    return replace(arm, mechanism=replace(arm.mechanism, muscles=tuple(_holding(one, factor, L) for one, L in muscles)))


def _holding(muscle: Muscle, factor: float, rest_length: float) -> Muscle:
    """Return the muscle with `factor` times its volume of gas at rest."""
    volume = float(muscle.volume_at_rest(rest_length)) - muscle.tube_volume
    return replace(muscle, inner_radius=None, rest_volume=volume * factor)
