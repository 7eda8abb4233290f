"""Arms: mechanisms with bodies and regulators, their plants on MuJoCo, pictures and films."""

from typing import TYPE_CHECKING

from allocator.faces import face

if TYPE_CHECKING:
    from allocator.mechanism.bodies import Bodies as Bodies
    from allocator.mechanism.bodies import arm26_bodies as arm26_bodies
    from mpc.arm.mjcf import to_mjcf as to_mjcf
    from mpc.arm.mujoco_plant import MujocoPlant as MujocoPlant
    from mpc.arm.picture import Camera as Camera
    from mpc.arm.rig import Readings as Readings
    from mpc.model.arm.model import Arm as Arm
    from mpc.model.arm.pneumatics import Pneumatics as Pneumatics
    from mpc.model.arm.reading import read_arm as read_arm
    from mpc.model.arm.storage import load_arm as load_arm
    from mpc.model.arm.storage import save_arm as save_arm
    from mpc.model.real import RealArm as RealArm
else:
    __all__, __getattr__, __dir__ = face(__name__, __file__)
