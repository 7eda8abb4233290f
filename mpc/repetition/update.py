"""The update of a correction between two repetitions of a motion, and its design.

The controller is asked for θ* + c. After repetition j, with the error e_j = θ* - θ,

    c_{j+1} = Q [c_j + γ e_j(t + δ)],      |Q(iω)| = 1/(1 + (ω/ω_c)⁴), zero phase                        (1)

and with the loop's response T of the angle to what is asked for the errors are

    e_{j+1} = Q (I - γ e^{iωδ} T) e_j + (1 - Q) e_0                                                      (2)

so they fall monotonically if |Q| ‖I - γ e^{iωδ} T‖ < 1 at all frequencies (Bristow, Tharayil & Alleyne, A survey of
iterative learning control, IEEE Control Systems 26 (3), 2006). Gain γ, lead δ and cut-off ω_c are those with the least
error predicted by (2) for the worst response of a set, noise of the readings included, that keep the left side below
`MOST` for each of them. The largest left side is the guaranteed rate.

Errors that do not return cannot be learned; a gain of one would carry those of a repetition into the next. Their power
N(ω) follows from repetitions: what (2) does not explain of an error is n_{j+1} - n_j, and the error of the response. An
update that knows N is designed for the part S = |E|² - N of the last error, with N as noise.

(1) filters the correction alone; a reference that is filtered as a whole would lose its own high frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.repetition.response import Response

MOST = 0.9  # of the rate that is guaranteed: errors fall by a tenth at least
GAINS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
LEADS = tuple(0.01 * i for i in range(-2, 15))  # [s]
CUTOFFS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)  # [Hz]
_LOUD = 0.67  # of the highest frequency, above which errors are noise
_BAND = 11  # frequencies, over which powers are averaged


@dataclass(frozen=True)
class Update:
    """Gain, lead and low-pass of an update, and what is guaranteed of it."""

    gain: float  # γ [-]
    lead: float  # δ [s]
    cutoff: float  # of Q, where it is one half [Hz]
    rate: float  # by which errors fall in a repetition at least, at all frequencies of all responses [-]
    predicted: tuple[float, ...]  # RMS error by repetition for the worst response, in units of the first [-]

    def applied(self, correction: Array, error: Array, dt: float) -> Array:
        """Return the next correction (M, n) [rad] from the present one and the errors (M, n) [rad] of every `dt`.

        Equation (1). The last error counts as that of all later times.
        """
        t = dt * np.arange(error.shape[0])
        led = np.stack([np.interp(t + self.lead, t, column) for column in error.T], axis=1)
        return filtered(correction + self.gain * led, self.cutoff, dt)

    def __str__(self) -> str:
        return f"gain {self.gain:.2g}, lead {1e3 * self.lead:.0f} ms, low-pass {self.cutoff:.2g} Hz"


def filtered(values: Array, cutoff: float, dt: float) -> Array:
    """Return `values` (M, n), sampled every `dt` [s], through Q."""
    from scipy.signal import butter, sosfiltfilt

    if cutoff >= 0.45 / dt:
        return values
    padding = min(values.shape[0] - 1, round(3 / cutoff / dt))
    sos = butter(2, cutoff, fs=1 / dt, output="sos")
    return np.asarray(sosfiltfilt(sos, values, axis=0, padtype="constant", padlen=padding))


def designed(
    responses: Sequence[Response],
    error: Array,
    dt: float,
    repetitions: int,
    unlearnable: Array | float = 0.0,
    before: Update | None = None,
) -> Update:
    """Return the update for a loop with one of these `responses`, whose last errors (M, n) [rad] are known.

    `unlearnable` (f,) is the power of errors that do not return, see `unforeseen`. Of an update `before` only the gain
    is designed anew, and not increased: another low-pass would forget what was learned with this one, and where little
    is left to learn, any lead would do.

    Raises `InvalidInput` if no update is guaranteed to converge.
    """
    frequency = responses[0].frequency
    T = np.stack([one.T for one in responses])  # (d, f, n, n)
    first, white = _spectrum(error, frequency, dt)
    noise = np.maximum(unlearnable, white) * np.ones(frequency.size)
    if np.any(unlearnable):
        learnable = np.maximum(1 - noise / np.maximum(_banded(first), 1e-300), 0.0)  # S/|E|²
        first = np.sqrt(learnable)[:, None] * first
    best: tuple[float, Update] | None = None
    leads, cutoffs = (LEADS, CUTOFFS) if before is None else ((before.lead,), (before.cutoff,))
    for gain, lead in product(GAINS, leads):
        if before is not None and gain > before.gain:
            break
        learned = gain * np.exp(2j * np.pi * frequency * lead)[:, None, None] * T  # γ e^{iωδ} T
        left = np.eye(T.shape[-1]) - learned
        norm = np.linalg.norm(left, 2, axis=(-2, -1))  # (d, f)
        for cutoff in cutoffs:
            Q = 1 / (1 + (frequency / cutoff) ** 4)
            rate = float((Q * norm).max())
            if rate > MOST:
                break  # and so do the wider ones
            rms = _predicted(Q, left, first, repetitions)
            spread = (Q * np.linalg.norm(learned, axis=(-2, -1))) ** 2 / (1 - (Q * norm) ** 2)
            heard = np.sqrt((noise * spread).sum(axis=1))  # of the worst response
            cost = float(np.hypot(rms[:, -1], heard).max())
            if best is None or cost < best[0]:
                worst = rms[int(rms[:, -1].argmax())]
                best = cost, Update(gain, lead, cutoff, rate, tuple((worst / max(worst[0], 1e-300)).tolist()))
    if best is None:
        raise InvalidInput(
            f"no update of gain, lead and low-pass is guaranteed to lessen the errors of this loop by "
            f"{100 * (1 - MOST):.0f} % in every repetition; its response differs too much between possible plants"
        )
    return best[1]


def unforeseen(response: Response, before: Array, error: Array, change: Array, dt: float) -> Array:
    """Return the power (f,) of errors (M, n) [rad] that the ones before and the change of correction do not explain.

    It is half of what is left, as both repetitions have some: an upper bound while the response is not the loop's.
    """
    f = response.frequency
    old, new, shift = (_spectrum(values, f, dt)[0] for values in (before, error, change))
    left = new - old + (response.T @ shift[..., None])[..., 0]
    return _banded(left) / 2


def power_of(values: Array, response: Response, dt: float) -> float:
    """Return the power of errors (M, n) [rad] over the frequencies of a response."""
    return float((np.abs(_spectrum(values, response.frequency, dt)[0]) ** 2).sum())


def _banded(spectrum: NDArray[np.complex128]) -> Array:
    """Return the power (f,) of a spectrum (f, n), averaged over neighbouring frequencies."""
    power = np.pad((np.abs(spectrum) ** 2).sum(axis=1), _BAND // 2, mode="edge")
    return np.asarray(np.convolve(power, np.ones(_BAND) / _BAND, "valid"))


def _predicted(Q: Array, left: NDArray[np.complex128], first: NDArray[np.complex128], repetitions: int) -> Array:
    """Return the norm of the errors by repetition (d, repetitions), by equation (2)."""
    errors = np.broadcast_to(first, left.shape[:-1])  # (d, f, n)
    passed, kept = Q[:, None], (1 - Q)[:, None] * first
    found = [errors]
    for _ in range(repetitions - 1):
        found.append(passed * (left @ found[-1][..., None])[..., 0] + kept)
    return np.stack([np.sqrt((np.abs(e) ** 2).sum(axis=(-2, -1))) for e in found], axis=1)


def _spectrum(error: Array, frequency: Array, dt: float) -> tuple[NDArray[np.complex128], float]:
    """Return the spectrum (f, n) of errors (M, n), and the power of their white noise at every frequency."""
    still = error - error[-1]  # no jump at the end
    waves = np.exp(-2j * np.pi * dt * np.outer(frequency, np.arange(error.shape[0])))
    loud = np.abs(np.fft.rfft(np.diff(error, axis=0), axis=0)) ** 2
    f = np.linspace(0, 1, loud.shape[0])
    gains = 4 * np.sin(np.pi * f / 2) ** 2  # of the difference, |1 - e^{-iω dt}|²
    high = f > _LOUD
    noise = float(np.median(loud[high] / gains[high, None], axis=0).sum()) / np.log(2)
    return waves @ still, noise
