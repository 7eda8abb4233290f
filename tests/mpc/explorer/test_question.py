"""The page's questions are answered as `allocate` and the maps answer them."""

import json
from dataclasses import fields

import numpy as np
import pytest

from allocator import (
    BAR,
    DEG,
    AntagonistJoint,
    Lever,
    Stiffness,
    allocate,
    named_muscle,
    report_joint,
    stiffness_interval,
)
from allocator.errors import InvalidInput
from mpc.explorer.question import Answer, Question, describe


def on_a_lever():
    muscle = named_muscle("sarosi-dmsp-20-400n")
    return AntagonistJoint(Lever(rest_length=0.25, anchor=0.1655, lever=0.05094, offset=0.051), muscle, muscle)


@pytest.mark.parametrize("joint", [report_joint(), on_a_lever()], ids=["pulley", "lever"])
@pytest.mark.parametrize("stiffness", [3.0, 7.5, 30.0])
def test_the_state_is_what_allocate_says(joint, stiffness):
    found = Answer(Question(theta=10.0, stiffness=stiffness, torque=0.5), joint).state()
    a = allocate(10 * DEG, stiffness, 0.5, joint=joint)
    assert found["pressures"] == [a.P1 / BAR, a.P2 / BAR]
    assert (found["stiffness"], found["status"], found["met"]) == (a.K, a.status.name, a.success)
    assert found["binding"] == list(a.active)
    for muscle, force in zip(found["muscles"], joint.forces(10 * DEG, a.P1, a.P2), strict=True):
        assert muscle["force"] == pytest.approx(force)
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize(
    ("joint", "valves"), [(report_joint(), "open"), (on_a_lever(), "shut"), (report_joint(), "shut")]
)
def test_the_outline_goes_through_the_ends_of_the_stiffness_intervals(joint, valves):
    found = Answer(Question(torque=0.5, valves=valves), joint).outline()
    json.dumps(found, allow_nan=False)
    curves = [edge for edge in found["edges"] if len(edge["theta"]) > 2 and np.ptp(edge["theta"]) > 1]
    for curve in curves:
        at = len(curve["theta"]) // 2
        low, high = stiffness_interval(curve["theta"][at] * DEG, 0.5, joint=joint, stiffness=Stiffness(valves))
        assert min(abs(curve["stiffness"][at] - low), abs(curve["stiffness"][at] - high)) < 1e-6 * high
    assert curves


def test_an_angle_without_any_stiffness_is_null_and_not_nan():
    found = Answer(Question(theta=0.0, stiffness=7.0, torque=50.0), report_joint()).state()
    assert found["reach"] == [None, None]
    assert not found["met"]
    assert Answer(Question(torque=500.0, valves="shut"), report_joint()).outline()["edges"] == []


def test_supply_and_geometry_are_changed():
    question = Question.of({"supply": "3", "radius": "30", "rest_length": "300", "initial_contraction": "0.12"})
    joint = question.joint(report_joint())
    assert joint.pressure_limits == (0.0, 3 * BAR)
    assert (joint.geometry.radius, joint.geometry.rest_length, joint.geometry.initial_contraction) == (0.03, 0.3, 0.12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"theta": "much"}, "theta = 'much' is no number"),
        ({"valves": "ajar"}, "choose one of open, shut"),
        ({"mass": "3"}, "nothing is known of mass"),
    ],
)
def test_a_question_that_makes_no_sense_gets_a_sentence(given, said):
    with pytest.raises(InvalidInput, match=said):
        Question.of(given)


@pytest.mark.parametrize(
    "question", [Question(theta=float("nan")), Question(stiffness=-1.0), Question(supply=-1.0), Question(radius=0.0)]
)
def test_numbers_that_cannot_be_are_refused(question):
    with pytest.raises(InvalidInput):
        Answer(question, report_joint()).state()


def test_a_lever_has_no_radius():
    with pytest.raises(InvalidInput, match="is a Lever, which has no radius"):
        Answer(Question(radius=20.0), on_a_lever()).state()
    with pytest.raises(InvalidInput, match="is a Pulley, which has no anchor, lever"):
        Answer(Question(anchor=200.0, lever=20.0), report_joint()).state()


@pytest.mark.parametrize("joint", [report_joint(), on_a_lever()], ids=["pulley", "lever"])
def test_every_number_of_the_geometry_has_a_slider_that_begins_at_its_value_and_changes_it(joint):
    described = describe(joint)
    names = {field.name for field in fields(joint.geometry) if field.init}
    assert {control["name"] for control in described["controls"]} == names
    for control in described["controls"]:
        assert control["low"] <= control["value"] <= control["high"]
        unchanged = Question.of({control["name"]: repr(control["value"])}).joint(joint).geometry
        assert getattr(unchanged, control["name"]) == pytest.approx(getattr(joint.geometry, control["name"]))
        changed = Question.of({control["name"]: repr(1.01 * control["value"])}).joint(joint).geometry
        assert getattr(changed, control["name"]) == pytest.approx(1.01 * getattr(joint.geometry, control["name"]))


def test_a_lever_is_drawn_from_its_own_lengths_which_its_muscles_have():
    """The muscle's length is the way from its anchor to the lever's end, and the offset: Pythagoras at 0°."""
    found = Answer(Question(theta=0.0, lever=60.0), on_a_lever()).state()
    geometry = found["geometry"]
    assert (geometry["anchor"], geometry["lever"]) == (pytest.approx(165.5), pytest.approx(60.0))
    far = np.hypot(geometry["anchor"], geometry["lever"])
    assert [muscle["length"] for muscle in found["muscles"]] == pytest.approx([far + geometry["offset"]] * 2)


def test_a_posture_where_the_gas_model_does_not_hold_has_an_answer():
    found = Answer(Question(theta=-120.0, stiffness=0.5, torque=-15.0), report_joint()).state()["three"]
    assert found["shut"] is None
    assert found["backbone"] > 0
