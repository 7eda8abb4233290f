"""Complete search of all pairs of pressures and all optima of two muscles at an angle, for any law and geometry.

`rows` turns muscles into numbers, `curves` cuts their curves into pieces, `pairs` finds all roots and the nearest
points stretch by stretch (`stretches`), `arcs` the weighted optimum; `loops` does it for arrays, compiled or as plain
Python, and `batch` is what the rest of the library calls.
"""

from allocator.search.batch import Curves, all_pairs, determinant_signs, optima, prepare, ready, torque_intervals

__all__ = ["Curves", "all_pairs", "determinant_signs", "optima", "prepare", "ready", "torque_intervals"]
