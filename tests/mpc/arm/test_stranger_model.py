"""Commands with a MuJoCo model of a stranger: muscle actuators, contacts, postures that do not hold themselves."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import named_muscle
from allocator.mechanism import Endpoint, Mechanism
from allocator.units import DEG
from mpc.arm import MujocoPlant
from mpc.cli import app
from mpc.model.arm.reading import read_arm

MODEL = """
<mujoco><worldbody>
  <site name="s_a" pos=".05 0 0"/><site name="s_b" pos="-.05 0 0"/>
  <body pos="0 0 .3"><joint name="shoulder" axis="0 1 0" range="-60 60" limited="true"/>
    <geom type="capsule" fromto="0 0 0 0 0 .3" size=".02" mass="1"/>
    <site name="u_a" pos=".04 0 .05"/><site name="u_b" pos="-.04 0 .05"/>
    <body pos="0 0 .3"><joint name="elbow" axis="0 1 0" range="-60 60" limited="true"/>
      <geom type="capsule" fromto="0 0 0 0 0 .25" size=".02" mass=".6"/>
      <site name="f_a" pos=".04 0 .05"/><site name="f_b" pos="-.04 0 .05"/><site name="hand" pos="0 0 .25"/>
    </body></body></worldbody>
<tendon>
  <spatial name="a"><site site="s_a"/><site site="u_a"/></spatial>
  <spatial name="b"><site site="s_b"/><site site="u_b"/></spatial>
  <spatial name="c"><site site="u_a"/><site site="f_a"/></spatial>
  <spatial name="d"><site site="u_b"/><site site="f_b"/></spatial>
</tendon>
<actuator><muscle tendon="a"/><muscle tendon="b"/><muscle tendon="c"/><muscle tendon="d"/></actuator></mujoco>
"""


@pytest.fixture
def model(tmp_path):
    path = tmp_path / "arm.xml"
    path.write_text(MODEL)
    return path


def run(*arguments):
    return CliRunner().invoke(app, [str(a) for a in arguments])


def test_allocate_and_map_take_the_model_that_track_takes(model, tmp_path):
    mine = "--machine", model, "--rest-length", 300, "--posture", "10,10"
    done = run("allocate", *mine, "--stiffness", 4, "--json")
    assert done.exit_code == 0, done.output
    arm = read_arm(model, named_muscle("sarosi-dmsp-20-400n"), 0.3, contraction=0.1375).mechanism
    answer = json.loads(done.stdout)
    torque = arm.torque(np.array([10, 10]) * DEG, np.array(answer["P_bar"]) * 1e5)
    assert answer["torque_Nm"] == pytest.approx(torque, abs=1e-9)
    assert run("map", *mine, "--out", tmp_path / "map.png").exit_code == 0


def test_the_stiffness_of_a_site_or_body_of_the_model_is_allocated_and_drawn(model, tmp_path):
    mine = "--machine", model, "--rest-length", 300
    asked = "--posture", "10,30", "--stiffness", 60, "--hand"
    done = run("allocate", *mine, *asked, "hand", "--push", "0.1,0", "--json")
    assert done.exit_code in (0, 3), done.output
    answer = json.loads(done.stdout)
    hand = Endpoint.from_mjcf(model, "hand", axes="xz")
    assert answer["position_m"] == pytest.approx(hand.position(np.array([10, 30]) * DEG))
    assert run("map", *mine, "--hand", "hand:xz", "--out", tmp_path / "map.png").exit_code == 0
    for given, said in (
        ((*mine, *asked, "foot"), "has no site or body called 'foot'"),
        (("--machine", "arm26", *asked, "hand"), "--hand hand is of a MuJoCo model (.xml); arm26 takes --links"),
        ((*mine, *asked, "hand", "--links", "300,250"), "give one of the two"),
        (("--theta", 1, "--stiffness", 6, "--hand", "hand"), "--hand goes with a --machine of several joints"),
    ):
        assert said in str(run("allocate", *given).exception)
    for hand, said in (("foot", f"{model}: has no site or body called 'foot'"), ("hand:xyz", "at most 2 coordinates")):
        refused = run("track", *mine, "--hand", hand, "--stiffness-of", "hand", "--out", tmp_path / "run.csv")
        assert said in str(refused.exception)


def test_contraction_gives_the_cables_that_the_arm_has(model):
    muscle = named_muscle("sarosi-dmsp-20-400n")
    read = Mechanism.from_mjcf(model, muscle, 0.3, contraction=0.1375)
    assert read.contractions([0, 0]) == pytest.approx(0.1375)


def test_rest_lengths_and_options_of_a_joint_are_asked_for_in_one_sentence(model):
    unknown = run("allocate", "--machine", model, "--posture", "1,1", "--stiffness", 4)
    assert "--rest-length [mm]" in str(unknown.exception)
    assert "350.1, 350.1, 300, 300 mm" in str(unknown.exception)
    assert "--radius is for one joint" in str(run("map", "--machine", model, "--radius", 20).exception)
    assert "arm.xml is a MuJoCo model" in str(run("plan-joint", "--machine", model).exception)


def test_actuators_with_states_are_no_hindrance_where_actuation_is_off(model):
    read = read_arm(model, named_muscle("sarosi-dmsp-20-400n"), 0.3, contraction=0.1375)
    assert read.model.na == 4
    assert MujocoPlant(read.model, read.mechanism.muscles, 0.3, cable=read.mechanism.routes.cable).n == 2


def test_the_demonstration_of_an_exported_allocation_holds_itself(model, tmp_path):
    done = run("export", "allocation", "--machine", model, "--rest-length", 300, "--out", tmp_path / "c")
    assert done.exit_code == 0, done.exception
