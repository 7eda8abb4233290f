"""Known torque of a weight as the scale, in addition to the inertia or instead of it.

Tones leave a common factor open, which the inertia fixes: with an inertia s J, strengths, stiffness and damping are s
times as great. The mean torques during a slow tone without the weight and with it balance its torque W,

    s (g_1 ΔT_1 + g_2 ΔT_2) = W + m g l Δ sin(θ - θ_h)                                                          (W3)

with strengths g_i for the given inertia, and the model's torques T_i at the mean angles and pressures. A symmetric loop
has no mean of its own. The given inertia, ± its error, and s of (W3) are averaged by their variances; if they disagree
by more than three standard deviations, the measurement is refused.
"""

from collections.abc import Callable
from dataclasses import replace
from math import sqrt
from typing import NamedTuple

from mpc.bench.measuring.loops import Tone
from mpc.bench.measuring.strengths import Known
from mpc.model.plant import Plant

_EXACT = 0.01  # relative standard deviation of a weight's torque, and of the model's slope over the sag
_CENTRED = 0.1  # of the height of a loop: how well it is centred
_DISAGREE = 3.0  # standard deviations
_LEAST_INERTIA = 0.01  # relative standard deviation of any inertia


class Weight(NamedTuple):
    """Weight to hang during a measurement."""

    torque: float  # W [N·m], positive if it pulls θ down
    hang: Callable[[float], bool]  # called at every sample; returns whether the weight of this torque hangs


class Scale(NamedTuple):
    """Inertia by a weight, relative to the given one."""

    ratio: float  # s [-]
    std: float


def scale_of(plant: Plant, without: Tone, loaded: Tone, weight: float, strengths: tuple[float, float]) -> Scale:
    """Return the inertia by a weight of a torque [N·m], relative to that of the `strengths`   (W3)"""
    torques = []
    for tone in (without, loaded):
        theta, *P = tone.middle
        sides = plant.joint.sides(theta)
        torque = sum(g * float(s.torque(p)) for g, s, p in zip(strengths, sides, P, strict=True))
        torques.append(torque - float(plant.gravity.moment(theta)))
    taken = torques[1] - torques[0]
    height = max(abs(sum(tone.loop().losses)) * tone.swing for tone in (without, loaded))
    ratio = weight / taken if taken * weight > 0 else float("nan")
    return Scale(ratio, abs(ratio) * sqrt(_EXACT**2 + (_CENTRED * height / taken) ** 2))


def weighed(known: Known, scale: Scale) -> Known:
    """Return the prior knowledge with the average of both inertias."""
    told = max(known.inertia_error, _LEAST_INERTIA)
    weights = 1 / told**2, 1 / scale.std**2
    s = (weights[0] + weights[1] * scale.ratio) / sum(weights)
    return replace(known, inertia=s * known.inertia, inertia_error=1 / sqrt(sum(weights)) / s)


def disagreement(known: Known, scale: Scale) -> str:
    """Return the reason why weight and inertia are inconsistent, or ""."""
    told = max(known.inertia_error, _LEAST_INERTIA)
    if abs(scale.ratio - 1) <= _DISAGREE * sqrt(told**2 + scale.std**2):
        return ""
    return (
        f"by the weight the inertia is {scale.ratio:.2f} ± {scale.std:.2f} times that told (± {100 * told:.0f} %): "
        "check the weight's torque and its direction, and the inertia; --inertia-error 50 gives priority to the weight"
    )
