"""Antagonistic joints: two muscles on a geometry, their torque and stiffness, gas, hysteresis and limits."""

from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.felt import Loop, Secant
from allocator.joint.gas import thermal_corner
from allocator.joint.hysteresis import Slip

__all__ = ["AntagonistJoint", "Loop", "Secant", "Slip", "report_joint", "thermal_corner"]
