"""Least pressures for at least a stiffness: a semidefinite programme, with proofs of both outcomes."""

from allocator.allocation.at_least.entry import AtLeast, Infeasibility, allocate_at_least

__all__ = ["AtLeast", "Infeasibility", "allocate_at_least"]
