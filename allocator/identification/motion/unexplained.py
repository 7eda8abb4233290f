"""Effect on the parameters of what the model leaves unexplained.

    δp = s √(gᵀ (JᵀJ/n + s² D⁻²)⁻¹ g)      s: 0.7 of the structured residual [rad],  J = ∂θ̂/∂x,  g = ∂p/∂x

A residual that is noise averages out, and the jackknife counts it. A residual with structure is the effect of something
that the model does not have, part of which the fit has attributed to its own parameters. How much is not known: δp is
the greatest change of a parameter p that moves the prediction by no more than a share of the structured residual, with
no unknown moved beyond D. The share makes δp a standard deviation on joints of other laws, with gas and without
(`python -m benchmarks.motion_truth --strangers`).
"""

from collections.abc import Callable, Mapping

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.motion.problem import MotionProblem

_FINE, _COARSE = 1e-3, 1e-2  # of the usual size of a change: differences of predictions, and of parameters
_SHARE = 0.7  # of the structured residual
_MOST = 1.0  # usual sizes of a change: D


def structured(error: Array) -> float:
    """Return the RMS [rad] of the part of `error` (n,) that is not noise, which is new in every row."""
    return float(np.sqrt(max(float(np.mean(error[1:] * error[:-1])), 0.0)))


def possible_changes(
    problem: MotionProblem, x: Array, used: Mask, named: Callable[[Array], Mapping[str, float]]
) -> dict[str, float]:
    """Return by how much each of the parameters `named` may be off, by the residual over the rows `used` (n,)."""
    sizes, high = problem.sizes(), problem.bounds()[1]
    here, base = problem.run(x, used).theta[used], named(x)
    J = np.empty((here.size, x.size))
    g = {name: np.zeros(x.size) for name in base}
    for i, size in enumerate(sizes):
        way = 1.0 if x[i] + _COARSE * size <= high[i] else -1.0
        J[:, i] = (problem.run(_moved(x, i, way * _FINE * size), used).theta[used] - here) / (way * _FINE)
        for name, value in named(_moved(x, i, way * _COARSE * size)).items():
            if name in g:
                g[name][i] = (value - base[name]) / (way * _COARSE)
    s = _SHARE * structured(problem.log.theta[used] - here)
    bounded = np.vstack([J / np.sqrt(here.size), np.diag(s * sizes / np.maximum(_MOST * sizes, np.abs(x)))])
    _, values, rows = np.linalg.svd(bounded, full_matrices=False)
    return {name: float(s * np.linalg.norm((rows @ slope) / np.maximum(values, 1e-12))) for name, slope in g.items()}


def _moved(x: Array, i: int, by: float) -> Array:
    moved = x.copy()
    moved[i] += by
    return moved
