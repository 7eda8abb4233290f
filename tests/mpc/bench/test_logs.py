"""Logs: read again, replayed, made a run; readings that come late."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism.endpoint import Endpoint
from mpc import KalmanObserver, Plant, Reference, TrackingMPC, Weights, simulate
from mpc.bench.cycle import Phase, Tick
from mpc.bench.device import NoAnswer, Reading, SimulatedClock
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.bench.logs import read_log, run_of
from mpc.bench.loop import RealTimeLoop, Tracking, replay
from mpc.bench.measuring.log import read_log_of_motion
from mpc.bench.record import Lateness
from mpc.bench.rows import JOINT, Row, Sheet
from mpc.bench.safety import Reason, SoftStart, Watchdog
from mpc.explorer.server import frames
from mpc.model.arm.model import Arm
from mpc.model.faults import SupplyDrop
from mpc.model.real import RealArm, RealPlant
from mpc.observer.base import Differentiator
from mpc.observer.health import FaultKind, Finding, Health, Part, Suspect
from mpc.trials.files import load_recording, save_recording
from mpc.trials.metrics import metrics
from mpc.trials.motions.arm_trajectories import reference
from mpc.trials.motions.reference import sine
from mpc.yardsticks.baselines import PIDControl

either = pytest.mark.parametrize("bench", ["joint", "arm"], indirect=True)

DT = 0.01
START = SoftStart(rate=20e5, dwell=0.3, settle=0.5)


@either
def test_a_log_replays_to_the_same_commands(bench, tmp_path):
    """With readings that come late or not at all, and samples that were left out."""
    rng = np.random.default_rng(3)

    def disturb():
        bench.clock.spend(rng.choice([0.0, 0.002, 0.035], p=[0.7, 0.28, 0.02]))
        if rng.random() < 0.03:
            raise NoAnswer("late")

    bench.device.before_read = disturb
    record = bench.loop(log=tmp_path / "log.csv", start=START).run()
    logged = read_log(tmp_path / "log.csv")
    assert logged["missed"].sum() > 3
    assert np.isnan(bench.sheet.values(logged, "theta")).sum() >= 3
    controller = type(bench.controller)(bench.plant, DT)
    again = Tracking(bench.plant, controller, bench.observer(), bench.reference, START.settle)
    here = np.isin(logged["phase"], (Phase.SETTLE, Phase.RUN))
    sent = bench.sheet.values(logged, "P_command")[here]
    np.testing.assert_allclose(replay(logged, again), sent, rtol=1e-12)
    np.testing.assert_array_equal(record.columns["P1_command"][here], sent[:, 0])


def test_columns_of_a_joint_have_no_numbers_and_those_of_an_arm_have(bench, tmp_path):
    """The names are a format: programs of others read them."""
    bench.loop(log=tmp_path / "log.csv").run()
    joint = (
        "t [s],theta [rad],P1 [Pa],P2 [Pa],P1_command [Pa],P2_command [Pa],phase,missed,late [s],took [s],read_at [s],"
        "sent,torque [Nm],theta_ref [rad],K_ref [Nm/rad],theta_estimate [rad],omega_estimate [rad/s],P1_estimate [Pa],"
        "P2_estimate [Pa],d_estimate [Nm],K_estimate [Nm/rad],rung,status,slack [rad],slack_force [N],"
        "moved_theta [rad],moved_K [Nm/rad],moved_T [Nm]"
    )
    assert (tmp_path / "log.csv").read_text().splitlines()[1] == joint
    arm = Arm.machine("arm26")
    hand = Sheet.of(replace(arm, endpoint=arm.bodies.endpoint))
    assert hand.fields["theta_ref"] == ("theta1_ref", "theta2_ref")
    assert hand.fields["P_command"] == tuple(f"P{j}_command" for j in range(1, 7))
    assert hand.fields["K_ref"] == ("Kx11_ref", "Kx12_ref", "Kx22_ref")
    assert "Kx12_estimate [N/m]" in hand.header.split(",")
    for sheet in (JOINT, hand, Sheet.of(arm)):
        assert Sheet.found(sheet.names).names == sheet.names


def test_a_row_of_an_arm_fills_its_columns_and_comes_back():
    sheet, K = Sheet.of(Arm.machine("arm26")), np.array([[3.0, 0.5], [0.5, 2.0]])
    P = tuple(1e5 * j for j in range(6))
    row = Row(0.0, np.array([0.1, 0.2]), P, P, 2, 0, 0.0, 0.0, K_ref=K, d_estimate=0.7)
    cells = sheet.cells(row)
    columns = {name: np.array([cell, cell]) for name, cell in zip(sheet.names, cells, strict=True)}
    np.testing.assert_array_equal(sheet.values(columns, "K_ref"), [K, K])
    np.testing.assert_array_equal(sheet.values(columns, "theta"), [[0.1, 0.2]] * 2)
    np.testing.assert_array_equal(sheet.values(columns, "P"), [P, P])
    np.testing.assert_array_equal(sheet.values(columns, "d_estimate"), [[0.7, 0.7]] * 2)
    assert np.isnan(sheet.values(columns, "P_estimate")).all()


@either
def test_a_record_is_a_run_that_can_be_kept(bench, tmp_path):
    record = bench.loop().run()
    record.save(tmp_path / "log.npz")
    run = load_recording(tmp_path / "log.npz")
    assert repr(run.plant) == repr(bench.plant)
    figures = metrics(run)
    theta, wanted = (record.values(name, (Phase.SETTLE, Phase.RUN)) for name in ("theta", "theta_ref"))
    np.testing.assert_allclose(figures.theta_rms, np.sqrt(np.mean((theta - wanted) ** 2, axis=0)) / DEG)
    assert figures.limits_kept, figures.violations
    with np.load(tmp_path / "log.npz") as archive:
        np.testing.assert_array_equal(archive["log_late"], record.columns["late"])


@either
def test_errors_of_a_record_are_those_of_measured_angles_and_of_the_model_at_measured_pressures(bench):
    record = bench.loop().run()
    begin = len(record.values("phase", (Phase.SETTLE,)))
    run, errors = record.run(), record.errors
    error = (run.K / run.K_ref - 1) * 100 if run.K.ndim == 1 else run.K - run.K_ref
    np.testing.assert_allclose(errors.K_rms, np.sqrt(np.mean(error[begin:] ** 2, axis=0)))
    np.testing.assert_allclose(np.multiply(errors.theta_rms, DEG), record.theta_rms)
    columns = dict(record.columns)
    name = next(name for name in ("theta", "theta2") if name in columns)
    columns[name] = np.full_like(columns[name], np.nan)
    blind = replace(record, columns=columns).errors
    assert np.isnan(np.ravel(blind.theta_rms)[-1])
    np.testing.assert_array_equal(np.ravel(blind.theta_rms)[:-1], np.ravel(errors.theta_rms)[:-1])
    assert np.isfinite(blind.K_rms).all()


@pytest.mark.parametrize("bench", ["arm"], indirect=True)
def test_what_is_of_an_arm_is_refused_where_a_joint_is_meant(bench, tmp_path):
    record = bench.loop(log=tmp_path / "log.csv").run()
    record.save(tmp_path / "log.npz")
    with pytest.raises(InvalidFile, match="is the recording of an arm"):
        frames(tmp_path / "log.npz")
    with pytest.raises(InvalidFile, match="is the log of an arm"):
        read_log_of_motion(tmp_path / "log.csv")
    run, hand = record.run(), replace(bench.plant, endpoint=bench.plant.bodies.endpoint)
    save_recording(replace(run, plant=hand), tmp_path / "hand.npz")
    assert load_recording(tmp_path / "hand.npz").plant.endpoint == hand.endpoint
    other = replace(bench.plant, endpoint=Endpoint.planar((0.1, 0.2)))
    with pytest.raises(InvalidInput, match="cannot be written to a file"):
        save_recording(replace(run, plant=other), tmp_path / "other.npz")


def test_an_unfinished_last_line_is_left_out(bench, tmp_path):
    path = tmp_path / "log.csv"
    bench.loop(log=path).run()
    whole = read_log(path)["t"]
    text = "".join(line for line in path.read_text().splitlines(keepends=True) if not line.startswith("# ended"))
    for cut in (1, 2, 50):
        path.write_text(text[:-cut])
        np.testing.assert_array_equal(read_log(path)["t"], whole[:-1])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "no line of column names"),
        ("t,theta\n1,2\n", "is no log of a loop"),
        (None, "cannot be read"),
    ],
)
def test_what_is_no_log_is_refused(tmp_path, text, said):
    path = tmp_path / "log.csv"
    if text is not None:
        path.write_text(text)
    with pytest.raises(InvalidFile, match=said):
        read_log(path)


def test_a_damaged_line_is_named(bench, tmp_path):
    path = tmp_path / "log.csv"
    bench.loop(log=path).run()
    lines = path.read_text().splitlines()
    phase = JOINT.names.index("phase")
    cells = lines[5].split(",")
    halves = ",".join([*cells[:phase], "nan", *cells[phase + 1 :]])
    damage = ("1,2,3", "has 3 cells, not"), (lines[5].replace(",0,", ",zero,", 1), "no number"), (halves, "whole")
    for broken, said in damage:
        path.write_text("\n".join([*lines[:5], broken, *lines[6:]]) + "\n")
        with pytest.raises(InvalidFile, match=f"line 6: .*{said}"):
            read_log(path)


def test_a_log_without_control_is_no_run(bench):
    columns = {name: column[:3] for name, column in bench.loop().run().columns.items()}
    with pytest.raises(InvalidInput, match="0 samples under control"):
        run_of(columns, bench.plant, DT)


def test_lateness_counts():
    late, missed = np.array([0.0, 0.0005, 0.002, 0.009]), np.array([0, 0, 3, 0])
    found = Lateness.of(late, missed, DT)
    assert (found.worst, found.late, found.missed, found.samples) == (0.009, 2, 3, 4)
    assert found.median == pytest.approx(0.00125)
    assert Lateness.of(late[:0], missed[:0], DT).samples == 0


@pytest.mark.compiles
@pytest.mark.slow
def test_an_uneven_clock_does_not_spoil_the_tracking(monkeypatch):
    """Readings up to 4 ms late at 100 Hz: an observer that took them for even ones would reject true angles."""
    real = RealPlant.standard()
    known = real.known()
    controller = TrackingMPC(real.nominal, DT, 20, Weights.calm(), compensation=known)

    def as_read(tick, _):
        return np.array([tick.reading.theta, np.nan, *tick.reading.P])

    def worst(at_due):
        clock, rng = SimulatedClock(), np.random.default_rng(1)
        device = SimulatedDevice(real, clock)
        read = device.read

        def late():
            clock.spend(0.004 * (rng.random() < 0.3))
            return read()

        monkeypatch.setattr(device, "read", late)
        observer = KalmanObserver(real.nominal, DT, compensation=known)
        reference = sine(amplitude=30 * DEG, K=5.6, duration=4.0, ramp=1.0)
        loop = RealTimeLoop(
            device, controller, observer, reference, clock=clock, start=SoftStart(2e5), watchdog=Watchdog(reaction=None)
        )
        if not at_due:
            monkeypatch.setattr(loop.tracking._projection, "at_due", as_read)
        return loop.run().theta_rms

    even = worst(at_due=True)
    assert even < 1 * DEG
    assert worst(at_due=False) > 2 * even


@pytest.mark.compiles
@pytest.mark.slow
@pytest.mark.parametrize("measured", [True, False], ids=["measured", "unmeasured"])
def test_an_arm_on_a_device_follows_as_in_a_simulation(measured):
    """Its circle after a soft start from no pressure and a second of settling, against a simulation from rest."""
    arm = Arm.machine("arm26")
    controller, observer = TrackingMPC(arm, DT), KalmanObserver(arm, DT)
    circle, clock = reference("circle", arm), SimulatedClock()
    x0 = arm.at_rest(circle.theta[0], circle.K[0])
    held = np.maximum(np.arange(-round(1 / DT), circle.t.size), 0)  # a second at its first point
    settled = Reference(DT * np.arange(held.size), circle.theta[held], circle.K[held], tail=circle.tail)
    simulated = simulate(RealArm(arm), controller, settled, x0=x0, observer=observer)
    after = simulated.t > 1.0 - DT / 2
    wanted = np.sqrt(np.mean((simulated.theta - simulated.theta_ref)[after] ** 2))
    device = SimulatedDevice(RealArm(arm), clock, measures_pressure=measured)
    start = SoftStart(present=None if measured else (0.0,) * arm.m)
    record = RealTimeLoop(device, controller, observer, circle, clock=clock, start=start).run()
    assert str(record.ending) == "finished"
    assert (record.columns["phase"] == Phase.RUN).sum() == circle.samples(DT) + 1  # without the tail
    assert np.sqrt(np.mean(record.theta_rms**2)) == pytest.approx(wanted, rel=0.1)
    assert np.max(record.theta_rms) < 0.2 * DEG


@pytest.mark.slow
@pytest.mark.parametrize("age", [-1e-4, 1e-3, 0.01])
def test_projected_angles_stay_on_the_steps_of_their_encoder(monkeypatch, age):
    """All readings of a real device are a tenth of a millisecond late: an observer took a 0.1° encoder for a fine one,
    and the velocity that it then believed threw out readings that were a sample old.
    """
    real, clock = replace(RealPlant.standard(), encoder=0.1 * DEG), SimulatedClock()
    known = real.known()
    controller = PIDControl(real.nominal, DT)
    observer = KalmanObserver(real.nominal, DT, compensation=known)
    device = SimulatedDevice(real, clock)
    read = device.read

    def dated():
        reading = read()
        clock.spend(max(-age, 0.0))
        return reading._replace(t=reading.t - age)

    monkeypatch.setattr(device, "read", dated)
    reference = sine(amplitude=20 * DEG, K=5.6, duration=2.0, ramp=1.0)
    record = RealTimeLoop(device, controller, observer, reference, clock=clock, start=SoftStart(2e5)).run()
    assert record.ending.reason is Reason.FINISHED
    assert observer.encoder_step == pytest.approx(0.1 * DEG)


@pytest.mark.parametrize(("left", "reason"), [(0.0, Reason.UNHEALTHY), (2.5 * BAR, Reason.FINISHED)])
def test_a_loop_without_supply_ends_before_its_muscles_jump_when_it_returns(left, reason):
    """A supply that has dropped, but moves the joint yet, does not end it."""
    real, clock = replace(RealPlant.standard(), faults=(SupplyDrop(3.0, supply=left),)), SimulatedClock()
    observer = KalmanObserver(real.nominal, DT, compensation=real.known())
    reference = sine(amplitude=20 * DEG, K=7.5, duration=6.0, ramp=1.0)
    device, controller = SimulatedDevice(real, clock), PIDControl(real.nominal, DT, real.known())
    record = RealTimeLoop(device, controller, observer, reference, clock=clock, start=START).run()
    assert record.ending.reason is reason
    assert any(suspect.fault is FaultKind.SUPPLY_DROP for suspect in record.health.suspects)
    if reason is Reason.UNHEALTHY:
        assert "the supply is lost: " in str(record.ending)
        stopped = record.columns["phase"] == Phase.STOP
        assert not record.columns["P1_command"][stopped].any()  # a ramp would fill it on the supply's return


def test_pressures_that_change_as_fast_as_they_can_are_no_fault():
    """Steps that keep the commands at 5 bar/s, as fast as the regulators fill, ended as a leak or a broken cable."""
    real, clock, t = RealPlant.standard((1.0, 1.0)), SimulatedClock(), np.arange(0.0, 7.0, DT)
    steps = Reference(
        t, np.interp(t, (2.0, 2.6, 4.0, 4.6), (-60 * DEG, 60 * DEG, 60 * DEG, -60 * DEG)), np.full(t.size, 5.5)
    )
    observer = KalmanObserver(real.nominal, DT, compensation=real.known())
    controller = PIDControl(real.nominal, DT, real.known())
    record = RealTimeLoop(SimulatedDevice(real, clock), controller, observer, steps, clock=clock, start=START).run()
    rates = np.abs(np.diff(record.columns["P1_command"])) / DT
    assert (rates > 4.99 * BAR).sum() * DT > 1.0
    assert str(record.ending) == "finished"


@pytest.mark.parametrize(("P", "lost"), [((0.5, 0.5), True), ((0.5, 4.0), False)])
def test_two_rejected_pressures_far_below_their_commands_are_a_lost_supply(P, lost):
    tracking = Tracking(Plant(), PIDControl(Plant(), DT), Differentiator(DT), sine(duration=1.0, ramp=0.2))
    rejected = [Finding((Suspect(FaultKind.REJECTED_SENSOR, part),), 0.0) for part in (Part.P1, Part.P2)]
    tick = Tick(1, 0, Reading(0.0, 0.1, tuple(p * BAR for p in P)), (0.5 * BAR, 6.0 * BAR), 0.0)
    for findings in (rejected[:1], rejected):
        tracking.observer = SimpleNamespace(health=Health(tuple(findings)))
        assert tracking._starved(tick) == (lost and findings is rejected)
