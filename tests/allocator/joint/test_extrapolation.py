"""Whatever uses a fitted muscle beyond its measurements says so; whatever stays within them does not."""

import json
import warnings
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import allocate, errors, stiffness_interval, torque_interval
from allocator.cli import app
from allocator.feasibility import angle_intervals, feasibility_map
from allocator.joint.antagonist import report_joint
from allocator.joint.assumption import Extrapolated
from allocator.machine_file import load_joint, save_machine
from allocator.mechanism import Mechanism
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.muscles.measured import MeasuredRegion
from allocator.units import BAR
from mpc import Plant, Reference, simulate
from mpc.yardsticks.baselines import FeedForwardControl

mpl.use("Agg")
SAID = "extrapolated beyond what was measured"
WIDE = MeasuredRegion((-0.1, 0.4, 0.4, -0.1), (0.0, 0.0, 6 * BAR, 6 * BAR))
NARROW = MeasuredRegion((0.10, 0.16, 0.16, 0.10), (0.0, 0.0, 3 * BAR, 3 * BAR))  # ε = 0.1375 at 0°, ∓0.05 per rad


def joint_of(region):
    return report_joint(replace(SAROSI_DMSP_20_400N, measured=region))


@pytest.fixture
def joint():
    return joint_of(NARROW)


def test_an_answer_names_the_muscle_that_leaves_its_measurements(joint):
    inside = allocate(0.1, 4.0, joint=joint)
    assert max(inside.P1, inside.P2) < 3 * BAR
    assert inside.assumed == ""
    contracted = allocate(0.7, 4.0, joint=joint)  # agonist ε = 0.17, antagonist 0.10
    assert SAID in contracted.assumed
    assert "agonist (measured at contractions of 0.1 to 0.16 at 0 to 3 bar)" in contracted.assumed
    assert "antagonist" not in contracted.assumed
    assert contracted.assumed in contracted.message
    assert contracted.assumed in repr(contracted)
    stiff = allocate(0.0, 8.0, joint=joint)
    assert stiff.P1 > 3 * BAR
    assert "agonist" in stiff.assumed
    assert "antagonist" in stiff.assumed


def test_many_answers_are_counted(joint):
    many = allocate(np.array([0.0, 0.1, 0.7]), 4.0, joint=joint)
    assert "agonist (in 1 of 3 points" in many.assumed
    assert many.to_dict()["assumed"].tolist() == [many.assumed] * 3


def test_the_readable_answer_and_the_kernel_agree_beyond_the_region(joint):
    """Method "exact" under a kernel, and DAQP on the same problem: one law for both."""
    asked = {"joint": joint}
    theta, K = np.linspace(-0.9, 0.9, 7), 4.5
    fast = allocate(theta, K, 0.5, **asked)
    slow = allocate(theta, K, 0.5, method="qp", **asked)
    np.testing.assert_allclose(fast.P1, slow.P1, rtol=1e-5)
    assert fast.kkt_residual.max() < 1e-9
    np.testing.assert_allclose(fast.K, joint.stiffness(theta, fast.P1, fast.P2), rtol=1e-9)


def test_without_measurements_or_within_them_nothing_is_said(tmp_path):
    for joint in (report_joint(), joint_of(None), joint_of(WIDE)):
        assert allocate(0.9, 6.0, joint=joint).assumed == ""
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            stiffness_interval(0.5, joint=joint)


def test_intervals_warn_once(joint, monkeypatch):
    for interval in (stiffness_interval, torque_interval):
        monkeypatch.setattr(errors, "_said", set())
        with pytest.warns(Extrapolated, match=SAID):
            interval(np.linspace(-1, 1, 5), joint=joint)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            interval(np.linspace(-0.9, 1, 4), joint=joint)
    monkeypatch.setattr(errors, "_said", set())
    with pytest.warns(Extrapolated, match=SAID):
        angle_intervals(5.0, joint=joint)


def test_a_map_says_which_of_its_cells_are_extrapolated(joint, tmp_path):
    theta, K = np.array([-0.7, 0.0, 0.7]), np.array([2.5, 4.0, 8.0])
    found = feasibility_map(theta, K, 0.0, joint=joint)
    assert SAID in found.assumed
    assert SAID in found.plot().get_title(loc="left")
    found.to_csv(tmp_path / "map.csv")
    header, *rows = (tmp_path / "map.csv").read_text(encoding="utf-8").splitlines()
    assert header.endswith(",forces")
    for row in rows:
        angle, stiffness, *_, P1, P2, forces = row.split(",")
        eps = 0.1375 + np.array([1, -1]) * np.deg2rad(float(angle)) * 0.02 / 0.4
        out = not NARROW.contains(eps, np.array([float(P1), float(P2)]) * BAR).all()
        feasible = row.split(",")[3] == "EXACT"
        assert forces == ("extrapolated" if out and feasible else "measured"), (angle, stiffness)


def test_a_joint_file_keeps_where_its_muscles_were_measured(joint, tmp_path):
    save_machine(joint, tmp_path / "joint.toml")
    assert load_joint(tmp_path / "joint.toml") == joint
    asked = ["allocate", "--theta", "40", "--stiffness", "4", "--machine", str(tmp_path / "joint.toml")]
    shown = CliRunner().invoke(app, asked).output
    assert "force of the agonist" in shown
    assert "extrapolated" in shown
    values = json.loads(CliRunner().invoke(app, [*asked, "--json"]).output)
    assert SAID in values["assumed"]
    assert not values["slack_assumed"]


def test_a_mechanism_names_its_muscle(joint):
    mechanism = Mechanism.from_joint(joint)
    answer = allocate([0.7], [[4.0]], [0.0], joint=mechanism)
    assert SAID in answer.assumed
    assert answer.assumed in answer.message
    assert allocate([0.7], [[4.0]], [0.0], joint=Mechanism.from_joint(joint_of(WIDE))).assumed == ""


@pytest.mark.slow
def test_a_run_that_leaves_the_region_says_so(joint):
    """The plant of the fitted muscles, driven by feed-forward to 60°, and to 10°."""
    for angle, leaves in ((60, True), (10, False)):
        theta = np.deg2rad(np.linspace(0, angle, 11))
        reference = Reference(np.linspace(0, 1.0, 11), theta, np.full(11, 4.0))
        plant = Plant(joint=joint)
        run = simulate(plant, FeedForwardControl(plant), reference)
        within = NARROW.contains(0.1375 + 0.05 * np.array([[1, -1]]) * run.theta[:, None], run.P).all()
        assert within != leaves
        assert (SAID in run.assumed) == leaves
        assert (SAID in repr(run)) == leaves
