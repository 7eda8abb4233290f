"""A muscle at angles becomes the rows of numbers in which `allocator.search.curves` takes its curve."""

from itertools import pairwise

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles.basis import Basis, sampling
from allocator.search.curves import CHEBYSHEV, EXPONENTIAL, HEAD, QUADRATIC, RATIONAL

_KINDS = {"rational": RATIONAL, "exponential": EXPONENTIAL, "quadratic": QUADRATIC, "smooth": CHEBYSHEV}
_SIZES = (9, 17, 33, 65)  # of a polynomial whose degree is to be found
_TAIL = 1e-13  # of the greatest coefficient: smaller ones are rounding


def rows(side: OneMuscle, lo: float, hi: float) -> Array:
    """Return the curve of one muscle at n angles between two pressures [Pa]: (n, segments, numbers).

    Raises InvalidInput for a law that is not smooth between its kinks.
    """
    basis = side.muscle.basis
    ends = [lo, *(kink for kink in basis.kinks if lo < kink < hi), hi]
    segments = [_segment(side, basis, a, b) for a, b in pairwise(ends)]
    width = max(segment.shape[1] for segment in segments)
    return np.stack([np.pad(segment, ((0, 0), (0, width - segment.shape[1]))) for segment in segments], 1)


def _segment(side: OneMuscle, basis: Basis, lo: float, hi: float) -> Array:
    """Return one segment at n angles: (n, numbers)."""
    force, slope = _coefficients(side, basis, lo, hi)
    arm, arm_slope = np.ravel(side.arm), np.ravel(side.arm_slope)
    torque = side.sign * arm * force
    stiffness = -(arm**2) / side.rest_length * slope - side.sign * arm_slope * force
    head = np.empty((arm.size, HEAD))
    centre, half = (lo + hi) / 2, (hi - lo) / 2
    head[:] = (
        _KINDS[basis.kind],
        basis.shape if basis.kind == "rational" else centre,
        basis.shape if basis.kind == "exponential" else half,
        lo,
        hi,
        len(force),
    )
    return np.concatenate([head, torque.T, stiffness.T], axis=1)


def _coefficients(side: OneMuscle, basis: Basis, lo: float, hi: float) -> tuple[Array, Array]:
    """Return the coefficients of F and of F_ε (size, n) in the functions of the basis."""
    if basis.kind != "smooth":
        return _sampled(side, basis, lo, hi, 3)
    for size in _SIZES:
        found = _sampled(side, basis, lo, hi, size)
        if all((np.abs(c[-2:]).max(axis=0) <= _TAIL * np.abs(c).max(axis=0)).all() for c in found):
            kept = [np.abs(c) > _TAIL * np.abs(c).max(axis=0) for c in found]
            used = 1 + max(int(np.nonzero(k.any(axis=1))[0].max(initial=1)) for k in kept)
            return found[0][:used], found[1][:used]
    raise InvalidInput(
        f"{type(side.muscle).__name__}: the force is not smooth in the pressure between {lo:g} and {hi:g} Pa; "
        "a law with kinks has to declare them, see Basis"
    )


def _sampled(side: OneMuscle, basis: Basis, lo: float, hi: float, size: int) -> tuple[Array, Array]:
    nodes, inverse, greatest = sampling(basis, lo, hi, size)
    P, eps = nodes[:, None], np.ravel(side.contraction)[None, :]
    force, slope = (np.broadcast_to(f(P, eps), (size, eps.size)) for f in (side.muscle.law, side.muscle.slope))
    return _significant(inverse @ force, greatest), _significant(inverse @ slope, greatest)


def _significant(coefficients: Array, greatest: Array) -> Array:
    """Return the coefficients without those that are rounding, so that what does not depend on the pressure is
    constant.
    """
    share = np.abs(coefficients) * greatest[:, None]
    return np.where(share > _TAIL * share.max(axis=0), coefficients, 0.0)


__all__ = ["rows"]
