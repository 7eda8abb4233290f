"""--valves, --frequency and --lag of `antagonist allocate` and `antagonist map`, as a person meets them."""

import csv
import json
from dataclasses import replace

import pytest
from typer.testing import CliRunner

from allocator import Stiffness, allocate, report_joint, stiffness_interval
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.cli import app

OPTIONS = ("--muscle", "sarosi-dmsp-20-400n", "--rest-volume", "125.7", "--tube-volume", "20")
JOINT = report_joint(replace(SAROSI_DMSP_20_400N, rest_volume=125.7e-6, tube_volume=20e-6))


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


@pytest.mark.parametrize(
    ("given", "asked", "name"),
    [
        ((), {}, "isobaric stiffness"),
        (("--valves", "shut"), {"valves": "shut"}, "shut stiffness"),
        (("--valves", "agonist"), {"valves": (True, False)}, "agonist-shut stiffness"),
        (("--valves", "free"), {"valves": "free"}, "shut stiffness"),
        (("--frequency", 2), {"frequency": 2.0, "lag": 0.1}, "dynamic stiffness at 2 Hz"),
        (("--frequency", 2, "--lag", 0.05), {"frequency": 2.0, "lag": 0.05}, "dynamic stiffness at 2 Hz"),
    ],
)
def test_allocate_answers_what_the_library_does_and_says_which_stiffness_it_is(given, asked, name):
    result = run("allocate", "--theta", 10, "--stiffness", 8, "--torque", 1, "--json", *given, *OPTIONS)
    answer, found = allocate(10 * DEG, 8.0, 1.0, joint=JOINT, stiffness=Stiffness(**asked)), json.loads(result.output)
    assert result.exit_code == 0
    assert (found["P1_bar"], found["P2_bar"]) == pytest.approx((answer.P1 / BAR, answer.P2 / BAR), rel=1e-12)
    assert found["stiffness"] == name
    assert ("agonist_valve_shut" in found) == bool(given)


def test_a_plant_in_the_file_says_which_lag_is_meant(tmp_path):
    path = tmp_path / "joint.toml"
    assert run("init", path).exit_code == 0
    path.write_text(
        path.read_text(encoding="utf-8").replace("lag = [0.1, 0.1]", "lag = [0.04, 0.06]"), encoding="utf-8"
    )
    asked = ("allocate", "--theta", 10, "--stiffness", 8, "--json", "--frequency", 2)
    joint = report_joint()
    for given, lag in (((), (0.04, 0.06)), (("--lag", 0.2), 0.2)):
        answer = allocate(10 * DEG, 8.0, joint=joint, stiffness=Stiffness(frequency=2.0, lag=lag))
        found = json.loads(run(*asked, "--machine", path, *given).output)
        assert found["P1_bar"] == pytest.approx(answer.P1 / BAR, rel=1e-12)


def test_its_table_names_the_stiffness_and_gives_the_isobaric_one_beside_it():
    result = run("allocate", "--theta", 10, "--stiffness", 12, "--valves", "free", *OPTIONS)
    assert "shut stiffness [N·m/rad]" in result.output
    assert "isobaric [N·m/rad]" in result.output


@pytest.mark.parametrize("given", [("--valves", "shut"), ("--valves", "free"), ("--frequency", "2")])
def test_a_map_shows_what_the_valves_reach(given, tmp_path):
    out = tmp_path / "map.csv"
    result = run("map", "--theta", "-60:60:30", "--stiffness", "2:18:1", "--out", out, *given, *OPTIONS)
    assert result.exit_code == 0
    assert (
        f"{' '.join({'shut': ['shut'], 'free': ['free-valve'], '2': ['dynamic']}[given[1]])} stiffness" in result.output
    )
    with out.open(encoding="utf-8") as file:
        rows = list(csv.reader(file))[1:]
    asked = {"valves": given[1]} if given[0] == "--valves" else {"frequency": 2.0, "lag": 0.1}
    for row in rows:
        low, high = stiffness_interval(float(row[0]) * DEG, joint=JOINT, stiffness=Stiffness(**asked))
        if row[3] == "EXACT":
            assert low <= float(row[1]) <= high
        elif given[1] != "free":  # of free valves there may be gaps
            assert not low <= float(row[1]) <= high
    assert any(float(row[1]) > stiffness_interval(0.0, joint=JOINT)[1] and row[3] == "EXACT" for row in rows)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("--valves", "closed"), "--valves closed: choose one of open, shut, free, agonist, antagonist"),
        (("--frequency", "-2"), "frequency = -2 Hz is negative"),
        (("--frequency", "2", "--lag", "-1"), "lag = -1 s is negative"),
        (("--lag", "0.1"), "frequency [Hz] and lag [s] go together"),
        (("--valves", "shut", "--frequency", "2"), "valves and frequency exclude each other"),
        (("--rest-volume", "0"), "--rest-volume 0: expected 0.1 to 5000 cm³"),
        (("--tube-volume", "-1"), "--tube-volume -1: expected 0 to 1000 cm³"),
    ],
)
def test_wrong_input_is_one_sentence(given, said):
    result = run("allocate", "--theta", 10, "--stiffness", 8, *given)
    assert said in str(result.exception)
    assert "\n" not in str(result.exception)
