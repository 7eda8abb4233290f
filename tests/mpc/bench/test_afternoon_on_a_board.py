"""Sweep, fit and track over a serial line; `python -m benchmarks.board_afternoon` does it in real time."""

import numpy as np
import pytest

from allocator.units import BAR, DEG
from mpc import Compensation, Plant
from mpc.bench.loop import Tracking, replay
from mpc.bench.safety import Reason
from mpc.trials.files import load_recording
from mpc.trials.metrics import metrics

from ...rigs.afternoon import GEOMETRY, HIDDEN, Afternoon, antagonist
from ...rigs.needs import needs, posix

pytestmark = [
    pytest.mark.tools,
    pytest.mark.slow,
    needs("gcc"),
    posix,
]
AFTERNOON = Afternoon(real_time=False)


def test_from_sweep_to_a_tracked_trajectory_over_a_serial_line(tmp_path):
    swept = AFTERNOON.sweep(tmp_path, motion=20)
    assert swept.ending.reason is Reason.FINISHED
    assert swept.lateness.missed == 0
    joint, plant = tmp_path / "joint.toml", tmp_path / "plant.toml"
    antagonist("fit-joint", tmp_path / "joint_log.csv", *GEOMETRY, "--out", joint)
    antagonist("fit-motion", tmp_path / "motion_log.csv", "--machine", joint, "--out", plant)
    found = Plant.load(plant)
    assert found.lag == pytest.approx(HIDDEN.lag, rel=0.3)
    known = Compensation.load(plant)
    record = AFTERNOON.run(found, known, tmp_path / "run.csv")
    assert record.ending.reason is Reason.FINISHED
    assert record.theta_rms < 1 * DEG
    record.save(tmp_path / "run.npz")
    figures = metrics(load_recording(tmp_path / "run.npz"))
    assert figures.after_rest.theta_rms < 1.0  # [°]
    assert figures.limits_kept, figures.violations
    commands = np.column_stack([record.columns["P1_command"], record.columns["P2_command"]])
    assert ((commands >= 0) & (commands <= 5 * BAR)).all()
    again = replay(record.columns, Tracking(found, *AFTERNOON.loop(found, known), AFTERNOON.reference(found), 1.0))
    np.testing.assert_allclose(again[:-1], record.run().u, rtol=1e-9)
