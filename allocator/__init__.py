"""Pressures of pneumatic-muscle joints and mechanisms for a torque and a stiffness.

>>> from allocator import BAR, allocate
>>> a = allocate(theta=0.5, K=7.5, T=1.0)  # rad, N·m/rad, N·m
>>> a.status.name, f"{a.P1 / BAR:.3f} bar, {a.P2 / BAR:.3f} bar"
('EXACT', '3.238 bar, 2.181 bar')

Named sub-packages have the rest of the public names: `allocator.allocation`, `allocator.feasibility`,
`allocator.identification`, `allocator.joint`, `allocator.mechanism`, `allocator.muscles`, `allocator.presentation`.
All names are imported on first use.
"""

from typing import TYPE_CHECKING

from allocator.errors import name_what_is_missing
from allocator.faces import face

if TYPE_CHECKING:
    from allocator.allocation import Allocation as Allocation
    from allocator.allocation import Method as Method
    from allocator.allocation import Status as Status
    from allocator.allocation import allocate as allocate
    from allocator.allocation import warm_up as warm_up
    from allocator.allocation.two_muscles.result import PairAllocation as PairAllocation
    from allocator.closed_form import inverse as inverse
    from allocator.errors import AntagonistError as AntagonistError
    from allocator.errors import CacheFault as CacheFault
    from allocator.errors import InvalidFile as InvalidFile
    from allocator.errors import InvalidInput as InvalidInput
    from allocator.errors import MissingBackend as MissingBackend
    from allocator.errors import MissingPackage as MissingPackage
    from allocator.feasibility import FeasibilityMap as FeasibilityMap
    from allocator.feasibility import angle_interval as angle_interval
    from allocator.feasibility import feasibility_map as feasibility_map
    from allocator.feasibility import plot_maps as plot_maps
    from allocator.feasibility import plot_pressures as plot_pressures
    from allocator.feasibility import stiffness_interval as stiffness_interval
    from allocator.feasibility import torque_interval as torque_interval
    from allocator.joint.antagonist import AntagonistJoint as AntagonistJoint
    from allocator.joint.antagonist import report_joint as report_joint
    from allocator.joint.gas import Gas as Gas
    from allocator.joint.gas import Stiffness as Stiffness
    from allocator.joint.geometry import Geometry as Geometry
    from allocator.joint.geometry import Lever as Lever
    from allocator.joint.geometry import Pulley as Pulley
    from allocator.joint.geometry import Table as Table
    from allocator.joint.gravity import Gravity as Gravity
    from allocator.joint.hysteresis import PrandtlIshlinskii as PrandtlIshlinskii
    from allocator.joint.limits import Limit as Limit
    from allocator.joint.limits import Limits as Limits
    from allocator.machine_file import load_machine as load_machine
    from allocator.machine_file import save_machine as save_machine
    from allocator.muscles import Muscle as Muscle
    from allocator.muscles.catalogue import named_muscle as named_muscle
    from allocator.units import BAR as BAR
    from allocator.units import DEG as DEG
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
    name_what_is_missing()
