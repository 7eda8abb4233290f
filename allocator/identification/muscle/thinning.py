"""A raw force log is put together into few samples.

A log of more than 2000 rows is averaged over cells of 1/64 of its range of contractions × 1/32 of its range of
pressures, loading and unloading together. A cell is one sample: the means of contraction, pressure and force, weighted
by its rows, at most as the median cell (a log that rests somewhere tells no more about the muscle by that).
Neighbouring rows are correlated, hence a cell counts as one reading however many rows it has; by how much the rows
scatter within it, beyond the slope of the force there, is kept for the variance of the parameters.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.identification.muscle.samples import Samples

MOST_ROWS = 2000
_CELLS = (64, 32)  # of contraction, of pressure


def thinned(samples: Samples) -> Samples:
    """Return the means over cells where there are more than 2000 rows; a note says so."""
    if samples.n <= MOST_ROWS:
        return samples
    rows = samples.where(samples.weights > 0)
    places = [_part(q, n) for q, n in zip((rows.contraction, rows.pressure), _CELLS, strict=True)]
    _, cell = np.unique(places[0] * _CELLS[1] + places[1], return_inverse=True)
    total = np.bincount(cell, rows.weights)
    weight = rows.weights / total[cell]

    def mean(q: Array) -> Array:
        return np.asarray(np.bincount(cell, weight * q), float)

    quantities = (rows.contraction, rows.pressure, rows.force)
    means = [mean(q) for q in quantities]
    apart = [(q - m[cell]) / max(np.ptp(q), 1e-300) for q, m in zip(quantities, means, strict=True)]
    moments = np.stack([np.stack([mean(a * b) for b in apart], axis=-1) for a in apart], axis=-1)  # (cells, 3, 3)
    cells = replace(
        rows,
        contraction=means[0],
        pressure=means[1],
        force=means[2],
        weights=np.minimum(total / np.median(total), 1.0),
        scatter=np.ptp(rows.force) * _scatter(moments),
        direction=None,  # both branches are in a cell
    )
    return cells.noted(
        f"{samples.n} rows became {total.size} samples, means over cells of contraction and pressure (loading and "
        "unloading averaged), each counted as one reading"
    )


def _part(q: Array, parts: int) -> NDArray[np.intp]:
    """Return which of the equal parts of its range each number is in."""
    width = max(float(np.ptp(q)), 1e-300)
    return np.asarray(np.minimum((q - q.min()) / width * parts, parts - 1), np.intp)


def _scatter(moments: Array) -> Array:
    """Return the standard deviation (cells,) of the last quantity about its plane over the others, from second
    moments.
    """
    C, c = moments[:, :2, :2], moments[:, :2, 2]  # among the first two, and of them with the last
    explained = np.einsum("ki,kij,kj->k", c, np.linalg.pinv(C, rcond=1e-9, hermitian=True), c)
    return np.asarray(np.sqrt(np.maximum(moments[:, 2, 2] - explained, 0.0)))
