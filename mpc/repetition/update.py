"""Update of a correction between two repetitions of a motion, and its design.

The controller tracks the reference θ* + c. After repetition j, with the error e_j = θ* - θ,

    c_{j+1} = Q [c_j + γ H_j e_j(t + δ)],      |Q(iω)| = 1/(1 + (ω/ω_c)⁴), zero phase                     (1)

and with the response T of the loop from the reference to the angle the errors are

    e_{j+1} = Q (I - γ H_j e^{iωδ} T) e_j + (1 - Q) e_0                                                   (2)

They fall monotonically if |Q| ‖I - γ e^{iωδ} T‖ < 1 at all frequencies (Bristow, Tharayil & Alleyne, A survey of
iterative learning control, IEEE Control Systems 26 (3), 2006), since 0 ≤ H ≤ 1 is real. Gain γ, lead δ and cut-off ω_c
minimise the error that (2) predicts for the worst response of a set, noise of the readings included, among those that
keep the left side below `MOST` for each response. The largest left side is the guaranteed rate.

Errors that do not return cannot be learned: with a gain of one, those of a repetition would be added to the next. Their
power N(ω) is estimated from the first rest, and later from repetitions: the part of an error that (2) does not explain
is n_{j+1} - n_j plus the error of the response. The spectrum of one repetition scatters, so Wiener's filter is used
with spectral over-subtraction (Berouti, Schwartz & Makhoul, ICASSP 1979). Its gain is

    H_j(ω) = max(0, 1 - α N/|E_j|²)                                                                       (3)

at each frequency: errors that return are learned at full speed, others not at all.

Q filters only the correction; filtering the whole reference would remove its own high frequencies.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from mpc.repetition.response import Response

MOST = 0.9  # bound of the guaranteed rate: errors fall by a tenth at least
GAINS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
LEADS = tuple(0.01 * i for i in range(-2, 15))  # [s]
CUTOFFS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0)  # [Hz]
OVER = 1.5  # α
_LOUD = 0.67  # of the highest frequency, above which errors are noise
_BAND = 11  # frequencies, over which powers are averaged


@dataclass(frozen=True)
class Update:
    """Gain, lead and low-pass of an update, with its guaranteed rate."""

    gain: float  # γ [-]
    lead: float  # δ [s]
    cutoff: float  # of Q, where it is one half [Hz]
    rate: float  # greatest ratio of errors per repetition, at all frequencies of all responses [-]
    predicted: tuple[float, ...]  # RMS error by repetition for the worst response, in units of the first [-]

    def applied(self, correction: Array, error: Array, dt: float) -> Array:
        """Return the next correction (M, n) [rad] from the present one and the errors (M, n) [rad] of every `dt`.

        By equation (1); `error` has already passed through H. The last error is held for all later times.
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


def designed(responses: Sequence[Response], error: Array, dt: float, repetitions: int) -> Update:
    """Return the update for a loop with one of these `responses`, from its first errors (M, n) [rad].

    Raises `InvalidInput` if no update is guaranteed to converge.
    """
    frequency = responses[0].frequency
    T = np.stack([one.T for one in responses])  # (d, f, n, n)
    first, white = _spectrum(error, frequency, dt)
    best: tuple[float, Update] | None = None
    for gain, lead in product(GAINS, LEADS):
        learned = gain * np.exp(2j * np.pi * frequency * lead)[:, None, None] * T  # γ e^{iωδ} T
        left = np.eye(T.shape[-1]) - learned
        norm = np.linalg.norm(left, 2, axis=(-2, -1))  # (d, f)
        for cutoff in CUTOFFS:
            Q = 1 / (1 + (frequency / cutoff) ** 4)
            rate = float((Q * norm).max())
            if rate > MOST:
                break  # and greater cut-offs as well
            rms = _predicted(Q, left, first, repetitions)
            spread = (Q * np.linalg.norm(learned, axis=(-2, -1))) ** 2 / (1 - (Q * norm) ** 2)
            heard = np.sqrt((white * spread).sum(axis=1))  # of the worst response
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


def returning(error: Array, response: Response, dt: float, noise: Array | float) -> Array:
    """Return H (f,) of errors (M, n) [rad] by (3); `noise` (f,) is the power of errors that do not return."""
    spectrum, white = _spectrum(error, response.frequency, dt)
    return np.maximum(1 - OVER * np.maximum(noise, white) / np.maximum(_banded(spectrum), 1e-300), 0.0)


def passed(error: Array, frequency: Array, H: Array, dt: float) -> Array:
    """Return errors (M, n) [rad] through a zero-phase filter of gain `H` (f,), continued at both ends."""
    size = len(error)
    padded = np.pad(error, ((size, size), (0, 0)), mode="edge")
    gains = np.interp(np.fft.rfftfreq(3 * size, dt), frequency, H)
    return np.asarray(np.fft.irfft(gains[:, None] * np.fft.rfft(padded, axis=0), 3 * size, axis=0)[size : 2 * size])


def rested(error: Array, response: Response, dt: float, count: int) -> Array:
    """Return the power (f,) of errors (M, n) [rad] of a rest, without their linear trend, scaled to `count` samples."""
    from scipy.signal import detrend

    power = _banded(_spectrum(detrend(error, axis=0), response.frequency, dt)[0])
    return np.asarray(power * count / len(error))


def unforeseen(response: Response, before: Array, error: Array, change: Array, dt: float) -> Array:
    """Return the power (f,) of errors (M, n) [rad] not explained by the previous ones and the change of correction.

    It is half the power of the remainder, since both repetitions contribute: an upper bound if the response is wrong.
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
