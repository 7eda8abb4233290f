"""Domain randomisation: arms that differ from the nominal one within its uncertainty.

The parameters of every fitted muscle are drawn from the normal distribution with the covariance of its fit, equal for
all muscles of a kind, because they were fitted once. Parameters without a fit are drawn with the widths of `Variation`.
"""

from dataclasses import dataclass, fields

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.muscles import Muscle
from allocator.muscles.uncertainty import covariance_root
from mpc.arm.learning.plant import VariedArm

_LOOKED_AT, _MOST_REFUSED = 1000, 0.05  # draws of a covariance, and the greatest share of useless ones


@dataclass(frozen=True)
class Variation:
    """Variation between arms; by default there is none."""

    fit: bool = False  # whether the muscles' parameters are drawn from the covariances of their fits
    gains: float = 0.0  # standard deviation of each muscle's strength [-]
    lags: float = 0.0  # of the logarithm of each regulator's time constant [-]
    mass: float = 0.0  # of the logarithm of the factor of all masses [-]
    damping: float = 0.0  # of the logarithm of the damping's factor [-]
    wall_offset: float = 0.0  # of the wall's offset [m]
    wall_stiffness: float = 0.0  # of the logarithm of the wall's stiffness [-]

    def __post_init__(self) -> None:
        """Check the fields. Raises `InvalidInput`."""
        for entry in fields(self)[1:]:
            unit = "m" if entry.name == "wall_offset" else "-"
            width = checks.number(f"Variation: {entry.name}", getattr(self, entry.name), unit)
            if not 0 <= width <= 1:
                raise InvalidInput(f"Variation: {entry.name} = {width:g} has to lie between 0 and 1, such as 0.05")
            object.__setattr__(self, entry.name, width)

    def check(self, varied: VariedArm) -> None:
        """Raise `InvalidInput` unless `fit` has covariances that can be drawn from, and a varied wall exists."""
        if varied.wall is None and (self.wall_offset or self.wall_stiffness):
            raise InvalidInput("Variation: wall_offset and wall_stiffness need a wall, and this arm meets none")
        if self.fit and not varied.kinds:
            raise InvalidInput("Variation: fit=True, but none of the muscles was fitted: none has a covariance")
        for k, kind in enumerate(varied.kinds):
            if self.fit:
                drawn = _normal(kind, _LOOKED_AT, np.random.default_rng(0))
                if (without := 1 - float(_pulls(varied, k, drawn).mean())) > _MOST_REFUSED:
                    raise InvalidInput(
                        f"Variation: in {without:.0%} of draws from its covariance this {type(kind).__name__} does not "
                        "pull at full pressure: fit it to more, or other, measurements"
                    )

    def draw(self, varied: VariedArm, size: int, rng: np.random.Generator) -> Array:
        """Return rows of values (size, p) for `size` arms, see `VariedArm`."""
        v, at, m = np.tile(varied.nominal, (size, 1)), varied.places, varied.arm.m
        for k in range(len(varied.kinds)):
            if self.fit:
                v[:, at[f"kind {k}"]] = _parameters(varied, k, size, rng)
        v[:, at["gains"]] *= np.maximum(1 + self.gains * rng.standard_normal((size, m)), 0.0)
        v[:, at["lags"]] *= np.exp(self.lags * rng.standard_normal((size, m)))
        v[:, at["mass"]] *= np.exp(self.mass * rng.standard_normal((size, 1)))
        v[:, at["damping"]] *= np.exp(self.damping * rng.standard_normal((size, 1)))
        if varied.wall is not None:
            offset, stiffness, _ = v[:, at["wall"]].T  # views
            offset += self.wall_offset * rng.standard_normal(size)
            stiffness *= np.exp(self.wall_stiffness * rng.standard_normal(size))
        return v


def _parameters(varied: VariedArm, k: int, size: int, rng: np.random.Generator) -> Array:
    """Draw the parameters (size, …) of a kind of muscle; those that do not pull at full pressure are drawn again."""
    drawn = _normal(varied.kinds[k], size, rng)
    while (lame := ~_pulls(varied, k, drawn)).any():  # rare, as ensured by `check`
        drawn[lame] = _normal(varied.kinds[k], int(lame.sum()), rng)
    return drawn


def _normal(kind: Muscle, size: int, rng: np.random.Generator) -> Array:
    mean = np.array(list(kind.parameters.values()))
    assert kind.covariance is not None
    return np.asarray(mean + rng.standard_normal((size, mean.size)) @ covariance_root(kind.covariance).T)


def _pulls(varied: VariedArm, k: int, drawn: Array) -> Mask:
    """Return which of the `drawn` parameters (size, …) pull at full pressure in the middle posture (size,)."""
    kind, mechanism = varied.kinds[k], varied.arm.mechanism
    eps = mechanism.contractions(np.zeros(mechanism.n))[[muscle == kind for muscle in mechanism.muscles]]
    muscle = kind.unchecked([column[:, None] for column in drawn.T])
    with np.errstate(all="ignore"):
        forces = np.asarray(muscle.law(mechanism.pressure_limits[1], eps))
    return np.asarray((np.isfinite(forces) & (forces > 0)).all(axis=1))
