"""An arm that was read from a MuJoCo model is moved, learned and drawn by that model."""

import numpy as np
import pytest

from allocator import InvalidInput, named_muscle
from allocator.units import BAR
from mpc import Arm
from mpc.arm import MujocoPlant, to_mjcf
from mpc.arm.learning.mujoco_batch import plant_of
from mpc.arm.learning.plant import VariedArm
from mpc.learning import Reaching

from .test_cli import ARM, ROUND, STRAIGHT

FIXED = """<mujoco><worldbody><body><joint name="elbow" axis="0 0 1" damping=".2" range="-45 45"/>
<geom type="capsule" fromto="0 0 0 .25 0 0" size=".01" mass=".5"/></body></worldbody>
<tendon><fixed name="flexor"><joint joint="elbow" coef="-.02"/></fixed>
<fixed name="extensor"><joint joint="elbow" coef=".02"/></fixed></tendon></mujoco>"""


@pytest.mark.parametrize("text", [ARM.format(**STRAIGHT), ARM.format(**ROUND), FIXED], ids=["sites", "round", "fixed"])
def test_the_plant_of_an_arm_has_its_lengths_arms_and_torques(text):
    arm = Arm.from_mjcf(text, named_muscle("sarosi-dmsp-20-200n"), 0.3, contraction=0.14)
    rig, q, P = MujocoPlant.of(arm), np.array([0.2]), np.array([3.0, 2.0]) * BAR
    rig.reset(q, P)
    routed = arm.mechanism.routes.at(q)
    assert rig.lengths == pytest.approx(routed.length)
    assert rig.arms == pytest.approx(routed.arm)
    assert rig.torque == pytest.approx(arm.mechanism.torque(q, P))
    assert rig.nominal is arm


def test_learners_move_and_draw_the_model_itself():
    arm = Arm.from_mjcf(ARM.format(**STRAIGHT), named_muscle("sarosi-dmsp-20-200n"), 0.3, contraction=0.14)
    plant = plant_of(VariedArm(arm))
    assert plant.muscle_names == ("flexor", "extensor")
    assert plant.model.site("tip").id >= 0


def test_degrees_and_other_types_are_named():
    rig = MujocoPlant.of(Arm.machine("arm26"))
    with pytest.raises(InvalidInput, match=r"q\[1\] = 20 rad is over a turn; if degrees were meant"):
        rig.reset([0.1, 20])
    with pytest.raises(InvalidInput, match="arm = 'arm26' has to be an Arm"):
        MujocoPlant.of("arm26")
    with pytest.raises(InvalidInput, match="arm = 'arm26' has to be an Arm"):
        Reaching("arm26")


def test_bodies_in_space_are_not_written_as_a_chain():
    arm = Arm.from_mjcf(ARM.format(**STRAIGHT), named_muscle("sarosi-dmsp-20-200n"), 0.3, contraction=0.14)
    with pytest.raises(InvalidInput, match="TreeBodies cannot be written as MJCF"):
        to_mjcf(arm.mechanism, arm.bodies)
