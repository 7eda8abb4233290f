"""Search for arrays of targets: NumPy in, NumPy out.

Compiled code is used where it is there (`ready`), or for so many targets that it pays to make it; else the loops run as
plain Python.

`rows` are the numbers that describe a muscle's curve at angles, as `allocator.search.curves` takes them.

With a share of the trapped gas the stiffness is no combination of the functions of the law's basis: then torque and
stiffness are Chebyshev series, from angle to angle between the pressures that the box leaves there, up to which the
gas keeps a positive V^eff. Where the law has a kink its volume, and so the stiffness, jumps: one segment ends at the
last number below the kink, the next begins at it.
"""

from collections.abc import Callable, Sequence
from functools import cache, partial
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.compilation import jit
from allocator.errors import InvalidInput
from allocator.joint.limits import PressureBox, PressureInterval
from allocator.joint.one_muscle import OneMuscle
from allocator.joint.torque_levels import BothMuscles, Pair
from allocator.muscles.basis import Basis, sampling
from allocator.search import arcs, curves, loops, pairs, stretches
from allocator.search.curves import CHEBYSHEV, EXPONENTIAL, HEAD, K_T, QUADRATIC, RATIONAL
from allocator.search.loops import LOOPS, MOST

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
    whole = partial(_segment, side, basis)
    pieces = (_halved(whole, a, b, f"{type(side.muscle).__name__}: the force") for a, b in pairwise(ends))
    return _stacked([segment for piece in pieces for segment in piece])


def _halved(whole: Callable[[Any, Any], Array], lo: Any, hi: Any, what: str, left: int = _HALVINGS) -> list[Array]:
    """Return the segments between two kinks, `whole(lo, hi)` or several where a smooth law is too steep for one.

    Raises `InvalidInput` about `what` is not smooth.
    """
    try:
        return [whole(lo, hi)]
    except _Steep:
        if left == 0:
            raise InvalidInput(
                f"{what} has a kink or a jump in pressure near {np.mean(lo + hi) / 2:.6g} Pa; a law with kinks has to "
                "declare them, see Basis"
            ) from None
    middle = (lo + hi) / 2
    return [*_halved(whole, lo, middle, what, left - 1), *_halved(whole, middle, hi, what, left - 1)]


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
    pieces = [(np.maximum(lo, a), np.minimum(hi, b)) for a, b in zip(starts, ends, strict=True)]
    whole, what = partial(_gas_segment, side), f"{type(side.muscle).__name__}: with trapped gas the stiffness"
    return _stacked([segment for a, b in pieces for segment in _halved(whole, a, b, what)])


def _gas_segment(side: OneMuscle, lo: Array, hi: Array) -> Array:
    """Return one segment at n angles, each between its own pressures lo and hi (n,): a point where they are the same.

    Where lo > hi there is none.
    """
    wide = lo < hi
    centre, half = np.where(wide, (lo + hi) / 2, lo), np.where(wide, (hi - lo) / 2, 1.0)
    torque, stiffness = _series(side, centre, np.where(wide, half, 0.0))
    for series, gain in ((torque, side.torque_gain(centre)), (stiffness, side.stiffness_gain(centre))):
        series[1] = np.where(wide, series[1], gain * half)  # a point also has a slope
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
    raise _Steep


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


_PAYS = 30_000  # targets that take plain Python as long as a compilation
_PAYS_SERIES = 600  # the same where curves are Chebyshev series, which take some thirty times as long to cut
_ROOM = 2 * MOST + 1  # numbers of a target that has several pairs or intervals

_PRIORITIES = ("torque", "stiffness", "weighted")  # by the number that the loops know them by

_ready: dict[str, jit.Function] = {}


