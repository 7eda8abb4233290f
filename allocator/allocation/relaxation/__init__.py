"""Muscles that are not affine in the pressure: pressures near the best that there are, and a proof of how near.

Over force F and own stiffness k of every muscle torques and stiffnesses are linear, and what is not is a curve
(F(P), k(P)) a muscle (`model`). `descent` finds pressures that are optimal nearby; `curves` encloses the curves in
polygons, over which `bound` finds a cost that nothing can be below; `tree` branches until both are near each other.
Torques come first without a gap, since they do not depend on k; a target that is met needs no bound, 0 is one.
"""

from allocator.allocation.relaxation.search import Nearby, furthest, solve

__all__ = ["Nearby", "furthest", "solve"]
