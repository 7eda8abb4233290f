"""Feasible angles, torques and stiffnesses of joints and mechanisms, their limits, and design sweeps."""

from allocator.feasibility.edges import Edge
from allocator.feasibility.intervals import (
    angle_interval,
    angle_intervals,
    stiffness_interval,
    torque_interval,
    torque_intervals,
)
from allocator.feasibility.maps import feasibility_map
from allocator.feasibility.pictures import plot_arm, plot_polygon, plot_workspace
from allocator.feasibility.plotting import plot_maps, plot_pressures
from allocator.feasibility.polygon import Polygon
from allocator.feasibility.result import FeasibilityMap
from allocator.feasibility.sweep import Design, Performance, Sweep, design_grid, design_sweep, performance
from allocator.feasibility.targets import EndpointEllipses, FeasibleTargets, endpoint_ellipses, feasible_targets

__all__ = [
    "Design",
    "Edge",
    "EndpointEllipses",
    "FeasibilityMap",
    "FeasibleTargets",
    "Performance",
    "Polygon",
    "Sweep",
    "angle_interval",
    "angle_intervals",
    "design_grid",
    "design_sweep",
    "endpoint_ellipses",
    "feasibility_map",
    "feasible_targets",
    "performance",
    "plot_arm",
    "plot_maps",
    "plot_polygon",
    "plot_pressures",
    "plot_workspace",
    "stiffness_interval",
    "torque_interval",
    "torque_intervals",
]
