"""Where a joint's fit has not seen the slack limits, whatever uses the joint says so."""

import json
import warnings
from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import Status, allocate, errors, stiffness_interval, torque_interval
from allocator.cli import app
from allocator.feasibility import feasibility_map
from allocator.joint.antagonist import report_joint
from allocator.joint.assumption import AssumedSlack, assumption
from allocator.joint.limits import COMMON_FORCE
from allocator.machine_file import save_machine

mpl.use("Agg")
SAID = "slack limits are assumed"


@pytest.fixture
def joint():
    return replace(report_joint(), unseen=(COMMON_FORCE,))


@pytest.fixture
def path(joint, tmp_path):
    save_machine(joint, tmp_path / "joint.toml")
    return tmp_path / "joint.toml"


def test_an_exact_answer_says_that_it_is_met_if_the_cables_are_taut(joint):
    answer = allocate(0.2, 7.5, 1.0, joint=joint)
    assert answer.status is Status.EXACT
    assert COMMON_FORCE in answer.assumed
    assert answer.assumed in answer.message
    assert answer.assumed in repr(answer)
    assert answer.to_dict()["assumed"] == answer.assumed
    assert answer.P1 == allocate(0.2, 7.5, 1.0).P1  # the pressures stay those of the model


def test_so_do_many_answers_and_those_that_miss_the_target(joint):
    many = allocate([0.0, 0.1, 0.2], 7.5, joint=joint)
    assert SAID in many.message
    assert many.to_dict()["assumed"].tolist() == [many.assumed] * 3
    assert SAID in allocate(0.0, 2.0, joint=joint).message


def test_a_joint_that_was_not_fitted_assumes_nothing():
    answer = allocate(0.2, 7.5, 1.0)
    assert assumption(report_joint()) == answer.assumed == ""
    assert "assumed" not in answer.to_dict()
    assert SAID not in answer.message
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        stiffness_interval(0.0)


@pytest.mark.filterwarnings("ignore:slack limits are assumed")
@pytest.mark.parametrize("seen", [True, False])
def test_a_stiffness_is_in_its_interval_if_and_only_if_it_is_given(seen, joint):
    asked = report_joint() if seen else joint
    for theta, T in ((0.0, 0.0), (0.3, 2.0), (-0.4, 1.0)):
        low, high = stiffness_interval(theta, T, joint=asked)
        for K, given in ((low * 0.98, False), (low * 1.02, True), (high * 0.98, True), (high * 1.02, False)):
            answer = allocate(theta, K, T, joint=asked)
            assert bool(answer.success) is given
            assert answer.stiffness_interval == pytest.approx((low, high), rel=1e-9)


def test_intervals_with_assumed_ends_warn_once(joint, monkeypatch):
    monkeypatch.setattr(errors, "_said", set())
    with pytest.warns(AssumedSlack, match=SAID):
        stiffness_interval(0.3, [0.0, 2.0], joint=joint)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        torque_interval(0.3, joint=joint)


def test_a_map_says_it_in_picture_table_and_arrays(joint, tmp_path):
    found = feasibility_map(np.linspace(-0.5, 0.5, 5), np.linspace(6, 9, 5), 0.0, joint=joint)
    assert SAID in found.plot().get_title(loc="left")
    found.to_csv(tmp_path / "map.csv")
    header, first, *_ = (tmp_path / "map.csv").read_text(encoding="utf-8").splitlines()
    assert header.endswith(",slack_limits")
    assert first.endswith(",assumed")
    found.to_npz(tmp_path / "map.npz")
    assert SAID in str(np.load(tmp_path / "map.npz")["assumed"])


def test_the_commands_say_it(path, tmp_path):
    run = CliRunner().invoke
    asked = ["--theta", "0", "--stiffness", "7.5", "--machine", str(path)]
    assert "slack limits" in run(app, ["allocate", *asked]).output
    values = json.loads(run(app, ["allocate", *asked, "--json"]).output)
    assert values["slack_assumed"]
    assert SAID in values["message"]
    out = ["--out", str(tmp_path / "map.png"), "--theta=-20:20:10", "--stiffness", "6:9:1"]
    assert SAID in run(app, ["map", "--machine", str(path), *out]).output
    drawn = run(app, ["map", "--machine", str(path), *out, "--force", "--json"]).output
    assert json.loads(drawn)["maps"][0]["slack_assumed"]
