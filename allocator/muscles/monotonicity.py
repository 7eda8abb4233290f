"""Does a muscle satisfy [M], F_P > 0 and F_Pε < 0, on a rectangle of pressures and contractions where it is taut?"""

import numpy as np

from allocator.muscles.base import Muscle
from allocator.units import BAR

_GRID = 81


def monotonicity_failure(muscle: Muscle, max_pressure: float, contraction: tuple[float, float]) -> str:
    """Where [M] fails for 0 < P ≤ `max_pressure` [Pa] and `contraction` between the two ratios, in a sentence.

    Empty if it holds at every point of an 81 × 81 grid at which the law is evaluated and the muscle taut (F ≥ 0).
    """
    if muscle.limitation:
        return muscle.limitation
    least, most = max(contraction[0], muscle.min_contraction), min(contraction[1], muscle.max_contraction)
    inside = np.linspace(least, most, _GRID + 1)[1:]  # the law may be singular at its very beginning
    P, eps = np.meshgrid(np.linspace(0, max_pressure, _GRID)[1:], inside)
    taut = muscle.force(P, eps) >= 0
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


def _where(what: str, wrong: np.ndarray, taut: np.ndarray, P: np.ndarray, eps: np.ndarray) -> str:
    share = 100 * wrong.sum() / taut.sum()
    return (
        f"{what} on {share:.0f} % of the taut domain, within {P[wrong].min() / BAR:.2f}–{P[wrong].max() / BAR:.2f} bar "
        f"and ε = {eps[wrong].min():.3f}–{eps[wrong].max():.3f}"
    )


__all__ = ["monotonicity_failure"]
