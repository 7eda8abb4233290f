"""Allocation of pressures for torque and stiffness targets: the problem, its solvers, and the answer.

`allocate` (`entry.py`) solves for a joint by `two_muscles/`, for a mechanism by `box/` or, if its muscles are not
affine in the pressure, by `relaxation/`.
"""

from allocator.allocation.arguments import Method
from allocator.allocation.at_least import AtLeast, Infeasibility, allocate_at_least
from allocator.allocation.box.certificate import Separation
from allocator.allocation.box.result import BoxAllocation
from allocator.allocation.entry import allocate, warm_up
from allocator.allocation.result import Allocation
from allocator.allocation.status import Status
from allocator.allocation.two_muscles.problem import Problem

__all__ = [
    "Allocation",
    "AtLeast",
    "BoxAllocation",
    "Infeasibility",
    "Method",
    "Problem",
    "Separation",
    "Status",
    "allocate",
    "allocate_at_least",
    "warm_up",
]
