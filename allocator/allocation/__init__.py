"""Allocation of pressures for torque and stiffness targets: the problem, its solvers, and the answer.

`allocate` (`entry.py`) solves for a joint by `two_muscles/`, for a mechanism by `box/` or, if its muscles are not
affine in the pressure, by `relaxation/`.
"""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.allocation.arguments import Method as Method
    from allocator.allocation.at_least import AtLeast as AtLeast
    from allocator.allocation.at_least import Infeasibility as Infeasibility
    from allocator.allocation.at_least import allocate_at_least as allocate_at_least
    from allocator.allocation.box.certificate import Separation as Separation
    from allocator.allocation.box.result import BoxAllocation as BoxAllocation
    from allocator.allocation.entry import allocate as allocate
    from allocator.allocation.entry import warm_up as warm_up
    from allocator.allocation.result import Allocation as Allocation
    from allocator.allocation.status import Status as Status
    from allocator.allocation.two_muscles.problem import Problem as Problem
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
