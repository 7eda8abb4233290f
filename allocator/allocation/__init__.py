"""`allocate` leads from torque and stiffness targets to pressures: the problem, its solvers, and the answer."""

from allocator.allocation.entry import allocate
from allocator.allocation.kernels.calls import warm_up
from allocator.allocation.method import Method
from allocator.allocation.problem import Problem
from allocator.allocation.result import Allocation
from allocator.allocation.status import Status

__all__ = ["Allocation", "Method", "Problem", "Status", "allocate", "warm_up"]
