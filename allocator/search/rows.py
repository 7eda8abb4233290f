"""Rows of numbers that describe a muscle's curve at angles, as `allocator.search.curves` takes them.

With a share of the trapped gas the stiffness is no combination of the functions of the law's basis: then torque and
stiffness are Chebyshev series, from angle to angle between the pressures that the box leaves there, up to which the
gas keeps a positive V^eff. Where the law has a kink its volume, and so the stiffness, jumps: one segment ends at the
last number below the kink, the next begins at it.
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.limits import PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.muscles.basis import Basis, sampling
from allocator.search.curves import CHEBYSHEV, EXPONENTIAL, HEAD, QUADRATIC, RATIONAL

_KINDS = {"rational": RATIONAL, "exponential": EXPONENTIAL, "quadratic": QUADRATIC, "smooth": CHEBYSHEV}
_SIZES = (9, 17, 33, 65)  # of a polynomial whose degree is to be found
_HALVINGS = 12  # of the pressures between two kinks, until a law that is still no polynomial is taken for kinked
_TAIL = 1e-13  # of the greatest coefficient: smaller ones are rounding


def rows(side: OneMuscle, lo: float, hi: float, box: PressureInterval | None = None) -> Array:
    """Return the curve of one muscle at n angles: (n, segments, numbers).

    It reaches between two pressures [Pa], or with trapped gas over those of the box alone. Raises InvalidInput for a
    law that is not smooth between its kinks.
    """
    if side.share is not None and not side.affine:
        return _gas_rows(side, *((lo, hi) if box is None else (box.lo, box.hi)))
    basis = side.muscle.basis
    ends = [lo, *(kink for kink in basis.kinks if lo < kink < hi), hi]
    return _stacked([segment for a, b in pairwise(ends) for segment in _segments(side, basis, a, b, _HALVINGS)])


def _segments(side: OneMuscle, basis: Basis, lo: float, hi: float, halvings: int) -> list[Array]:
    """Return the segments between two kinks: one, or several where a smooth law is too steep for one polynomial."""
    try:
        return [_segment(side, basis, lo, hi)]
    except _Steep:
        if halvings == 0:
            raise InvalidInput(
                f"{type(side.muscle).__name__}: the force has a kink or a jump in pressure near {(lo + hi) / 2:.6g} "
                "Pa; a law with kinks has to declare them, see Basis"
            ) from None
    middle = (lo + hi) / 2
    return [*_segments(side, basis, lo, middle, halvings - 1), *_segments(side, basis, middle, hi, halvings - 1)]


class _Steep(Exception):
    """No polynomial of the degrees looked at is the law up to rounding."""


def _stacked(segments: list[Array]) -> Array:
    width = max(segment.shape[1] for segment in segments)
    return np.stack([np.pad(segment, ((0, 0), (0, width - segment.shape[1]))) for segment in segments], 1)


def _gas_rows(side: OneMuscle, lowest: Array | float, highest: Array | float) -> Array:
    """Return the curve of a muscle with trapped gas, which is no combination of the law's basis functions."""
    shape = np.shape(side.contraction)
    lo, hi = (np.broadcast_to(end, shape) for end in (lowest, highest))
    kinks = side.muscle.basis.kinks
    starts, ends = [-np.inf, *kinks], [*(np.nextafter(kink, -np.inf) for kink in kinks), np.inf]
    return _stacked(
        [_gas_segment(side, np.maximum(lo, a), np.minimum(hi, b)) for a, b in zip(starts, ends, strict=True)]
    )


def _gas_segment(side: OneMuscle, lo: Array, hi: Array) -> Array:
    """Return one segment at n angles, each between its own pressures lo and hi (n,): a point where they are the same.

    Where lo > hi there is none.
    """
    wide = lo < hi
    centre, half = np.where(wide, (lo + hi) / 2, lo), np.where(wide, (hi - lo) / 2, 1.0)
    torque, stiffness = _series(side, centre, np.where(wide, half, 0.0))
    for series, gain in ((torque, side.torque_gain(centre)), (stiffness, side.stiffness_gain(centre))):
        series[1] = np.where(wide, series[1], gain * half)  # a point has a slope, too
    head = np.stack([np.full(lo.shape, CHEBYSHEV), centre, half, lo, hi, np.full(lo.shape, float(len(torque)))], 1)
    return np.concatenate([head, torque.T, stiffness.T], axis=1)


def _series(side: OneMuscle, centre: Array, half: Array) -> tuple[Array, Array]:
    """Return the Chebyshev series of torque and stiffness (size, n), of as many terms as leave nothing but rounding."""
    basis = Basis("smooth")
    for size in _SIZES:
        nodes, inverse, greatest = sampling(basis, -1.0, 1.0, size)
        P = centre + nodes[:, None] * half
        found = [_significant(inverse @ f(P), greatest) for f in (side.torque, side.stiffness)]
        if (kept := _length(found)) is not None:
            return found[0][:kept], found[1][:kept]
    raise InvalidInput(
        f"{type(side.muscle).__name__}: with trapped gas the stiffness is no polynomial of degree {_SIZES[-1] - 1} in "
        "the pressure: the law is too steep, or has kinks that it has to declare, see Basis"
    )


def _segment(side: OneMuscle, basis: Basis, lo: float, hi: float) -> Array:
    """Return one segment at n angles: (n, numbers)."""
    force, slope = _coefficients(side, basis, lo, hi)
    arm, bend = np.ravel(side.arm), np.ravel(side.bend)
    torque = arm * force
    stiffness = -(arm**2) / side.rest_length * slope + bend * force
    if side.push is not None:
        stiffness = stiffness + side.push[0] * stiffness + side.push[1] * np.abs(arm) * force
    if side.share is not None:  # of an affine law: affine in the pressure as well
        nodes, inverse, greatest = sampling(basis, lo, hi, len(force))
        stiffness = stiffness + _significant(inverse @ (side.share * side.trapped(nodes[:, None])), greatest)
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
        if (kept := _length(found)) is not None:
            return found[0][:kept], found[1][:kept]
    raise _Steep


def _length(found: Sequence[Array]) -> int | None:
    """Return how many terms of the series (size, n) are more than rounding; None where their ends are not yet."""
    if not all((np.abs(c[-2:]).max(axis=0) <= _TAIL * np.abs(c).max(axis=0)).all() for c in found):
        return None
    kept = [np.abs(c) > _TAIL * np.abs(c).max(axis=0) for c in found]
    return 1 + max(int(np.nonzero(k.any(axis=1))[0].max(initial=1)) for k in kept)


def _sampled(side: OneMuscle, basis: Basis, lo: float, hi: float, size: int) -> tuple[Array, Array]:
    nodes, inverse, greatest = sampling(basis, lo, hi, size)
    P, eps = nodes[:, None], np.ravel(side.contraction)[None, :]
    force, slope = (np.broadcast_to(f(P, eps), (size, eps.size)) for f in (side.muscle.law, side.muscle.slope))
    return _significant(inverse @ force, greatest), _significant(inverse @ slope, greatest)


def _significant(coefficients: Array, greatest: Array) -> Array:
    """Return the coefficients without rounding, so that whatever does not depend on the pressure is constant."""
    share = np.abs(coefficients) * greatest[:, None]
    return np.where(share > _TAIL * share.max(axis=0), coefficients, 0.0)
