"""Effects of the measurement on forces: sign, offset and noise of the load cell, and hysteresis.

Slack is detected without a model, since the force falls with contraction and rises with pressure: one sample is beyond
another if it is contracted further at no higher pressure, or is at lower pressure and contracted no less. The slack
readings are those beyond a reading that is not above their own median. That median is the cell's offset. The root mean
square of those that differ from it is its zero noise σ0, also for readings cut off at zero: half of a normal
distribution has the same mean square as the whole.

The variance of a reading is that of Rocke & Lorenzato (Technometrics 37:176-184, 1995), σ² = a² + (ρF)², with a ≥
σ0. Its two numbers maximise the likelihood of the residuals of a polynomial in contraction and pressure, so they are
the same for every model. Without zero noise all weights are unchanged.

Hysteresis is the difference between the branches of rising and falling pressure or contraction,

    F = f(ε, P) - s_P h_P/2 - s_ε h_ε/2        s = +1 on a rising branch, -1 on a falling one, 0 where it rests

with a polynomial f and the mean excess h of the falling branch's force, by least squares. A law without memory runs
between the branches. They follow from a column of directions or from the order of the rows; each row is a step of the
quantity that moves further in its range.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import polynomials
from allocator.identification.muscle.samples import Samples, tension

_MOST_READINGS = 2000  # used for the zero
_LEAST_SLACK = 6  # readings that determine the zero
_BEYOND = 0.005  # of the range: difference that counts as further contracted, or as less pressure
_SPREAD = 0.05  # of full scale: greatest scatter of a plateau
_SPREAD_OFF_ZERO = 0.01  # the same for a plateau not at zero
_SHARE_OFF_ZERO = 0.05  # of the samples: least size of such a plateau
_SURE = 4.0  # standard deviations of a significant offset, slope or difference
_DEGREES = ((6, 2), (4, 2), (3, 1), (2, 1), (1, 1))  # of the polynomial in contraction and in pressure
_SAMPLES_PER_TERM = 4
_PASSES = 4  # of weighting and fitting the polynomial
_STILL = 1e-3  # of the range: a smaller step is rest
_WINDOWS = 500  # of a log, each searched for the quantity that moves
_JUMP = 0.3  # of the range: a greater step is a new row of a table, not a motion
_LEAST_RUN = 3  # consecutive rows of one branch
_LEAST_ROWS = 5  # on either branch
_LEAST = 0.005  # of full scale: a smaller difference is not reported


class Zero(NamedTuple):
    """Reading of a load cell without force."""

    offset: float  # [N]
    noise: float  # standard deviation [N]
    cut: bool  # whether it cuts its readings off at zero


def zeroed(samples: Samples, zero_noise: float | None = None) -> Samples:
    """Return the samples with tension positive, without the cell's offset, and with its zero noise, noted in `notes`.

    `zero_noise` [N] is estimated from the slack readings if it is not given.
    """
    F = tension(samples.contraction, samples.pressure, samples.force)
    if F is not samples.force:
        samples = replace(samples, force=F)
        samples = samples.noted("the forces are negative where the muscle pulls: taken with the other sign")
    looked_at = np.zeros(samples.n, bool)
    looked_at[:: -(-samples.n // _MOST_READINGS)] = True  # evenly spread
    zero = find_zero(samples.where(looked_at))
    if zero is None:
        return replace(samples, zero_noise=zero_noise or 0.0)
    noise = zero.noise if zero_noise is None else zero_noise
    samples = replace(samples, zero_seen=True, zero_noise=noise, cut=zero.cut)
    if zero.offset == 0:
        return samples
    note = f"slack readings lie round {zero.offset:.3g} N: taken for the load cell's zero and subtracted"
    return replace(samples, force=samples.force - zero.offset).noted(note)


def find_zero(samples: Samples) -> Zero | None:
    """Return the zero of the load cell; None if too few samples are slack."""
    further = _further(samples)
    level = np.inf
    while True:
        slack = np.asarray(further[:, samples.force <= level].any(axis=1))
        if slack.sum() < _LEAST_SLACK:
            return None
        middle = float(np.median(samples.force[slack]))
        if middle >= level:
            return _zero(samples, slack)
        level = middle


def _further(samples: Samples) -> Mask:
    """Return whether sample i (rows) is certainly slack if sample j (columns) is."""
    eps, P = samples.contraction, samples.pressure
    contracted, emptied = eps[:, None] - eps, P - P[:, None]
    least_eps, least_P = _BEYOND * np.ptp(eps), _BEYOND * np.ptp(P)
    return np.asarray(
        ((contracted > least_eps) & (emptied >= -1e-9 * np.abs(P).max()))
        | ((emptied > least_P) & (contracted >= -1e-9))
    )


def _zero(samples: Samples, slack: Mask) -> Zero | None:
    """Return the zero of the slack readings, or None if they are not a plateau: too scattered, or falling."""
    y = samples.force[slack]
    cut = bool((y == 0).sum() > (y < 0).sum())
    offset = 0.0 if cut else float(np.median(y))
    apart = y[y != offset] - offset
    noise = float(np.sqrt(np.mean(apart**2))) if apart.size else 0.0
    off_zero = abs(offset) > _SURE * noise / np.sqrt(y.size)
    if noise > (_SPREAD_OFF_ZERO if off_zero else _SPREAD) * samples.full_scale:
        return None
    if off_zero and y.size < _SHARE_OFF_ZERO * samples.n:
        return None
    for x in (samples.contraction[slack], samples.pressure[slack]):
        if abs((x - x.mean()) @ (y - y.mean())) > _SURE * noise * np.linalg.norm(x - x.mean()):
            return None
    return Zero(offset if off_zero else 0.0, noise, cut)


def weighted(samples: Samples) -> Samples:
    """Return the samples with their weights divided by the variance of the readings, with the same mean weight."""
    if samples.zero_noise <= 0:
        return samples
    variance = reading_variance(samples)
    if variance is None:
        return samples
    return replace(samples, weights=samples.weights / variance / np.mean(1 / variance))


def reading_variance(samples: Samples) -> Array | None:
    """Return σ² (n,) [N²] of the readings by a two-component model; None if too few samples are taut."""
    taut = ~samples.slack
    terms = polynomial(samples, int(taut.sum()))
    if terms is None:
        return None
    y, w = samples.force[taut], samples.weights[taut]
    variance = np.ones(y.size)
    for _ in range(_PASSES):
        root = np.sqrt(w / variance)
        p, _, rank, _ = np.linalg.lstsq(root[:, None] * terms[taut], root * y, rcond=1e-10)
        F = np.maximum(terms @ p, 0.0)
        square = w * (terms[taut] @ p - y) ** 2 * y.size / (y.size - rank)
        a, share = _most_likely(square, F[taut], samples.zero_noise)
        variance = a**2 + (share * F[taut]) ** 2
    return np.asarray(a**2 + (share * np.where(taut, F, 0.0)) ** 2)


def polynomial(samples: Samples, n: int) -> Array | None:
    """Return the polynomials (n, terms) in contraction and pressure, as many as n samples determine."""
    return polynomials(np.stack([samples.contraction, samples.pressure], axis=1), _DEGREES, n / _SAMPLES_PER_TERM)


def _most_likely(square: Array, F: Array, zero_noise: float) -> tuple[float, float]:
    """Return (a [N], ρ [-]) of the greatest normal likelihood of squared residuals (n,), on a grid."""
    most = max(np.sqrt(square.mean()), zero_noise)
    a = np.append(np.geomspace(zero_noise, most, 15), most)
    share = np.append(0.0, np.geomspace(1e-3, 0.5, 45))
    variance = a[:, None, None] ** 2 + (share[:, None] * F) ** 2  # (16, 46, n)
    loss = (np.log(variance) + square / variance).sum(axis=-1)
    i, j = np.unravel_index(loss.argmin(), loss.shape)
    return float(a[i]), float(share[j])


class Branches(NamedTuple):
    """Difference between falling and rising branches of one quantity."""

    quantity: str  # "pressure" or "contraction"
    difference: float  # h, mean force on falling branches less that on rising ones [N]
    std: float  # of h [N]
    percent: float  # h in percent of the mean force of the taut samples

    def __str__(self) -> str:
        """Return a sentence without a full stop."""
        return (
            f"hysteresis: with falling {self.quantity} it pulls {self.difference:+.2g} ± {self.std:.1g} N "
            f"({self.percent:+.2g} % of the mean force) against rising {self.quantity}; a law without memory lies "
            "between"
        )


def hysteresis(samples: Samples) -> tuple[Branches, ...]:
    """Return the significant differences between branches of the taut samples, in their order."""
    taut = ~samples.slack
    terms = polynomial(samples, int(taut.sum()))
    if terms is None:
        return ()
    signs = _signs(samples)
    both = {q: s for q, s in signs.items() if min((s[taut] > 0).sum(), (s[taut] < 0).sum()) >= _LEAST_ROWS}
    if not both:
        return ()
    A = np.column_stack([*(-s[taut] / 2 for s in both.values()), terms[taut]])
    found, _, rank, _ = np.linalg.lstsq(A, samples.force[taut], rcond=1e-10)
    freedom = int(taut.sum()) - rank
    if freedom < _LEAST_ROWS:
        return ()
    residual = samples.force[taut] - A @ found
    variance = np.diag(np.linalg.pinv(A.T @ A)) * (residual @ residual) / freedom
    mean = float(samples.force[taut].mean())
    every = [
        Branches(q, float(h), float(std), 100 * float(h) / mean)
        for q, h, std in zip(both, found, np.sqrt(np.maximum(variance, 0.0)), strict=False)
    ]
    least = _LEAST * samples.full_scale
    return tuple(b for b in every if abs(b.difference) > max(_SURE * b.std, least))


def _signs(samples: Samples) -> dict[str, Array]:
    moves = {"pressure": _steps(samples.pressure), "contraction": _steps(samples.contraction)}
    further = np.abs(moves["pressure"]) >= np.abs(moves["contraction"])
    signs = {}
    for quantity, step in moves.items():
        moving = (further == (quantity == "pressure")) & (np.abs(step) > _STILL)
        signs[quantity] = np.where(moving, np.sign(step), 0.0)
    if samples.direction is None:
        return {q: np.where(_in_a_branch(s) & (np.abs(moves[q]) < _JUMP), s, 0.0) for q, s in signs.items()}
    moved = max(signs, key=lambda q: int((signs[q] != 0).sum()))
    return {moved: np.array(samples.direction)}


def _in_a_branch(sign: Array) -> Mask:
    """Return the rows (n,) in a run of one sign that is long enough for a branch."""
    run = np.cumsum(np.diff(sign, prepend=sign[:1]) != 0)
    return np.asarray(np.bincount(run)[run] >= _LEAST_RUN)


def _steps(q: Array) -> Array:
    """Return the change of q (n,) around each row, relative to its range."""
    width = max(1, q.size // _WINDOWS)
    after, before = np.minimum(np.arange(q.size) + width - 1, q.size - 1), np.maximum(np.arange(q.size) - width, 0)
    step = (q[after] - q[before]) / max(float(np.ptp(q)), 1e-300)
    if q.size > 1:
        step[0] = step[1]
    return np.asarray(step)
