"""Simulated joint with another force law of the muscles than the controller's model.

A controller tracks its own model exactly, which is no evidence for a real joint. `other_plant` fits a force law of a
different structure to the model's forces and adds the effects of `RealPlant.standard`: muscles 10 % stronger and
weaker, hysteresis of 5°, dead time, dead band, a limited flow, an encoder and noise. Its pressures lag 20 % longer. The
controller keeps its model, and has the dead time, the dead band and three quarters of the friction, as after an
identification.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.joint.antagonist import AntagonistJoint
from allocator.muscles import Muscle, Sarosi2012, Wickramatunge2010
from allocator.units import BAR, DEG, PERCENT
from mpc.model.plant import Plant
from mpc.model.real import RealPlant

STIFFNESS_BAND = 0.17
"""Half width of the 95 % band of the stiffness by a model from a data sheet [-].

Each muscle's strength is known to 8 % (1 σ), and force laws that fit the same forces differ by 13 % at most
(`benchmarks/results/model_stiffness.md`).
"""
_LONGER_LAG = 1.2
_LEAST = 0.5 * BAR
_GRID = 25


class OtherPlant(NamedTuple):
    """Plant of another structure than its controller's model, and a sentence that lists the differences."""

    plant: RealPlant
    unknown: str


def other_plant(model: Plant, torque_profile: tuple[tuple[float, float], ...] = ()) -> OtherPlant:
    """Return a plant like `model` with muscles of another force law, and the effects of a real joint.

    `torque_profile` has pairs of a time [s] and the external torque [N·m] from then on. The law is Wickramatunge2010,
    or Sarosi2012 if the model has that one. Raises `InvalidInput` if it cannot be fitted to the model's forces.
    """
    joint = model.joint
    fitted = {muscle: _refitted(muscle, joint) for muscle in {joint.agonist, joint.antagonist}}
    agonist, antagonist = (fitted[muscle] for muscle in (joint.agonist, joint.antagonist))
    lags = _LONGER_LAG * model.lags[0], _LONGER_LAG * model.lags[1]
    different = replace(joint, agonist=agonist.muscle, antagonist=antagonist.muscle)
    real = RealPlant.standard(torque_profile=torque_profile, nominal=replace(model, joint=different, lag=lags))
    names = " and ".join(dict.fromkeys(type(one.muscle).__name__ for one in (agonist, antagonist)))
    return OtherPlant(
        real,
        f"muscles of {names} (forces {agonist.error / PERCENT:.2g} % of the range off), "
        f"{_strengths(real.force_gains)}, a quarter of the friction, lags 20 % longer, "
        f"flow up to {real.flow / BAR:g} bar/s, encoder steps of {real.encoder / DEG:g}°, "
        f"{real.pressure_noise / BAR:g} bar of noise",
    )


class _Refitted(NamedTuple):
    muscle: Muscle
    error: float  # RMS force error over the greatest force [-]


def _refitted(muscle: Muscle, joint: AntagonistJoint) -> _Refitted:
    """Return a muscle of another law, fitted to the forces of `muscle` over the joint's range."""
    from allocator.identification.muscle.fit import fit

    eps, P, F = _forces(muscle, joint)
    law = Sarosi2012 if isinstance(muscle, Wickramatunge2010) else Wickramatunge2010
    found = fit(law, eps, P, F, folds=0)
    return _Refitted(replace(found.muscle, covariance=None), found.rms / float(F.max()))


def _forces(muscle: Muscle, joint: AntagonistJoint) -> tuple[Array, Array, Array]:
    """Return contractions [-], pressures [Pa] and forces [N] (n,) of the pulling muscle over the joint's range."""
    assert joint.angle_limits is not None  # __post_init__ sets them
    theta = np.linspace(*joint.angle_limits, _GRID)
    routed = joint.geometry.agonist(theta), joint.geometry.antagonist(theta)
    ends = np.concatenate([np.asarray(one.contraction) for one in routed])
    low, high = max(float(ends.min()), 0.0), float(ends.max())
    grid = np.meshgrid(np.linspace(low, high, _GRID), np.linspace(_LEAST, joint.pressure_limits[1], _GRID))
    eps, P = (values.ravel() for values in grid)
    inside = muscle.covers(P, eps)
    F = np.where(inside, muscle.force(P, eps), 0.0)
    return eps[F > 0], P[F > 0], F[F > 0]


def _strengths(gains: tuple[float, float]) -> str:
    """Return the differences of the muscles' strengths in words."""
    words = [f"{abs(g - 1) / PERCENT:.2g} % {'stronger' if g > 1 else 'weaker'}" for g in gains]
    return f"{words[0]} (agonist) and {words[1]} (antagonist)"
