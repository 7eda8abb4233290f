"""Mechanisms of n joints and m muscles: routes, torques and stiffness matrix, a hand, ready-made machines.

>>> import numpy as np
>>> from allocator import allocate
>>> from allocator.mechanism import machines
>>> a = allocate([0.4, -0.3], K=[[10, 4], [4, 9]], T=[9, 4], joint=machines.arm26())  # rad, N·m/rad, N·m
>>> a.status.name, np.round(a.P / 1e5, 3)
('EXACT', array([3.295, 1.481, 2.95 , 3.289, 3.548, 1.988]))
"""

from allocator.mechanism import machines
from allocator.mechanism.endpoint import Endpoint
from allocator.mechanism.mechanism import Mechanism, TargetsMap
from allocator.mechanism.routes import Link, Pulleys, Routes, Site, Sites, Tables, from_function

__all__ = [
    "Endpoint",
    "Link",
    "Mechanism",
    "Pulleys",
    "Routes",
    "Site",
    "Sites",
    "Tables",
    "TargetsMap",
    "from_function",
    "machines",
]