class Curves(NamedTuple):
    """The curves of both muscles at n angles are (n, segments, numbers), and the box is (n, 5) [Pa].

    A box is (lo1, hi1, lo2, hi2, least sum), the last -inf where there is no co-contraction floor.
    """

    one: Array
    two: Array
    box: Array

    @classmethod
    def of(cls, sides: BothMuscles, box: PressureBox, supply: tuple[float, float]) -> Self:
        """Return the curves of both sides in a box.

        Raises InvalidInput for a law that is not smooth between its kinks.
        """
        (lo1, hi1), (lo2, hi2) = ((interval.lo, interval.hi) for interval in box)
        limits = np.stack(np.broadcast_arrays(lo1, hi1, lo2, hi2, box.least_sum), 1)
        lo, hi = supply  # beyond which a slew limit may lead
        ends = min(lo, limits[:, :4].min(initial=lo)), max(hi, limits[:, :4].max(initial=hi))
        one, two = (rows(side, *ends, interval) for side, interval in zip(sides, box, strict=True))
        return cls(one, two, limits)


def optima(
    curves: Curves,
    T: Array,
    K: Array,
    priority: str,
    weights: tuple[float, float] = (1.0, 1.0),
    now: Pair | None = None,
) -> tuple[Array, Array, Array]:
    """Return (P1, P2 [Pa], gap), each (n,), for the priority "torque", "stiffness" or "weighted".

    Of several pairs that are as good it is the least, or the nearest to the pressures `now`. The gap is that of the
    second goal, or of the weighted cost, in its unit.
    """
    near = np.full((T.size, 2), np.nan) if now is None else np.stack(np.broadcast_arrays(*now), 1)
    P1, P2, gap = _run("optima", 3, (T, K, _PRIORITIES.index(priority), weights), curves, (near,)).T
    return P1, P2, gap


def all_pairs(curves: Curves, T: Array, K: Array) -> tuple[NDArray[np.intp], Array]:
    """Return how many pairs of the box give both targets (n,), and which: (n, m, 2) [Pa], NaN where fewer."""
    return _several(_run("pairs", _ROOM, (T, K), curves))


def torque_intervals(curves: Curves, K: Array) -> tuple[NDArray[np.intp], Array]:
    """Return how many intervals the torques at a stiffness form (n,), and their ends (n, m, 2) [N·m], else NaN."""
    return _several(_run("intervals", _ROOM, (K, K_T), curves))


def determinant_signs(curves: Curves) -> Array:
    """Return the sign that det ∂(T, K)/∂(P1, P2) is proved to have all over the box (n,), 0 where it is not."""
    return _run("signs", 1, (), curves)[:, 0]


@cache
def _compiled(name: str) -> jit.Function | None:
    """Return a loop, compiled for each kind of arguments at its first call (some fifteen seconds), or None."""
    callees = (function for file in (curves, stretches, pairs, arcs, loops) for function in file.FUNCTIONS)
    return jit.compiled(LOOPS[name], callees, inline=False, unaliased=False)


def ready(name: str = "optima") -> bool:
    """Return whether a loop is there compiled, or can be: then compile it, or load it, at its first call."""
    if name not in _ready and (function := _compiled(name)) is not None:
        _ready[name] = function
    return name in _ready


def prepare(targets: int) -> None:
    """Compile the search of the optimum, or load it, if it pays for so many targets, in however many calls."""
    if targets >= _PAYS:
        ready()


def _run(name: str, width: int, given: tuple[object, ...], curves: Curves, after: tuple[Array, ...] = ()) -> Array:
    """Return the output (n, width) of a loop."""
    n = len(curves.box)
    out = np.zeros((n, width))
    if not n:
        return out
    if n >= (_PAYS_SERIES if CHEBYSHEV in (curves.one[0, 0, 0], curves.two[0, 0, 0]) else _PAYS):
        ready(name)
    arguments = (*given, *curves, *after)
    if (function := _ready.get(name)) is not None:
        function(*(np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in arguments), out)
        return out
    plain = [[0.0] * width for _ in range(n)]
    LOOPS[name](*(x.tolist() if isinstance(x, np.ndarray) else x for x in arguments), plain)
    return np.array(plain)


def _several(out: Array) -> tuple[NDArray[np.intp], Array]:
    count = out[:, 0].astype(np.intp)
    listed = out[:, 1:].reshape(len(out), MOST, 2)[:, : int(count.max(initial=0))]
    return count, np.where(np.arange(listed.shape[1])[:, None] < count[:, None, None], listed, np.nan)
