"""Mechanisms of n joints and m muscles, and the allocation of their pressures.

>>> import numpy as np
>>> from allocator import allocate
>>> from allocator.mechanism import machines
>>> a = allocate([0.4, -0.3], K=[[10, 4], [4, 9]], T=[9, 4], joint=machines.arm26())  # rad, N·m/rad, N·m
>>> a.status.name, np.round(a.P / 1e5, 3)
('EXACT', array([3.295, 1.481, 2.95 , 3.289, 3.548, 1.988]))
"""

import allocator.mechanism.entry  # noqa: F401  # registers how mechanisms are allocated
from allocator.mechanism import machines
from allocator.mechanism.at_least import AtLeast, Infeasibility, allocate_at_least
from allocator.mechanism.batches import warm_up
from allocator.mechanism.certificate import Separation
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.feasibility import (
    Edge,
    EndpointEllipses,
    FeasibleTargets,
    Polygon,
    endpoint_ellipses,
    feasible_targets,
)
from allocator.mechanism.mechanism import Mechanism, TargetsMap
from allocator.mechanism.pictures import plot_arm, plot_polygon, plot_workspace
from allocator.mechanism.result import BoxAllocation
from allocator.mechanism.routes import Link, Pulleys, Routes, Site, Sites, Tables, from_function

__all__ = [
    "AtLeast",
    "BoxAllocation",
    "Edge",
    "Endpoint",
    "EndpointEllipses",
    "FeasibleTargets",
    "Infeasibility",
    "Link",
    "Mechanism",
    "Polygon",
    "Pulleys",
    "Routes",
    "Separation",
    "Site",
    "Sites",
    "Tables",
    "TargetsMap",
    "allocate_at_least",
    "endpoint_ellipses",
    "feasible_targets",
    "from_function",
    "machines",
    "plot_arm",
    "plot_polygon",
    "plot_workspace",
    "warm_up",
]
