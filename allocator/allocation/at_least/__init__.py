"""At least a stiffness is given here with the least pressures: a semidefinite programme, proved both ways."""

from allocator.allocation.at_least.entry import allocate_at_least
from allocator.allocation.at_least.result import AtLeast, Infeasibility

__all__ = ["AtLeast", "Infeasibility", "allocate_at_least"]
