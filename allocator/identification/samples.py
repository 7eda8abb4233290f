"""Measured forces, and the mistakes that can be seen in them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.units import BAR

_MOST_CONTRACTION = 0.6  # [-] no muscle of this family contracts further
_MOST_STRETCH = -0.25  # [-]
_ZERO_PRESSURE = 0.05 * BAR  # [Pa] what a sensor may be off
_ATMOSPHERE = (0.95 * BAR, 1.10 * BAR)  # [Pa] what an absolute sensor shows on an empty muscle


@dataclass(frozen=True)
class Samples:
    """n measured forces; arrays [n], read-only. A force that is not positive means slack."""

    contraction: Array  # ε [-]
    pressure: Array  # P, gauge [Pa]
    force: Array  # F [N]
    weights: Array  # of the squared residuals, relative [-]
    dropped: Mapping[str, int] = field(default_factory=dict)  # how many samples were left out, by reason

    @classmethod
    def checked(
        cls, contraction: ArrayLike, pressure: ArrayLike, force: ArrayLike, weights: ArrayLike | None = None
    ) -> Self:
        """From anything array-like; raises `InvalidInput` at what cannot be a muscle's force in SI units."""
        eps, P = checks.real("contraction", contraction, "ratio"), checks.pressure("pressure", pressure)
        F = checks.real("force", force, "N")
        w = checks.real("weights", np.ones_like(F) if weights is None else weights, "relative")
        if (w < 0).any():
            raise InvalidInput(f"weights{checks.at(w, w < 0)} has to be at least 0")
        arrays = checks.broadcast(contraction=eps, pressure=P, force=F, weights=w)
        eps, P, F, w = (_frozen(array) for array in arrays)
        if mistake := find_mistake(eps, P, F):
            raise InvalidInput(f"sample {mistake.place}: {mistake.sentence}")
        return cls(eps, P, F, w)

    @property
    def n(self) -> int:
        """Number of samples."""
        return self.force.size

    @property
    def full_scale(self) -> float:
        """The greatest force [N]."""
        return float(self.force.max())

    def where(self, keep: Mask) -> Self:
        """The samples marked in `keep`."""
        eps, P, F, w = (_frozen(array[keep]) for array in (self.contraction, self.pressure, self.force, self.weights))
        return type(self)(eps, P, F, w, self.dropped)

    def without(self, drop: Mask, reason: str) -> Self:
        """The samples not in the mask `drop`, whose number is remembered under `reason`."""
        if not drop.any():
            return self
        return replace(self.where(~drop), dropped={**self.dropped, reason: int(drop.sum())})


def _frozen(array: Array) -> Array:
    """A read-only copy in one row."""
    array = np.array(array).ravel()
    array.flags.writeable = False
    return array


class Mistake(NamedTuple):
    """A sample that cannot be right."""

    place: int  # index of the sample
    quantity: str  # "contraction", "pressure" or "force"
    sentence: str


def find_mistake(contraction: Array, pressure: Array, force: Array) -> Mistake | None:
    """The first sign of percent for ratio, or of absolute for gauge pressure.

    The rules on pressure: a muscle without pressure pulls only when it is stretched. So the pressure is not gauge

    * if any is below -0.05 bar;
    * if at |P| ≤ 0.05 bar a muscle that is contracted (ε > 0) pulls with more than 5 % of the greatest force;
    * if none is below 0.95 bar, and at the lowest, up to 1.10 bar, a muscle at its rest length (|ε| ≤ 0.01) does not
      pull (at 1 bar gauge it would, with some 20 % of its force at 5 bar).

    Forces of a stretched muscle at 0 bar are real and pass.
    """
    return _contraction_mistake(contraction) or _pressure_mistake(contraction, pressure, force)


def _contraction_mistake(eps: Array) -> Mistake | None:
    wrong = (eps > _MOST_CONTRACTION) | (eps < _MOST_STRETCH)
    if not wrong.any():
        return None
    i = int(np.argmax(wrong))
    percent = np.abs(eps).max() > 1
    hint = "was percent meant for the ratio (l0 - l)/l0?" if percent else "is the rest length right?"
    return Mistake(i, "contraction", f"a contraction ratio of {eps[i]:.4g} is beyond any pneumatic muscle; {hint}")


def _pressure_mistake(eps: Array, P: Array, F: Array) -> Mistake | None:
    if (below := -_ZERO_PRESSURE > P).any():
        i = int(np.argmax(below))
        return Mistake(i, "pressure", f"{P[i] / BAR:.4g} bar is below the atmosphere; gauge pressure is expected")
    greatest = F.max(initial=0.0)
    pulls = (np.abs(P) <= _ZERO_PRESSURE) & (eps > 1e-9) & (F > 0.05 * greatest)
    if pulls.any():
        i = int(np.argmax(pulls))
        return Mistake(
            i,
            "pressure",
            f"a force of {F[i]:.4g} N at {P[i] / BAR:.4g} bar and the contraction {eps[i]:.4g}: without pressure a "
            "muscle pulls only when stretched; is the pressure absolute, or its zero or the rest length wrong?",
        )
    lowest = P.min(initial=np.inf)
    empty = (P < lowest + _ZERO_PRESSURE) & (np.abs(eps) <= 0.01)
    if not (greatest > 0 and empty.any()):
        return None
    if _ATMOSPHERE[0] <= lowest <= _ATMOSPHERE[1] and (F[empty] <= 0.02 * greatest).all():
        return Mistake(
            int(np.argmax(empty)),
            "pressure",
            f"no force at {lowest / BAR:.4g} bar, the lowest pressure, and at the rest length: the pressure looks "
            "absolute; subtract the atmosphere (about 1.013 bar), gauge pressure is expected",
        )
    return None


__all__ = ["Mistake", "Samples", "find_mistake"]
