"""Check of [M], F_P > 0 and F_Pε < 0, on a rectangle of pressures and contractions where a muscle is taut."""

import numpy as np

from allocator.calculus import Array, Mask
from allocator.muscles.base import Muscle
from allocator.units import BAR

FAILS = "[M] fails, so that more pressure does not always pull more and stiffen"
"""The consequence of a failure, in the words of messages."""

_GRID = 81
_ROUNDING = 1e-9  # of the greatest force


def monotonicity_failure(muscle: Muscle, max_pressure: float, contraction: tuple[float, float]) -> str:
    """Return where [M] fails for 0 < P ≤ `max_pressure` [Pa] and `contraction` between the two ratios, in a sentence.

    Empty if it holds at every point of an 81 × 81 grid that the law covers and at which the muscle is taut (F > 0). A
    law that gives no number at a point that it covers fails.
    """
    if muscle.limitation:
        return muscle.limitation
    least, most = max(contraction[0], muscle.min_contraction), min(contraction[1], muscle.max_contraction)
    inside = np.linspace(least, most, _GRID + 1)[1:]  # the law may be singular at its very beginning
    P, eps = np.meshgrid(np.linspace(0, max_pressure, _GRID)[1:], inside)
    F = np.where(muscle.covers(P, eps), muscle.law(P, eps), 0.0)
    if not np.isfinite(F).all():
        return f"the law gives no number at contractions within ε = {_ends(eps[~np.isfinite(F)])}"
    taut = F > _ROUNDING * F.max()
    if not taut.any():
        return "no point of the domain is taut"
    pulls_less = taut & ~(muscle.gain(P, eps) > 0)
    softens = taut & ~(muscle.gain_slope(P, eps) < 0)
    words = [
        _where(what, wrong, taut, P, eps)
        for what, wrong in (("F_P <= 0", pulls_less), ("F_Pε >= 0", softens))
        if wrong.any()
    ]
    return "; ".join(words)


def _where(what: str, wrong: Mask, taut: Mask, P: Array, eps: Array) -> str:
    share = max(100 * wrong.sum() / taut.sum(), 0.1)
    bars = P[wrong] / BAR
    return (
        f"{what} on {share:.1f} % of the taut domain, within {bars.min():.2f}–{bars.max():.2f} bar "
        f"and ε = {_ends(eps[wrong])}"
    )


def _ends(ratios: Array) -> str:
    return f"{ratios.min():.3f}–{ratios.max():.3f}"
