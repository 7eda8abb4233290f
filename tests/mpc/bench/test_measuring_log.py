"""Stiffness from logs that were not made for it: hidden joints, refusals, and the command."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG, InvalidFile, InvalidInput
from benchmarks.felt import logs
from benchmarks.felt.hidden import hidden, truth
from mpc.bench.cycle import Phase, Tick
from mpc.bench.device import Reading, SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.measuring.log import Samples, from_log, read_log_of_motion
from mpc.bench.measuring.session import Told, shake
from mpc.bench.measuring.shaking import Shaking
from mpc.bench.measuring.strengths import Known
from mpc.bench.measuring.update import combined

from ...rigs.bags import TOPICS, mcap, ros1, ros2

SEED = 1000  # Maxwell slip; strengths 1.04 and 1.02
JOINT = hidden(SEED)
REST = logs.rest_of(JOINT)


@pytest.fixture(scope="module")
def noise():
    return logs.recorded(JOINT.real, REST, "noise", SEED, 40.0)


def test_quick_motions_tell_strengths_backbone_and_felt_stiffness(noise):
    m = logs.measured(JOINT, noise)
    assert m.success, m.sentence
    K, felt = truth(JOINT, m)
    for g, s, true in zip(m.strengths, m.strengths_std, JOINT.real.force_gains, strict=True):
        assert abs(g - true) < 2 * s
        assert s < 0.03
    assert abs(m.K / K - 1) < 0.02
    assert len(m.felt) == 4
    for f in m.felt:
        assert abs(f.K - felt(f.amplitude)) < 0.08 * f.K
    assert m.damping == pytest.approx(JOINT.real.nominal.damping, rel=0.1)
    assert combined([m])[0] == pytest.approx(m.strengths)


def test_the_inertia_is_the_scale_and_its_error_is_said(noise):
    plant = replace(JOINT.real.nominal, inertia=1.1 * JOINT.real.nominal.inertia)
    m = from_log(plant, JOINT.told.friction.loop, noise, Known(plant.inertia, 0.1, JOINT.told.reading_age))
    right = logs.measured(JOINT, noise)
    assert np.divide(m.strengths, right.strengths) == pytest.approx(1.1, abs=1e-6)
    assert m.strengths_std[0] > 0.1


def test_a_slow_sine_is_refused_since_friction_follows_it_as_well():
    m = logs.measured(JOINT, logs.recorded(JOINT.real, REST, "sine", SEED, 20.0))
    assert not m.success
    assert "excitation" in m.sentence


def test_commands_instead_of_pressures_are_refused(noise):
    n, rng = noise.t.size, np.random.default_rng([SEED, 77])
    u = logs.commands(REST, "noise", n, rng)
    m = logs.measured(JOINT, Samples.of(noise.t, noise.theta, u[:, 0], u[:, 1]))
    assert "commanded pressures" in m.sentence


def test_a_short_log_and_rows_that_are_none_are_refused(noise):
    few = Samples.of(*(a[:400] for a in (noise.t, noise.theta, noise.P1, noise.P2)))
    assert "too short" in logs.measured(JOINT, few).sentence
    with pytest.raises(InvalidInput, match="400 samples or more"):
        Samples.of(noise.t[:9], noise.theta[:9], noise.P1[:9], noise.P2[:9])
    with pytest.raises(InvalidInput, match="t has to increase"):
        Samples.of(noise.t[::-1], noise.theta, noise.P1, noise.P2)


@pytest.mark.parametrize("name", ["log.csv", "log.mcap"])
def test_a_log_that_does_not_exist_is_named(tmp_path, name):
    with pytest.raises(InvalidFile, match=f"{name}: does not exist"):
        read_log_of_motion(tmp_path / name)


@pytest.mark.slow
def test_a_joint_on_a_device_is_shaken_within_twice_the_amplitude_and_measured():
    clock = SimulatedClock()
    device = SimulatedDevice(JOINT.real, clock, seed=5)
    told = Told(JOINT.real.nominal, JOINT.told)
    m, cycle = shake(device, told, JOINT.theta, JOINT.K, 10 * DEG, clock=clock)
    assert m.success, m.sentence
    K, _ = truth(JOINT, m)
    assert abs(m.K - K) < 2 * m.K_std
    assert m.K_std < 0.05 * K
    assert 0.5 < m.furthest < 2
    running = cycle.recorder.columns["phase"] == Phase.RUN
    u = np.column_stack([cycle.recorder.columns[f"P{i}_command"][running] for i in (1, 2)])
    low, high = JOINT.real.nominal.pressure_limits
    assert ((u >= low) & (u <= high)).all()
    assert str(cycle.ending.reason) == "finished"


def test_noise_begins_small_and_is_halved_where_the_joint_moves_too_far():
    source = Shaking(JOINT.real.nominal, 0.0, 5.0, 0.01, 5 * DEG, 6.0)
    sent, angle = [], 0.0
    for k in range(10_000):
        decision = source.decide(Tick(k, 0, Reading(0.01 * k, angle, source.first), source.first, 0.01 * k))
        if decision is None:
            break
        sent.append(np.subtract(decision.u, source.first))
        angle = 20 * DEG * (-1) ** k if 400 < k < 500 else 0.0
    noise = np.abs(np.array(sent))
    assert noise[:150].max() == 0
    assert noise[402:500].max() < 0.7 * noise[300:400].max()
    assert source.furthest > 3


def test_the_command_reads_a_log_and_updates_the_file(noise, tmp_path, monkeypatch):
    from typer.testing import CliRunner

    from mpc.cli import app

    monkeypatch.chdir(tmp_path)
    JOINT.real.nominal.save("joint.toml")
    rows = np.column_stack([noise.t, noise.theta / DEG, noise.P1 / BAR, noise.P2 / BAR])
    head = "time [s],theta [deg],pressure1 [bar],pressure2 [bar]"
    np.savetxt("run.csv", rows, delimiter=",", header=head, comments="")
    run = CliRunner().invoke(app, ["measure", "run.csv", "--machine", "joint.toml", "--out", "felt.png", "--update"])
    assert run.exit_code == 0, run.output
    assert "felt K at ±2°" in run.output
    assert (tmp_path / "felt.png").stat().st_size > 1000
    assert "[[measured]]" in (tmp_path / "joint.toml").read_text()
    np.savetxt("still.csv", rows * [1, 0, 1, 1], delimiter=",", header=head, comments="")
    with pytest.raises(InvalidFile, match="no motion"):
        read_log_of_motion("still.csv")
    cases = (
        (["run.csv", "--device", "sim"], "a log takes none of --device"),
        ([], "--device is missing"),
        (["still.csv"], "no motion"),
        (["joint.toml"], "joint.toml"),
        (["run.csv"], "give --inertia"),
    )
    for arguments, why in cases:
        refused = CliRunner().invoke(app, ["measure", *arguments])
        assert why in str(refused.exception)


@pytest.mark.parametrize("write", [ros1, ros2, mcap])
def test_a_recording_of_a_robot_is_a_log(noise, write, tmp_path):
    stamps = np.round(noise.t * 1e9).astype(np.int64)
    log = read_log_of_motion(write(tmp_path, (stamps, noise.theta, noise.P1, noise.P2)), topics=TOPICS)
    for name in ("theta", "P1", "P2"):
        np.testing.assert_allclose(getattr(log, name), getattr(noise, name), rtol=1e-7)  # nine digits
    np.testing.assert_allclose(np.diff(log.t), np.diff(noise.t), atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("road", "within"), [("in_log", 0.03), ("measured", 0.06)])
def test_the_backbone_of_a_stranger_is_measured_where_its_force_law_is_not_the_model_s(road, within):
    from benchmarks.felt import strangers
    from benchmarks.strangers.identified import data_sheet
    from benchmarks.strangers.plants import drawn

    stranger = drawn("tips", 1000)
    model = data_sheet(stranger)
    m = getattr(strangers, road)(stranger, model, 1000)
    K = float(stranger.along(np.array([[m.theta, 0.0, *m.pressures]]))[0][0])
    by_strengths = sum(
        g * float(side.stiffness(P))
        for g, side, P in zip(m.strengths, model.plant.joint.sides(m.theta), m.pressures, strict=True)
    )
    assert abs(m.K / K - 1) < within < abs(by_strengths / K - 1)
    assert abs(m.K - K) < 2 * m.K_std
