"""Routes of muscles over joints: lengths over the posture, with first and second derivatives."""

from allocator.mechanism.routes.base import RoutedLengths, Routes
from allocator.mechanism.routes.functions import FunctionRoutes, Tables, from_function
from allocator.mechanism.routes.linkage import Link, Linkage, Site
from allocator.mechanism.routes.pulleys import JointRoutes, Pulleys
from allocator.mechanism.routes.sites import Sites

FILED = {kind.__name__: kind for kind in (Pulleys, Sites, Tables)}
"""Routes that machines' files may have, by the names of their kinds."""

__all__ = [
    "FILED",
    "FunctionRoutes",
    "JointRoutes",
    "Link",
    "Linkage",
    "Pulleys",
    "RoutedLengths",
    "Routes",
    "Site",
    "Sites",
    "Tables",
    "from_function",
]
