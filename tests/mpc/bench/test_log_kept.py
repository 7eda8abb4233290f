"""A log that exists: it is kept until there is something to put in its place, and unless its user says otherwise."""

import os
import stat

import numpy as np
import pytest
from typer.testing import CliRunner

from allocator import DEG
from allocator.errors import CannotWrite, InvalidInput
from mpc.bench.device import DeviceLost, Reading
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.logs import read_log
from mpc.bench.record import Recorder
from mpc.bench.rows import Row
from mpc.bench.safety import RefusedStart
from mpc.cli import app

OLD = "the log of a week ago\n" * 1000


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(OLD)
    return path


def alone(log):
    return [p.name for p in log.parent.iterdir()] == [log.name]


def beyond(reading):
    return reading._replace(theta=170 * DEG)


def test_python_does_not_replace_a_log_unless_told_to(bench, log):
    with pytest.raises(InvalidInput, match=r"log\.csv' exists; give another name, or replace=True"):
        bench.loop(log=log).run()
    assert (log.read_text(), bench.device.commands) == (OLD, [])
    bench.loop(log=log, replace=True).run()
    assert read_log(log)["t"].size > 100
    assert alone(log)


@pytest.mark.parametrize("why", ["where it is", "no answer", "no connection"])
def test_a_loop_that_cannot_start_leaves_the_log_as_it_was(bench, log, monkeypatch, why):
    def gone(*_):
        raise DeviceLost("no cable")

    if why == "where it is":
        bench.device.changed = beyond
    else:
        monkeypatch.setattr(bench.device, "read" if why == "no answer" else "__enter__", gone)
        monkeypatch.setattr(type(bench.device), "__enter__", gone if why == "no connection" else lambda self: self)
    with pytest.raises((RefusedStart, DeviceLost)):
        bench.loop(log=log, replace=True).run()
    assert log.read_text() == OLD
    assert alone(log)
    assert bench.device.commands == []


def test_a_loop_that_cannot_start_leaves_no_log_where_there_was_none(bench, tmp_path):
    bench.device.changed = beyond
    with pytest.raises(RefusedStart):
        bench.loop(log=tmp_path / "log.csv").run()
    assert list(tmp_path.iterdir()) == []


def test_a_log_that_is_replaced_keeps_its_mode_and_its_links(bench, log):
    log.chmod(0o640)
    link = log.with_name("latest.csv")
    link.symlink_to(log)
    bench.loop(log=link, replace=True).run()
    assert link.is_symlink()
    assert stat.S_IMODE(log.stat().st_mode) == 0o640
    assert read_log(log)["t"].size > 100


def test_the_old_log_is_there_until_the_first_row(log):
    with Recorder(log, ["new"], replace=True) as recorder:
        assert log.read_text() == OLD
        recorder.add(Row(0.0, 0.1, (1e5, 1e5), (1e5, 1e5), 0, 0, 0.0, 0.0))
        assert log.read_text().count("\n") == 3
        recorder.add(Row(0.1, 0.1, (1e5, 1e5), (1e5, 1e5), 0, 0, 0.0, 0.0))
    np.testing.assert_array_equal(read_log(log)["t"], [0.0, 0.1])
    assert alone(log)


def test_a_disk_that_is_full_is_noticed_before_anything_moves_and_costs_no_log(bench, log, monkeypatch):
    def full(file, data):
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr("mpc.bench.record.os.write", full)
    with pytest.raises(CannotWrite, match="No space left"):
        bench.loop(log=log, replace=True).run()
    assert (log.read_text(), bench.device.commands) == (OLD, [])
    assert alone(log)


def test_run_with_force_leaves_the_log_where_it_cannot_start(log, monkeypatch):
    monkeypatch.setattr(SimulatedDevice, "read", lambda self: Reading(0.0, 170 * DEG, (0.0, 0.0)))
    arguments = ["run", "min-jerk", "--device", "sim", "--fast", "--quiet", "--controller", "pid", "--out", str(log)]
    refused = CliRunner().invoke(app, arguments)
    assert "log.csv exists" in str(refused.exception)
    assert isinstance(CliRunner().invoke(app, [*arguments, "--force"]).exception, RefusedStart)
    assert log.read_text() == OLD
    assert alone(log)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
def test_a_pipe_that_nobody_reads_is_no_log_and_no_reason_to_wait(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(CannotWrite, match="pipe cannot be written"), Recorder(tmp_path / "pipe"):
        pass


def test_a_name_that_is_too_long_is_refused_in_a_sentence(tmp_path):
    with pytest.raises(CannotWrite, match="cannot be written"), Recorder(tmp_path / ("x" * 300)):
        pass
