"""Pressures of pneumatic-muscle joints and mechanisms for a torque and a stiffness.

>>> from allocator import allocate
>>> a = allocate(theta=0.5, K=7.5, T=1.0)  # rad, N·m/rad, N·m
>>> a.status.name, f"{a.P1 / BAR:.3f} bar, {a.P2 / BAR:.3f} bar"
('EXACT', '3.238 bar, 2.181 bar')

Named sub-packages have the rest of the public names: `allocator.allocation`, `allocator.feasibility`,
`allocator.identification`, `allocator.joint`, `allocator.mechanism`, `allocator.muscles`, `allocator.presentation`.
"""

from allocator.allocation import Allocation, Method, Status, allocate, warm_up
from allocator.allocation.two_muscles.result import PairAllocation
from allocator.errors import AntagonistError, CacheFault, InvalidFile, InvalidInput, MissingBackend, MissingPackage
from allocator.errors import name_what_is_missing as _name_what_is_missing
from allocator.feasibility import (
    FeasibilityMap,
    angle_interval,
    feasibility_map,
    plot_maps,
    plot_pressures,
    stiffness_interval,
    torque_interval,
)
from allocator.inverse import inverse
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.gas import Gas, Stiffness
from allocator.joint.geometry import Geometry, Lever, Pulley, Table
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.joint.limits import Limit, Limits
from allocator.machine_file import load_machine, save_machine
from allocator.muscles import Muscle
from allocator.muscles.catalogue import named_muscle
from allocator.units import BAR, DEG

_name_what_is_missing()

__all__ = [
    "BAR",
    "DEG",
    "Allocation",
    "AntagonistError",
    "AntagonistJoint",
    "CacheFault",
    "FeasibilityMap",
    "Gas",
    "Geometry",
    "InvalidFile",
    "InvalidInput",
    "Lever",
    "Limit",
    "Limits",
    "Method",
    "MissingBackend",
    "MissingPackage",
    "Muscle",
    "PairAllocation",
    "PrandtlIshlinskii",
    "Pulley",
    "Status",
    "Stiffness",
    "Table",
    "allocate",
    "angle_interval",
    "feasibility_map",
    "inverse",
    "load_machine",
    "named_muscle",
    "plot_maps",
    "plot_pressures",
    "report_joint",
    "save_machine",
    "stiffness_interval",
    "torque_interval",
    "warm_up",
]


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
