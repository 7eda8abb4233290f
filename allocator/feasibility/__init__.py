"""Feasible angles, torques and stiffnesses of joints and mechanisms, their limits, and design sweeps."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.feasibility.edges import Edge as Edge
    from allocator.feasibility.intervals import angle_interval as angle_interval
    from allocator.feasibility.intervals import angle_intervals as angle_intervals
    from allocator.feasibility.intervals import stiffness_interval as stiffness_interval
    from allocator.feasibility.intervals import torque_interval as torque_interval
    from allocator.feasibility.intervals import torque_intervals as torque_intervals
    from allocator.feasibility.maps import feasibility_map as feasibility_map
    from allocator.feasibility.pictures import plot_arm as plot_arm
    from allocator.feasibility.pictures import plot_polygon as plot_polygon
    from allocator.feasibility.pictures import plot_workspace as plot_workspace
    from allocator.feasibility.plotting import plot_maps as plot_maps
    from allocator.feasibility.plotting import plot_pressures as plot_pressures
    from allocator.feasibility.polygon import Polygon as Polygon
    from allocator.feasibility.result import FeasibilityMap as FeasibilityMap
    from allocator.feasibility.sweep import Design as Design
    from allocator.feasibility.sweep import Performance as Performance
    from allocator.feasibility.sweep import Sweep as Sweep
    from allocator.feasibility.sweep import design_grid as design_grid
    from allocator.feasibility.sweep import design_sweep as design_sweep
    from allocator.feasibility.sweep import performance as performance
    from allocator.feasibility.targets import EndpointEllipses as EndpointEllipses
    from allocator.feasibility.targets import FeasibleTargets as FeasibleTargets
    from allocator.feasibility.targets import endpoint_ellipses as endpoint_ellipses
    from allocator.feasibility.targets import feasible_targets as feasible_targets
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
