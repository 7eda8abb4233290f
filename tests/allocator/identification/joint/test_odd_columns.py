"""Columns of a joint's log under other names: a torque is read, or its file refused; it never vanishes."""

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from allocator.errors import InvalidInput
from allocator.identification import read_joint_log
from allocator.identification.joint.cli import fit_joint_command
from allocator.units import DEG

HEADER = "theta [deg],p1 [bar],p2 [bar]"
ROWS = [(-20, 1, 3), (-10, 1.5, 2.5), (0, 2, 2), (10, 2.5, 1.5)]
WEIGHTS = [0.0, 1.0, 0.5, -1.0]
INCH, POUND = 0.0254, 0.45359237 * 9.80665


@pytest.fixture
def written(tmp_path):
    def write(name, values=WEIGHTS):
        path = tmp_path / "log.csv"
        rows = "".join(f"{','.join(map(str, row))},{value}\n" for row, value in zip(ROWS, values, strict=True))
        path.write_text(f"{HEADER},{name}\n{rows}", encoding="utf-8")
        return path

    return write


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        *((name, 1.0) for name in ("tau [Nm]", "τ (N·m)", "Moment [Nm]", "T [N.m]", "M in Nm", "weight [Nm]")),
        *((name, 1.0) for name in ("Last [Nm]", "Lastmoment_Nm", "Drehmoment (N m)", "load torque [N-m]")),
        *((name, INCH * POUND) for name in ("torque (lbf in)", "Torque [in-lbf]", "T [in lb]", "torque_lbf_in")),
        *((name, 12 * INCH * POUND) for name in ("torque [ft-lb]", "Torque (lbf·ft)")),
        *((name, 0.0980665) for name in ("M [kgf cm]", "torque (kg·cm)", "Moment [kp cm]")),
        ("torque [mNm]", 1e-3),
    ],
)
def test_the_torque_of_a_weight_is_read_under_its_usual_names_and_units(written, name, unit):
    log = read_joint_log(written(name))
    np.testing.assert_allclose(log.torque, unit * np.array(WEIGHTS), rtol=1e-9)
    assert log.notes == ()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        (
            "motor torque [Nm]",
            "name it 'torque [Nm]' or say --columns \"torque=motor torque [Nm]:Nm\"; if not, --columns",
        ),
        ("x (in lbf)", "name it 'torque [lbf in]'"),
        ("weight [kg]", "line 1, column 'weight [kg]': is a weight, not a torque: multiply it by its lever arm"),
        ("Last [N]", "is a weight, not a torque"),
        ("weight", "line 1: column 'weight' has no unit: name them such as 'weight [Nm]'"),
        ("torque [furlong]", "has an unknown unit 'furlong'; known are Nm,"),
        ("time [weeks]", "has an unknown unit 'weeks'; known are s, ms"),
    ],
)
def test_a_torque_that_cannot_be_read_is_refused_and_can_be_ignored(written, name, said):
    with pytest.raises(InvalidInput) as refusal:
        read_joint_log(written(name))
    assert said in str(refusal.value)
    assert "\n" not in str(refusal.value)
    log = read_joint_log(written(name), columns={"ignore": name})
    assert log.notes == (f"columns not used: {name}",)
    assert not log.torque.any()


@pytest.mark.parametrize("name", ["T [°C]", "load [N]", "torque_Nm/rad", "note", "sens [V]"])
def test_columns_that_are_something_else_are_listed(written, name):
    assert read_joint_log(written(name)).notes == (f"columns not used: {name}",)


@pytest.mark.parametrize("name", ["Richtung", "direction", "dir", "sens"])
@pytest.mark.parametrize("words", [(1, -1, 0, 1), ("up", "down", "0", "UP"), ("auf", "ab", "0", "steigend")])
def test_directions_are_read_as_numbers_and_words(written, name, words):
    assert read_joint_log(written(name, words)).direction.tolist() == [1, -1, 0, 1]


def test_a_direction_in_other_words_is_refused_with_those_that_are_known(written):
    with pytest.raises(InvalidInput, match=r"line 5, column 'Richtung': 'links' .* up \(rising\), -1 or down"):
        read_joint_log(written("Richtung", ("auf", "ab", "0", "links")))


def test_several_columns_are_ignored_and_a_unit_of_the_row_below_the_names_is_believed(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("a,b,c,d [Nm],e [Nm]\ndeg,bar,bar,,\n-20,1,3,5,5\n10,2.5,1.5,5,5\n", encoding="utf-8")
    columns = {"theta": "a", "pressure1": "b", "pressure2": "c", "ignore": "d;e"}
    assert read_joint_log(path, columns=columns).theta / DEG == pytest.approx([-20, 10])


def test_the_command_says_which_columns_it_does_not_use_before_it_fits(written):
    app = typer.Typer(pretty_exceptions_enable=False)
    app.command("fit-joint")(fit_joint_command)
    result = CliRunner().invoke(app, [str(written("note")), "--pulley", "20,0.1375", "--rest-length", "400"])
    assert "columns not used: note" in result.output


def test_a_unit_that_contradicts_the_header_is_taken_and_reported(written):
    name = "load [kgm]"
    log = read_joint_log(written(name), columns={"torque": f"{name}:Nm"})
    assert log.notes == ("'load [kgm]' is read in Nm, as --columns says, not in kgf m",)
    assert read_joint_log(written(name), columns={"torque": f"{name}:kgf m"}).notes == ()
