"""Task c: free runs of one real joint over 1, 5 and 30 s from its commanded pressures.

The first 60 % of the log are fitted. Free runs begin every 5 s in the rest; 10 s before, a model may see commands and
measured angles. `fit_motion` predicts from the commands alone; its error at the beginning of a run is taken off, fading
with a time constant that predicts the fitted rows best. ARX has three lags of the angle and of both commands. Runs
that begin within one length of a run are drawn together; with 88 s to judge there are three such groups at 30 s, too
few for an interval to mean much. The authors of `fit_motion` knew this log, its end included.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.identification.motion.fit import fit_motion
from allocator.identification.motion.samples import MotionLog, read_motion_log
from allocator.units import DEG
from benchmarks.real.scores import Score, best_in_bold

FILE = Path("joint_log_40hz.csv")
HORIZONS = 1.0, 5.0, 30.0  # [s]
_TRAINED = 0.6
_EVERY, _BEFORE = 5.0, 10.0  # [s]
_LAGS = 3
_FADING = np.geomspace(0.05, 20.0, 25)  # [s]
_COVERED = 0.95


class Runs(NamedTuple):
    """Free runs: angles and half widths of the bands (w, h) [rad]."""

    theta: Array
    half: Array


Model = Callable[[Array, int], Runs]  # of rows (w,) at which runs of so many rows begin


def starts(log: MotionLog, first: int, last: int, rows: int) -> Array:
    """Return the rows at which free runs of `rows` rows begin, between two rows of the log."""
    every, before = round(_EVERY / log.step), round(_BEFORE / log.step)
    return np.arange(max(first, before), last - rows, every)


def measured(log: MotionLog, at: Array, rows: int) -> Array:
    """Return what was measured (w, h) [rad]."""
    return np.asarray(log.theta[at[:, None] + 1 + np.arange(rows)])


def hold(log: MotionLog, trained: int) -> Model:
    """Predict that the joint stays."""
    return lambda at, rows: _with_bands(
        log, trained, at, rows, lambda at, rows: np.repeat(log.theta[at][:, None], rows, 1)
    )


def arx(log: MotionLog, trained: int) -> Model:
    """Fit one step by least squares; the bands are quantiles of free runs of the fitted rows."""

    def row(theta: Array, at: Array) -> Array:
        pressures = [P[at - lag] / 1e5 for P in (log.P1, log.P2) for lag in range(_LAGS)]
        return np.stack([*theta, *pressures, np.ones(at.size)], axis=1)

    k = np.arange(_LAGS - 1, trained - 1)
    c = np.linalg.lstsq(row(np.array([log.theta[k - lag] for lag in range(_LAGS)]), k), log.theta[k + 1], rcond=None)[0]

    def run(at: Array, rows: int) -> Array:
        theta = np.array([log.theta[at - lag] for lag in range(_LAGS)])
        out = np.empty((at.size, rows))
        for t in range(rows):
            out[:, t] = row(theta, at + t) @ c
            theta = np.concatenate([out[None, :, t], theta[:-1]])
        return out

    return lambda at, rows: _with_bands(log, trained, at, rows, run)


def _with_bands(log: MotionLog, trained: int, at: Array, rows: int, run: Callable[[Array, int], Array]) -> Runs:
    known = starts(log, 0, trained, rows)
    widths = np.quantile(np.abs(run(known, rows) - measured(log, known, rows)), _COVERED, axis=0)
    theta = run(at, rows)
    return Runs(theta, np.broadcast_to(widths, theta.shape))


def ours(log: MotionLog, trained: int) -> Model:
    """Fit the motion; the bands are those that the fit states, and of the run without feedback."""
    fit = fit_motion(log.t[:trained], log.theta[:trained], log.P1[:trained], log.P2[:trained])
    band = fit.band(log.t, log.P1, log.P2)
    error = log.theta - band.theta

    def run(at: Array, rows: int, fading: float) -> Array:
        ahead = at[:, None] + 1 + np.arange(rows)
        return np.asarray(
            band.theta[ahead] + error[at][:, None] * np.exp(-(log.t[ahead] - log.t[at][:, None]) / fading)
        )

    rows = round(HORIZONS[1] / log.step)
    known = starts(log, 0, trained, rows)
    best = min(_FADING, key=lambda tau: float(np.mean((run(known, rows, tau) - measured(log, known, rows)) ** 2)))
    half = (band.high - band.low) / 2

    def model(at: Array, rows: int) -> Runs:
        return Runs(run(at, rows, best), half[at[:, None] + 1 + np.arange(rows)])

    return model


MODELS = {"hold": hold, "ARX": arx, "fit_motion": ours}


def table(path: Path) -> list[str]:
    """Return the scores as lines of Markdown."""
    log = read_motion_log(path)
    log = MotionLog.checked(log.t, log.theta, log.P1, log.P2, medians=False)
    trained = int(_TRAINED * log.n)
    lines = [
        "RMS error [°] with 95 % interval over free runs; NRMSE; coverage and mean half width of the 95 % bands.",
        "",
    ]
    lines += [f"| model | {' | '.join(f'{s:g} s' for s in HORIZONS)} |", f"|---{'|---' * len(HORIZONS)}|"]
    found = []
    for name, make in MODELS.items():
        model = make(log, trained)
        found.append((name, [_score(log, model, trained, round(seconds / log.step)) for seconds in HORIZONS]))
    rows = [(name, [_cell(score) for score in scores]) for name, scores in found]
    return lines + best_in_bold(rows, [[score.rms for score in scores] for _, scores in found])


def _score(log: MotionLog, model: Model, trained: int, rows: int) -> Score:
    at = starts(log, trained, log.n, rows)
    runs = model(at, rows)
    return Score.of(runs.theta / DEG, runs.half / DEG, measured(log, at, rows) / DEG, at // rows)


def _cell(s: Score) -> str:
    low, high = s.rms_interval
    return f"{s.rms:.2f} ({low:.1f}–{high:.1f}); {s.nrmse:.2f}; {100 * s.coverage:.0f} %, ±{s.sharpness:.1f}"
