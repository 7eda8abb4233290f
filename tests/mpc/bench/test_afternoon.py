"""An afternoon without hardware: sweep, fit, track, on a joint whose parameters only the device knows."""

from dataclasses import replace

import pytest
from typer.testing import CliRunner

from allocator.joint.antagonist import report_joint
from allocator.muscles import scaled
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from mpc import Plant
from mpc.cli import app
from mpc.trials.metrics import metrics
from mpc.trials.recordings import load_recording

ROUGH = Plant(report_joint(SAROSI_DMSP_20_400N))  # what a data sheet tells
WEAKER = {"agonist": scaled(SAROSI_DMSP_20_400N, 0.9), "antagonist": scaled(SAROSI_DMSP_20_400N, 0.82)}
HIDDEN = Plant(replace(ROUGH.joint, **WEAKER), inertia=0.04, damping=0.15, lag=(0.09, 0.11))
GEOMETRY = "--pulley", "0.02,0.1375", "--rest-length", "400"


def antagonist(*arguments):
    result = CliRunner().invoke(app, [str(a) for a in arguments])
    assert result.exit_code == 0, result.output
    return result.output


@pytest.mark.slow
def test_from_sweep_to_a_tracked_trajectory_on_the_command_line(tmp_path):
    hidden, log = tmp_path / "hidden.toml", tmp_path / "run"
    HIDDEN.save(hidden)
    where = "--device", f"sim:{hidden}", "--fast", "--quiet"
    antagonist("sweep", *where, "--muscle", "sarosi-dmsp-20-400n", "--out", tmp_path, "--motion", 40)
    joint, plant = tmp_path / "joint.toml", tmp_path / "plant.toml"
    antagonist("fit-joint", tmp_path / "joint_log.csv", *GEOMETRY, "--out", joint)
    antagonist("fit-motion", tmp_path / "motion_log.csv", "--joint", joint, "--out", plant)
    found = Plant.load(plant)
    assert found.lag == pytest.approx(HIDDEN.lag, rel=0.3)
    antagonist("run", "min-jerk", *where, "--joint", plant, "--out", f"{log}.csv", "--out", f"{log}.npz")
    figures = metrics(load_recording(f"{log}.npz"))
    assert figures.after_rest.theta_rms < 1.0  # [°]
    assert figures.limits_kept, figures.violations
