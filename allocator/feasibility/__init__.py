"""Feasibility is what the joint can do: which angles, stiffnesses and torques exist, what ends them, for any design."""

from allocator.feasibility.design import Design, Performance, design_grid, performance
from allocator.feasibility.edges import Edge
from allocator.feasibility.intervals import (
    angle_interval,
    angle_intervals,
    stiffness_interval,
    torque_interval,
    torque_intervals,
)
from allocator.feasibility.maps import feasibility_map
from allocator.feasibility.plotting import plot_maps, plot_pressures
from allocator.feasibility.result import FeasibilityMap
from allocator.feasibility.sweep import Sweep, design_sweep

__all__ = [
    "Design",
    "Edge",
    "FeasibilityMap",
    "Performance",
    "Sweep",
    "angle_interval",
    "angle_intervals",
    "design_grid",
    "design_sweep",
    "feasibility_map",
    "performance",
    "plot_maps",
    "plot_pressures",
    "stiffness_interval",
    "torque_interval",
    "torque_intervals",
]
