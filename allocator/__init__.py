"""Pressures of pneumatic-muscle joints and mechanisms for a torque and a stiffness.

>>> from allocator import allocate
>>> a = allocate(theta=0.5, K=7.5, T=1.0)  # rad, N·m/rad, N·m
>>> a.status.name, f"{a.P1 / BAR:.3f} bar, {a.P2 / BAR:.3f} bar"
('EXACT', '3.238 bar, 2.181 bar')

Identification is imported on first use; allocation does not need it.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING

from allocator.allocation import Allocation, Method, Status, allocate, warm_up
from allocator.errors import AntagonistError, CacheFault, InvalidFile, InvalidInput, MissingBackend, MissingPackage
from allocator.errors import name_what_is_missing as _name_what_is_missing
from allocator.feasibility import (
    Design,
    FeasibilityMap,
    angle_interval,
    angle_intervals,
    design_grid,
    design_sweep,
    feasibility_map,
    plot_maps,
    plot_pressures,
    stiffness_interval,
    torque_interval,
    torque_intervals,
)
from allocator.inverse import inverse
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.gas import Gas, Stiffness
from allocator.joint.geometry import Geometry, Lever, Pulley, Table
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.joint.limits import Limit, Limits
from allocator.machine_file import load_joint, load_machine, named_machine, save_machine
from allocator.muscles import MODELS, AffineMuscle, Muscle
from allocator.muscles.catalogue import named_muscle
from allocator.units import BAR, DEG

_name_what_is_missing()

if TYPE_CHECKING:
    from allocator.identification import (
        Fit,
        GasFit,
        JointFit,
        MotionFit,
        compare_joint_models,
        fit,
        fit_gas,
        fit_joint,
        fit_motion,
        load_dataset,
        plan_joint_experiment,
        rank_models,
        read_samples,
    )
else:
    _IDENTIFICATION = frozenset(
        {
            "Fit",
            "GasFit",
            "JointFit",
            "MotionFit",
            "compare_joint_models",
            "fit",
            "fit_gas",
            "fit_joint",
            "fit_motion",
            "load_dataset",
            "plan_joint_experiment",
            "rank_models",
            "read_samples",
        }
    )

    def __getattr__(name):
        """Return the public name `name` of `allocator.identification`."""
        if name not in _IDENTIFICATION:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        return getattr(_import_module("allocator.identification"), name)

    def __dir__():
        """Return the public names too."""
        return sorted({*globals(), *_IDENTIFICATION})


__all__ = [
    "BAR",
    "DEG",
    "MODELS",
    "AffineMuscle",
    "Allocation",
    "AntagonistError",
    "AntagonistJoint",
    "CacheFault",
    "Design",
    "FeasibilityMap",
    "Fit",
    "Gas",
    "GasFit",
    "Geometry",
    "InvalidFile",
    "InvalidInput",
    "JointFit",
    "Lever",
    "Limit",
    "Limits",
    "Method",
    "MissingBackend",
    "MissingPackage",
    "MotionFit",
    "Muscle",
    "PrandtlIshlinskii",
    "Pulley",
    "Status",
    "Stiffness",
    "Table",
    "allocate",
    "angle_interval",
    "angle_intervals",
    "compare_joint_models",
    "design_grid",
    "design_sweep",
    "feasibility_map",
    "fit",
    "fit_gas",
    "fit_joint",
    "fit_motion",
    "inverse",
    "load_dataset",
    "load_joint",
    "load_machine",
    "named_machine",
    "named_muscle",
    "plan_joint_experiment",
    "plot_maps",
    "plot_pressures",
    "rank_models",
    "read_samples",
    "report_joint",
    "save_machine",
    "stiffness_interval",
    "torque_interval",
    "torque_intervals",
    "warm_up",
]
