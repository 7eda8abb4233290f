"""Simulated machines with another force law of the muscles than the controller's model.

A controller tracks its own model exactly, which is no evidence for a real machine. `refitted` fits a force law of a
different structure to the model's forces. `other_plant` adds to such a joint the effects of `RealPlant.standard`:
muscles 10 % stronger and weaker, hysteresis of 5°, dead time, dead band, a limited flow, an encoder and noise. Its
pressures lag 20 % longer. The controller keeps its model, and has the dead time, the dead band, the flow and three
quarters of the friction, as after an identification.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.muscles import Muscle, Sarosi2012, Wickramatunge2010
from allocator.units import BAR, DEG, PERCENT
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.model.real import RealPlant

STIFFNESS_BAND = 0.17
"""Half width of the 95 % band of the stiffness by a model from a data sheet [-].

Each muscle's strength is known to 8 % (1 σ), and force laws that fit the same forces differ by 13 % at most
(`benchmarks/results/model_stiffness.md`).
"""
LONGER_LAG = 1.2  # [-] of the regulators
_LEAST = 0.5 * BAR
_GRID = 25


class OtherPlant(NamedTuple):
    """Plant of another structure than its controller's model, and a sentence that lists the differences."""

    plant: RealPlant
    unknown: str


def other_plant(
    model: Plant, torque_profile: tuple[tuple[float, float], ...] = (), known: Compensation | None = None
) -> OtherPlant:
    """Return a plant like `model` with muscles of another force law, and the effects of a real joint.

    `torque_profile` has pairs of a time [s] and the external torque [N·m] from then on. The law is Wickramatunge2010,
    or Sarosi2012 if the model has that one. The friction and the regulators of the `known` compensation are the
    plant's. Raises `InvalidInput` if the law cannot be fitted to the model's forces.
    """
    told = {} if known is None else known.told
    joint = model.joint
    assert joint.angle_limits is not None  # __post_init__ sets them
    theta = np.linspace(*joint.angle_limits, _GRID)
    contractions = np.stack([one(theta).contraction for one in (joint.geometry.agonist, joint.geometry.antagonist)])
    fitted = refitted((joint.agonist, joint.antagonist), contractions, joint.pressure_limits[1])
    lags = LONGER_LAG * model.lags[0], LONGER_LAG * model.lags[1]
    different = replace(joint, agonist=fitted.muscles[0], antagonist=fitted.muscles[1])
    real = RealPlant.standard(torque_profile=torque_profile, nominal=replace(model, joint=different, lag=lags))
    unknown = [fitted.unknown]
    unknown += ["lags 20 % longer"] * ("lag_up" not in told and "lag_down" not in told)
    return OtherPlant(replace(real, **told), ", ".join([*unknown, unknown_errors(real, "friction" in told)]))


def unknown_errors(real: RealPlant, knows_friction: bool) -> str:
    """Return what no controller knows of a `real` plant, in words: strengths, sensors and a part of the friction."""
    unknown = [_strengths(real.force_gains)] + ["a quarter of the friction"] * (not knows_friction)
    return ", ".join([*unknown, *sensor_errors(real.encoder, real.pressure_noise)])


def sensor_errors(encoder: float, pressure_noise: float) -> tuple[str, str]:
    """Return the steps of an `encoder` [rad] and the noise [Pa] of the pressures in words."""
    return f"encoder steps of {encoder / DEG:g}°", f"{pressure_noise / BAR:g} bar of noise"


class Refitted(NamedTuple):
    """Muscles of other force laws than those of a model, and a sentence that names the laws."""

    muscles: tuple[Muscle, ...]
    unknown: str


def refitted(muscles: Sequence[Muscle], contractions: Array, highest: float) -> Refitted:
    """Return muscles of another law with nearly the forces of `muscles` (m,).

    They pull at contractions in the range of `contractions` [-] and pressures up to the `highest` [Pa]. The law is
    Wickramatunge2010, or Sarosi2012 for muscles of that one. Raises `InvalidInput` if it cannot be fitted.
    """
    found = {muscle: _fitted(muscle, contractions, highest) for muscle in dict.fromkeys(muscles)}
    names = " and ".join(dict.fromkeys(type(muscle).__name__ for muscle, _ in found.values()))
    error = max(error for _, error in found.values())
    return Refitted(
        tuple(found[muscle][0] for muscle in muscles),
        f"muscles of {names} (forces {error / PERCENT:.2g} % of the range off)",
    )


def _fitted(muscle: Muscle, contractions: Array, highest: float) -> tuple[Muscle, float]:
    """Return a muscle of another law, and its RMS force error over the greatest force [-]."""
    from allocator.identification.muscle.fit import fit

    low, high = max(float(contractions.min()), 0.0), float(contractions.max())
    grid = np.meshgrid(np.linspace(low, high, _GRID), np.linspace(_LEAST, highest, _GRID))
    eps, P = (values.ravel() for values in grid)
    F = np.where(muscle.covers(P, eps), muscle.force(P, eps), 0.0)
    pulls = F > 0
    law = Sarosi2012 if isinstance(muscle, Wickramatunge2010) else Wickramatunge2010
    found = fit(law, eps[pulls], P[pulls], F[pulls], folds=0)
    return replace(found.muscle, covariance=None), found.rms / float(F.max())


def _strengths(gains: tuple[float, float]) -> str:
    """Return the differences of the muscles' strengths in words."""
    words = [f"{abs(g - 1) / PERCENT:.2g} % {'stronger' if g > 1 else 'weaker'}" for g in gains]
    return f"muscles {words[0]} (agonist) and {words[1]} (antagonist)"
