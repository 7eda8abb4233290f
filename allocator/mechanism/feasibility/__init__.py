"""Feasibility is what a mechanism can do at a posture: which torques and stiffnesses exist, and what ends them."""

from allocator.mechanism.feasibility.ellipses import EndpointEllipses, endpoint_ellipses
from allocator.mechanism.feasibility.polygon import Edge, Polygon
from allocator.mechanism.feasibility.targets import FeasibleTargets, feasible_targets

__all__ = ["Edge", "EndpointEllipses", "FeasibleTargets", "Polygon", "endpoint_ellipses", "feasible_targets"]
