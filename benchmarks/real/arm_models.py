"""Models of the arm's motion under one interface, fitted to episodes, run freely in windows.

hold      the angle stays where it is
ARX       q_{t+1} = A (q_t, q_{t-1}, q_{t-2}, p_t, p_{t-1}, p_{t-2}, 1), least squares of one step
MLP       q_{t+1} - q_t as a network of the same (scikit-learn's MLPRegressor, two layers of 64), standardised
grey box  `fit_arm`
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.episodes import Episode, Windows
from allocator.identification.arm.fit import fit_arm, folds
from benchmarks.real.arm_log import LAGS, windows_of

_LAYERS = (64, 64)
_MOST_TURN = np.pi  # [rad], beyond which a free run of a black box has left every arm
_COVERED = 0.95
_SEED = 7


class ArmModel(Protocol):
    """Free runs of all joints of an arm."""

    def __call__(self, windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        """Return angles and half widths of bands (w, h, m) [rad], of the windows and the rows (w, lags, …) before."""


Step = Callable[[Array], Array]


def hold(windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
    """Predict that every joint stays where it is."""
    return np.repeat(windows.q[:, 1:2], windows.horizon, axis=1), None


def lagged(episodes: Sequence[Episode]) -> tuple[Array, Array, Array]:
    """Return regressors (n, …), angles before and angles after (n, m) [rad] of one step."""
    rows, before, after = [], [], []
    for e in episodes:
        ends = range(LAGS, len(e.q))
        rows += [np.concatenate([e.q[t - LAGS : t].ravel(), e.p[t - LAGS : t].ravel()]) for t in ends]
        before.append(e.q[LAGS - 1 : -1])
        after.append(e.q[LAGS:])
    return np.array(rows), np.concatenate(before), np.concatenate(after)


def _free_run(step: Step, past: Array, past_p: Array, windows: Windows) -> Array:
    """Return angles (w, h, m) [rad] of a model of one step, from lagged rows (w, lags (m + k)) to angles (w, m)."""
    q, p = list(np.moveaxis(past, 1, 0)), np.concatenate([past_p, windows.p[:, 2:]], axis=1)
    w = len(past)
    for t in range(windows.horizon):
        row = np.concatenate([np.stack(q[-LAGS:], axis=1).reshape(w, -1), p[:, t : t + LAGS].reshape(w, -1)], axis=1)
        q.append(np.clip(step(row), -_MOST_TURN, _MOST_TURN))
    return np.stack(q[LAGS:], axis=1)


def _banded(fit: Callable[[Sequence[Episode]], Step], episodes: Sequence[Episode]) -> ArmModel:
    """Return a model of one step whose bands are quantiles, by step, of its errors in three cross-fits."""
    windows, past, past_p = windows_of(episodes)
    error = np.empty_like(windows.future)
    for out in folds(windows, 3):
        names = set(windows.episode[out].tolist())
        step = fit([e for e in episodes if e.name not in names])
        part = windows.only(out)
        error[out] = _free_run(step, past[out], past_p[out], part) - part.future
    widths = np.quantile(np.abs(error), _COVERED, axis=0)  # (h, m)
    whole = fit(episodes)

    def model(windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        predicted = _free_run(whole, past, past_p, windows)
        return predicted, np.broadcast_to(widths, predicted.shape)

    return model


def arx(episodes: Sequence[Episode]) -> ArmModel:
    """Fit the linear model."""

    def fit(episodes: Sequence[Episode]) -> Step:
        X, _, after = lagged(episodes)
        A = np.linalg.lstsq(np.append(X, np.ones((len(X), 1)), axis=1), after, rcond=None)[0]
        return lambda row: row @ A[:-1] + A[-1]

    return _banded(fit, episodes)


def mlp(episodes: Sequence[Episode]) -> ArmModel:
    """Fit the network."""
    from sklearn.neural_network import MLPRegressor

    def fit(episodes: Sequence[Episode]) -> Step:
        X, before, after = lagged(episodes)
        middle, size, usual = X.mean(axis=0), X.std(axis=0), (after - before).std(axis=0)
        network = MLPRegressor(
            hidden_layer_sizes=_LAYERS, early_stopping=True, alpha=1e-3, random_state=_SEED, max_iter=60
        )
        network.fit((X - middle) / size, (after - before) / usual)
        m = before.shape[1]
        last = slice((LAGS - 1) * m, LAGS * m)
        return lambda row: row[:, last] + usual * network.predict((row - middle) / size)

    return _banded(fit, episodes)


def grey_box(episodes: Sequence[Episode], progress: Callable[[str], object] | None = None) -> ArmModel:
    """Fit `fit_arm`, choosing the terms of every joint by left-out episodes of these."""
    fitted = fit_arm(episodes, progress=progress)

    def model(windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        return fitted.predict(windows)

    return model
