"""Allocation for muscles that are not affine in the pressure: nearly optimal pressures, with a proven gap.

Torques and stiffnesses are linear in the force F and own stiffness k of every muscle; only the curves (F(P), k(P)) of
the muscles are nonlinear (`model`). `descent` finds local optima. `curves` encloses the curves in polygons, over which
it finds a lower bound of the cost. `search` branches until both agree. Torques that come first have no gap, since
they do not depend on k; a target that is met has the bound 0.
"""

from allocator.allocation.relaxation.search import Nearby, furthest, solve

__all__ = ["Nearby", "furthest", "solve"]
