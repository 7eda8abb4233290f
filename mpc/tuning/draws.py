"""Draws of real plants from the posterior of a fit.

Each number is the file's value times exp(σ z), z ~ N(0, 1). σ is a spread: that of the file's 95 % intervals (table
[intervals], written by `antagonist fit-motion`), never below `LEAST`, since no model is exact; without intervals
it is the usual spread of data sheets. The draws form a Latin hypercube, so that a few of them cover the posterior.

Dead time and reading age of the file vary by the same factor, as only their sum affects the loop.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import hypot
from typing import Any, Self

import numpy as np
from scipy.special import ndtri
from scipy.stats import qmc

from allocator import checks
from allocator.errors import InvalidInput
from allocator.files.text import FilePath
from allocator.files.toml import Table
from allocator.muscles import Muscle
from allocator.units import BAR, DEG
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Hysteresis
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.plant import Plant
from mpc.model.real_plant import RealPlant

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
    hysteresis: tuple[float, float] = (0.5, 1.2)  # share of the known friction, or of `width` if none is known
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
        """Return the spreads of a fit, from the 95 % `intervals` of its parameters; the usual ones of all others."""
        found: dict[str, Any] = {}
        for spread, names in _INTERVALS.items():
            ends = [intervals[name] for name in names if name in intervals and intervals[name][1] > 0]
            if ends:
                relative = max((high - low) / (high + low) / _95 for low, high in ends)
                found[spread] = hypot(LEAST, relative)
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


def draws(plant: Plant, known: Compensation, n: int, seed: int, spreads: Spreads) -> tuple[RealPlant, ...]:
    """Return `n` real plants, without payload, drawn about `plant` and its compensation `known`."""
    unit = qmc.LatinHypercube(_NUMBERS, rng=np.random.default_rng([seed, 33])).random(n)
    friction = MaxwellSlip.of_width(plant, spreads.width) if known.friction.absent else known.friction
    return tuple(_drawn(plant, known, friction, row, spreads) for row in unit)


_NUMBERS = 14  # numbers that differ between draws


def _drawn(plant: Plant, known: Compensation, friction: Hysteresis, row: np.ndarray, s: Spreads) -> RealPlant:
    """Return the plant at one point (14,) of the unit cube."""
    u, z = row.tolist(), ndtri(row)

    def factor(i: int, sigma: float) -> float:
        return float(np.exp(sigma * z[i]))

    volume = factor(6, s.volume)
    joint = plant.joint
    if plant.gas is not None:
        length, muscles = joint.geometry.rest_length, (joint.agonist, joint.antagonist)
        agonist, antagonist = (_holding(muscle, volume, length) for muscle in muscles)
        joint = replace(joint, agonist=agonist, antagonist=antagonist)
    up, down = (own or float(np.mean(plant.lags)) for own in (known.lag_up, known.lag_down))
    if known.lag_down is None:
        down *= 1 + 0.5 * u[13]  # venting takes longer
    inertia, damping = plant.inertia * factor(2, s.inertia), plant.damping * factor(3, s.damping)
    return RealPlant(
        replace(plant, joint=joint, inertia=inertia, damping=damping),
        force_gains=(factor(0, s.strength), factor(1, s.strength)),
        friction=friction.share(s.hysteresis[0] + (s.hysteresis[1] - s.hysteresis[0]) * u[7]),
        dead_time=known.dead_time * factor(8, s.dead_time),
        reading_age=known.reading_age * factor(8, s.dead_time),
        dead_band=known.dead_band * factor(9, s.dead_band),
        lag_up=up * factor(4, s.lag),
        lag_down=down * factor(5, s.lag),
        flow=known.flow,
        encoder=s.encoder,
        pressure_noise=s.pressure_noise,
        pressure_offset=(s.offset * (2 * u[10] - 1), s.offset * (2 * u[11] - 1)),
    )


def payloads(n: int, seed: int, K: float, spreads: Spreads) -> tuple[float, ...]:
    """Return the torque [N·m] of a payload for each of `n` draws at the stiffness `K` [N·m/rad], of either sign."""
    unit = qmc.LatinHypercube(1, rng=np.random.default_rng([seed, 34])).random(n)[:, 0]
    low, high = spreads.payload
    signs = np.where(np.arange(n) % 2, -1.0, 1.0)
    return tuple((K * signs * (low + (high - low) * unit)).tolist())


def _holding(muscle: Muscle, factor: float, rest_length: float) -> Muscle:
    """Return the muscle with `factor` times its volume of gas at rest."""
    volume = float(muscle.volume_at_rest(rest_length)) - muscle.tube_volume
    return replace(muscle, inner_radius=None, rest_volume=volume * factor)
