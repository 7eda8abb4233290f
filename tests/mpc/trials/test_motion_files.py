"""Motions of several joints from files: what is read, and what is said of files that cannot be meant."""

import re
from dataclasses import replace

import numpy as np
import pytest

from allocator import InvalidFile, InvalidInput
from allocator.units import DEG, MM
from mpc.model.arm.model import Arm
from mpc.trials.motions.motion_files import UnusedColumns, load_motion

ARM = Arm.machine("arm26")
HAND = ARM.bodies.endpoint
OF_HAND = replace(ARM, endpoint=HAND)
ANGLES = [name.replace(" ", "_") + "_deg" for name in ARM.labels.angles]
K = "K11,K12,K22"


def written(tmp_path, *lines):
    file = tmp_path / "my.csv"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return file


def test_angles_and_stiffness_are_read_by_the_names_of_the_joints(tmp_path):
    file = written(tmp_path, f"t,{','.join(ANGLES)},{K}", "0,10,20,12,4.6,9.5", "0.5,12,25,13,4,9")
    asked = load_motion(file, ARM)
    np.testing.assert_allclose(asked.theta, np.array([[10, 20], [12, 25]]) * DEG)
    np.testing.assert_allclose(asked.K[1], [[13, 4], [4, 9]])
    assert asked.name == "my"


def test_an_entry_off_the_diagonal_is_zero_without_a_column_and_all_of_it_usual_without_any(tmp_path):
    one = load_motion(written(tmp_path, f"t,{','.join(ANGLES)},K11,K22", "0,0,0,6,7", "1,0,0,6,7"), ARM)
    np.testing.assert_allclose(one.K[0], np.diag([6.0, 7.0]))
    none = load_motion(written(tmp_path, f"t,{','.join(ANGLES)}", "0,0,0", "1,0,0"), ARM)
    assert (np.linalg.eigvalsh(none.K) > 0).all()


def test_the_hand_is_where_the_path_is_and_the_arm_does_not_change_sides(tmp_path):
    q = ARM.middle + np.linspace(-0.25, 0.25, 21)[:, None] * np.array([1.0, 0.6])
    path = HAND.position(q)
    lines = (f"{k / 20},{x / MM:.6f},{y / MM:.6f},300,100,100" for k, (x, y) in enumerate(path.tolist()))
    asked = load_motion(written(tmp_path, "t,x_mm,y_mm,Kx11,Kx12,Kx22", *lines), OF_HAND, HAND)
    np.testing.assert_allclose(HAND.position(asked.theta), path, atol=0.1 * MM)
    assert np.abs(np.diff(asked.theta, axis=0)).max() < 0.1
    np.testing.assert_allclose(asked.K[3], [[300, 100], [100, 100]])


WRONG = {
    "a hand out of reach": (["t,x_mm,y_mm", "0,5000,0", "1,5000,0"], ARM, "does not reach (5000, 0) mm"),
    "no motion at all": (["t,a", "0,1", "1,1"], ARM, "neither the angles"),
    "angles and a path": ([f"t,{','.join(ANGLES)},x_mm,y_mm", "0,0,0,1,1", "1,0,0,1,1"], ARM, "both the angles"),
    "one angle missing": ([f"t,{ANGLES[0]}", "0,1", "1,1"], ARM, "missing"),
    "time that stands still": ([f"t,{','.join(ANGLES)}", "0,0,0", "0,0,0"], ARM, "does not come after"),
    "over a turn": ([f"t,{','.join(ANGLES)}", "0,400,0", "1,0,0"], ARM, "over a turn"),
    "no stiffness that holds": (
        [f"t,{','.join(ANGLES)},{K}", "0,0,0,1,5,1", "1,0,0,1,5,1"], ARM, "positive definite",
    ),
    "the stiffness of the hand where the joints' is tracked": (
        [f"t,{','.join(ANGLES)},Kx11,Kx12,Kx22", "0,0,0,1,0,1", "1,0,0,1,0,1"], ARM, "--stiffness-of hand",
    ),
    "the stiffness of the joints where the hand's is tracked": (
        [f"t,{','.join(ANGLES)},{K}", "0,0,0,9,0,9", "1,0,0,9,0,9"], OF_HAND, "--stiffness-of joints",
    ),
    "beyond the joint's range": (
        [f"t,{','.join(ANGLES)}", "0,0,0", "1,300,0"], ARM, "300° is beyond the range of the joint, ",
    ),
    "one sample": ([f"t,{','.join(ANGLES)}", "0,0,0"], ARM, "at least 2 samples"),
}  # fmt: skip


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_meant_is_refused_in_a_sentence(tmp_path, name):
    lines, arm, said = WRONG[name]
    with pytest.raises(InvalidFile) as raised:
        load_motion(written(tmp_path, *lines), arm, HAND)
    assert said in str(raised.value)
    assert "my.csv" in str(raised.value)


def test_an_arm_and_a_hand_of_other_types_are_named(tmp_path):
    file = written(tmp_path, "t,x_mm,y_mm", "0,1,1", "1,1,1")
    with pytest.raises(InvalidInput, match="arm = 'arm26' has to be an Arm"):
        load_motion(file, "arm26", HAND)
    with pytest.raises(InvalidInput, match="hand = 'tip' has to be an Endpoint"):
        load_motion(file, ARM, "tip")


def test_a_path_needs_a_hand(tmp_path):
    with pytest.raises(InvalidFile, match="a path of the hand, which this machine lacks"):
        load_motion(written(tmp_path, "t,x_mm,y_mm", "0,1,1", "1,1,1"), ARM)


def test_columns_may_have_other_units_and_decimal_commas(tmp_path):
    file = written(
        tmp_path, "Zeit [ms];shoulder [rad];Elbow (deg);K11 [Nm/rad];K22 [N·m/deg]",
        "0;0,1;20;12,5;0,1", "500;0,2;25;13;0,2",
    )  # fmt: skip
    asked = load_motion(file, ARM)
    np.testing.assert_allclose(asked.t, [0.0, 0.5])
    np.testing.assert_allclose(asked.theta, [[0.1, 20 * DEG], [0.2, 25 * DEG]])
    np.testing.assert_allclose(asked.K[0], np.diag([12.5, 0.1 / DEG]))
    path = written(tmp_path, "t,x [m],y [cm]", "0,0.575,-6", "1,0.575,-5.9")
    np.testing.assert_allclose(HAND.position(load_motion(path, ARM, HAND).theta[0]), [0.575, -0.06], atol=0.1 * MM)


def test_columns_that_are_not_read_are_listed(tmp_path):
    file = written(tmp_path, f"t,{','.join(ANGLES)},Kxx,time_ref", "0,10,20,12,1", "1,12,25,13,2")
    with pytest.warns(UnusedColumns, match="columns not used: Kxx, time_ref"):
        load_motion(file, ARM)


@pytest.mark.parametrize(
    ("header", "said"),
    [
        ("t,x [ft],y_mm", "'x [ft]': the unit 'ft' is unknown; known are mm, m, cm, in"),
        ("t,x,y_mm", "'x': has no unit"),
        ("t,x_mm,y_mm,y [m]", "two columns of y_mm"),
        ("t,x_mm,y_mm,K11 [N/m]", "known are Nm/rad, Nm/deg"),
    ],
)
def test_units_that_are_not_known_are_named(tmp_path, header, said):
    cells = ",".join("0" for _ in header.split(","))
    with pytest.raises(InvalidFile, match=re.escape(said)):
        load_motion(written(tmp_path, header, cells, cells), ARM, HAND)
