"""An antagonistic joint has two muscles on a geometry, torque and stiffness, and limits of its pressures."""

from allocator.joint.antagonist import AntagonistJoint, report_joint

__all__ = ["AntagonistJoint", "report_joint"]
