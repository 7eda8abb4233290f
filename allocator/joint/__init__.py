"""The antagonistic joint: two muscles on a geometry, its torque and stiffness, and the limits of its pressures."""

from allocator.joint.antagonist import AntagonistJoint, report_joint

__all__ = ["AntagonistJoint", "report_joint"]
