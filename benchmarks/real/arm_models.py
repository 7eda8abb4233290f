"""Models of the arm's motion under one interface, fitted to episodes, run freely in windows.

hold      the angle stays where it is
ARX       q_{t+1} = A (q_t, q_{t-1}, q_{t-2}, p_t, p_{t-1}, p_{t-2}, 1), least squares of one step
MLP       q_{t+1} - q_t as a network of the same (scikit-learn's MLPRegressor, two layers of 64), standardised
grey box  `fit_arm`
stack     the weighted mean of these, by the errors of left-out episodes
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple, Protocol

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.episodes import Episode, Windows
from allocator.identification.arm.fit import Bands, fit_arm, folds
from benchmarks.real.arm_log import LAGS, windows_of

_LAYERS = (64, 64)
_MOST_TURN = np.pi  # [rad], beyond which a free run of a black box has left every arm
_COVERED = 0.95
_SEED = 7
_SUM = 1e3  # weight of the condition that weights sum to 1


class Prediction(Protocol):
    """Free runs of all joints of an arm."""

    def __call__(self, windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        """Return angles and half widths of bands (w, h, m) [rad], of the windows and the rows (w, lags, …) before."""


class ArmModel(NamedTuple):
    """A fitted model."""

    predict: Prediction
    left_out: Array | None = None  # free runs (w, h, m) [rad] of the fitted windows, each by a fit without its episode


Step = Callable[[Array], Array]


def hold(episodes: Sequence[Episode]) -> ArmModel:
    """Predict that every joint stays where it is."""
    return ArmModel(lambda windows, past, past_p: (np.repeat(windows.q[:, 1:2], windows.horizon, axis=1), None))


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
    left_out = np.empty_like(windows.future)
    for out in folds(windows, 3):
        names = set(windows.episode[out].tolist())
        step = fit([e for e in episodes if e.name not in names])
        left_out[out] = _free_run(step, past[out], past_p[out], windows.only(out))
    widths = np.quantile(np.abs(left_out - windows.future), _COVERED, axis=0)  # (h, m)
    whole = fit(episodes)

    def predict(windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        predicted = _free_run(whole, past, past_p, windows)
        return predicted, np.broadcast_to(widths, predicted.shape)

    return ArmModel(predict, left_out)


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
    return ArmModel(lambda windows, past, past_p: fitted.predict(windows), fitted.left_out)


def stack(models: Sequence[ArmModel], episodes: Sequence[Episode]) -> ArmModel:
    """Return the weighted mean of models fitted to these episodes; the weights of each joint are ≥ 0 and sum to 1."""
    windows = windows_of(episodes)[0]
    known = np.stack([model.left_out for model in models if model.left_out is not None])  # (models, w, h, m)
    weights = np.stack([_weights(known[..., j] - windows.future[..., j]) for j in range(known.shape[-1])], axis=1)
    left_out = np.einsum("kj,kwhj->whj", weights, known)
    bands = Bands.of(left_out, windows.q[:, 1], left_out - windows.future)

    def predict(windows: Windows, past: Array, past_p: Array) -> tuple[Array, Array | None]:
        runs = [model.predict(windows, past, past_p)[0] for model in models if model.left_out is not None]
        mean = np.einsum("kj,kwhj->whj", weights, np.stack(runs))
        return mean, bands.around(mean, windows.q[:, 1])

    return ArmModel(predict, left_out)


def _weights(error: Array) -> Array:
    """Return the weights (models,) of least squared error of the weighted errors (models, …)."""
    from scipy.optimize import nnls

    rows = error.reshape(len(error), -1)
    heavy = _SUM * float(np.abs(rows).max()) * np.sqrt(rows.shape[1])
    found, _ = nnls(np.vstack([rows.T, np.full(len(error), heavy)]), np.append(np.zeros(rows.shape[1]), heavy))
    return np.asarray(found / found.sum())
