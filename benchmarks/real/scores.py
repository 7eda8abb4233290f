"""Scores of predictions with bands, by episode, with bootstrap intervals."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array

_DRAWS = 1000
_SEED = 3


class Score(NamedTuple):
    """Errors of predictions in the unit of the quantity; intervals are 95 % of bootstrap draws of whole episodes."""

    rms: float
    rms_interval: tuple[float, float]
    median: float  # over episodes, of the RMS errors of each
    nrmse: float  # RMS over the standard deviation of what was measured
    coverage: float  # share of the measurements within the stated 95 % bands; NaN without bands
    sharpness: float  # mean half width of the bands

    @classmethod
    def of(cls, predicted: Array, half: Array | None, measured: Array, episode: Array) -> "Score":
        """Return the score of predictions (w, …) with half widths (w, …) of measurements (w, …) in episodes (w,)."""
        error = predicted - measured
        mean_square = np.mean(error.reshape(len(error), -1) ** 2, axis=1)
        inside = np.nan if half is None else float(np.mean(np.abs(error) <= half))
        rms = float(np.sqrt(mean_square.mean()))
        wide = np.nan if half is None else float(np.mean(half))
        interval = bootstrap(mean_square, episode, lambda squares: float(np.sqrt(squares.mean())))
        each = [np.sqrt(mean_square[episode == one].mean()) for one in np.unique(episode)]
        return cls(rms, interval, float(np.median(each)), rms / float(np.std(measured)), inside, wide)


def best_in_bold(rows: Sequence[tuple[str, Sequence[str]]], errors: Sequence[Sequence[float]]) -> list[str]:
    """Return lines of Markdown of named rows of cells, the cell of the least error (rows, columns) of a column bold."""
    table = np.array(errors, float)
    best = np.nanargmin(table, axis=0)
    return [
        f"| {name} | {' | '.join(f'**{cell}**' if best[j] == i else cell for j, cell in enumerate(cells))} |"
        for i, (name, cells) in enumerate(rows)
    ]


def bootstrap(values: Array, episode: Array, statistic: Callable[[Array], float]) -> tuple[float, float]:
    """Return the 95 % interval of a statistic of values (w,), of which whole episodes (w,) are drawn again."""
    rng = np.random.default_rng(_SEED)
    groups = [values[episode == name] for name in dict.fromkeys(episode.tolist())]
    draws = [
        statistic(np.concatenate([groups[i] for i in rng.integers(len(groups), size=len(groups))]))
        for _ in range(_DRAWS)
    ]
    low, high = np.quantile(draws, (0.025, 0.975))
    return float(low), float(high)
