"""The loop's order: soft start, samples on their deadlines, and a safe stop whatever ends it."""

import errno
import os
import re

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import CannotWrite, InvalidInput
from mpc import KalmanObserver
from mpc.bench.cycle import Overrun, Phase
from mpc.bench.device import DeviceLost, NoAnswer
from mpc.bench.logs import read_log
from mpc.bench.safety import Action, Reason, RefusedStart, SafeStop, SoftStart, Watchdog

pytestmark = pytest.mark.parametrize("bench", ["joint", "arm"], indirect=True)

DT = 0.01
FIRST_CONTROLLED = 20  # about: samples of the soft start of these tests


def after(n, do):
    """A function that does `do` from its n-th call on, every time."""
    calls = iter(range(10**9))

    def called():
        if next(calls) >= n:
            do()

    return called


def fail(error):
    def raising(*_):
        raise error

    return raising


def angles_of(record):
    """Return the measured angles (N, n)."""
    return record.values("theta", tuple(Phase)).reshape(record.columns["t"].size, -1)


def turned(reading, angle):
    """Return a reading with another angle of the last joint."""
    several = np.ndim(reading.theta) > 0
    return reading._replace(theta=np.array([*reading.theta[:-1], angle]) if several else float(angle))


def ended_safely(bench):
    """The last command is no pressure, and the pressures before it fell."""
    assert bench.device.commands[-1] == (0.0,) * bench.plant.m
    assert bench.device.vents >= 1


# --- a run that nothing disturbs -----------------------------------------------------------------------------------


def test_a_run_starts_softly_follows_and_ends_without_pressure(bench):
    record = bench.loop().run()
    assert record.ending.reason is Reason.FINISHED
    assert record.ending.delivered
    ended_safely(bench)
    assert np.max(record.theta_rms) < 1 * DEG
    phases = record.columns["phase"]
    assert (np.diff(phases) >= 0).all()
    assert set(phases) == set(Phase)
    rest = bench.plant.at_rest(bench.reference.theta[0], bench.reference.K[0])
    first, target = np.array(bench.device.commands[0]), rest[2 * bench.plant.n :]
    assert abs(first - 2 * BAR).max() <= 5 * BAR * DT * (1 + 1e-9)  # from where they are, at the rate
    last = np.flatnonzero(phases == Phase.RAMP)[-1]
    np.testing.assert_allclose(record.values("P_command", tuple(Phase))[last], target)


def test_samples_are_on_absolute_deadlines(bench):
    record = bench.loop().run()
    t = record.columns["t"][record.columns["phase"] != Phase.STOP]
    np.testing.assert_allclose(t, DT * np.arange(t.size), atol=1e-9)
    assert record.lateness.worst < 1e-9
    assert record.lateness.missed == 0


def test_no_command_leaves_the_supply_or_the_slew_limit(bench):
    bench.loop().run()
    u = np.array(bench.device.commands[:-1])
    low, high = bench.plant.pressure_limits
    assert (u >= low).all()
    assert (u <= high).all()
    assert np.abs(np.diff(u, axis=0)).max() <= 10 * BAR * DT * (1 + 1e-9)


def test_the_log_says_what_the_record_says(bench, tmp_path):
    record = bench.loop(log=tmp_path / "log.csv").run()
    logged = read_log(tmp_path / "log.csv")
    for name, column in record.columns.items():
        np.testing.assert_array_equal(logged[name], column)
    assert "# ended: finished; ramp: done" in (tmp_path / "log.csv").read_text()


@pytest.mark.parametrize("action", list(Action))
def test_what_happens_at_the_end_is_what_was_asked_for(bench, action):
    record = bench.loop(stop=SafeStop(action)).run()
    controlled = record.columns["phase"] != Phase.STOP
    last = tuple(record.values("P_command", tuple(Phase))[controlled][-1].tolist())
    n = int(controlled.sum())
    if action is Action.HOLD:
        assert bench.device.commands[n:] == [last]
    elif action is Action.VENT:
        assert bench.device.commands[n:] == [(0.0,) * bench.plant.m]
    else:
        falling = np.array([last, *bench.device.commands[n:]])
        assert (np.diff(falling, axis=0) <= 1e-6).all()
        assert np.abs(np.diff(falling, axis=0)).max() <= 1 * BAR * DT * (1 + 1e-6)
        shares = falling[:-2] / falling[:-2].max(axis=1, keepdims=True)
        np.testing.assert_allclose(shares, np.tile(shares[0], (len(shares), 1)), rtol=1e-6)  # the angles stay


# --- starts that are refused ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda r: turned(r, 3.0), ("the angle 171.9° is outside", "the angle 171.9° of elbow is outside")),
        (
            lambda r: r._replace(P=(*r.P[:-1], 7 * BAR)),
            ("P2 = 7.00 bar is outside the supply's", "P6 = 7.00 bar of biarticular extensor is outside the supply's"),
        ),
        (lambda r: turned(r, np.nan), (r"it measures no angle\)", r"it measures no angle of elbow\)")),
        (lambda r: r._replace(theta=np.nan), (r"no angle\)", r"no angle of shoulder and of elbow\)")),
        (
            lambda r: r._replace(P=(np.nan,) * len(r.P)),
            (r"present=\(P1, P2\).* \(0:0 after venting", r"present=\(P1, …, P6\).* \(0:0:0:0:0:0 after venting"),
        ),
    ],
)
def test_a_start_is_refused_where_the_joint_is_not_where_it_may_be(bench, changed, said):
    bench.device.changed = changed
    with pytest.raises(RefusedStart, match=said[bench.plant.n - 1]):
        bench.loop().run()
    assert bench.device.commands == []


def test_present_pressures_have_to_be_given_for_all_muscles_and_possible(bench):
    bench.device.changed = lambda r: r._replace(P=(np.nan, *r.P[1:]))
    with pytest.raises(RefusedStart, match=r"does not measure P1: give the values of all pressures, SoftStart"):
        bench.loop().run()
    with pytest.raises(RefusedStart, match=r"P1 = 70.00 bar.* is outside the supply's range"):
        bench.loop(start=SoftStart(present=(70 * BAR,) * bench.plant.m)).run()
    assert bench.device.commands == []


def test_a_start_without_any_answer_is_refused(bench):
    bench.device.before_read = fail(NoAnswer("nothing came"))
    with pytest.raises(RefusedStart, match="nothing came"):
        bench.loop().run()
    assert bench.device.commands == []


def test_pressures_that_nobody_measures_have_to_be_said(bench):
    bench.device.changed = lambda r: r._replace(P=(float("nan"),) * bench.plant.m)
    start = SoftStart(rate=5 * BAR, dwell=0.1, settle=0.1, present=(2 * BAR,) * bench.plant.m)
    record = bench.loop(start=start).run()
    assert record.ending.reason is Reason.FINISHED
    assert np.abs(np.array(bench.device.commands[0]) - 2 * BAR).max() <= 5 * BAR * DT * (1 + 1e-9)
    assert np.max(record.theta_rms) < 1 * DEG


# --- late samples --------------------------------------------------------------------------------------------------


def late_by(bench, duration, at=60):
    """The controller's step `at` takes a `duration` [s]."""
    step, calls = bench.controller.step, iter(range(10**9))

    def slow(*arguments):
        if next(calls) == at:
            bench.clock.spend(duration)
        return step(*arguments)

    bench.controller.step = slow


def test_samples_that_are_over_are_left_out_and_the_reference_goes_on(bench):
    loop = bench.loop()
    late_by(bench, 0.05)
    record = loop.run()
    columns = record.columns
    assert record.ending.reason is Reason.FINISHED
    assert columns["missed"].sum() == 4
    gap = int(np.argmax(columns["missed"]))
    assert columns["t"][gap] - columns["t"][gap - 1] == pytest.approx(0.05, abs=1e-9)
    here = columns["phase"] == Phase.RUN
    begun = columns["t"][here][0]
    theta_ref, theta = record.values("theta_ref", (Phase.RUN,)), bench.reference.theta
    if theta.ndim > 1:
        theta_ref, theta = theta_ref[:, 0], theta[:, 0]
    wanted = np.interp(columns["t"][here] - begun, bench.reference.t, theta)
    np.testing.assert_allclose(theta_ref, wanted, atol=1e-3)  # by the clock, not by the count
    assert np.max(record.theta_rms) < 1 * DEG


def test_samples_can_be_caught_up_with(bench):
    loop = bench.loop(overrun=Overrun.CATCH_UP)
    late_by(bench, 0.05)
    record = loop.run()
    assert record.columns["missed"].sum() == 0
    late = record.columns["late"]
    i = int(np.argmax(late))
    np.testing.assert_allclose(late[i : i + 5], [0.04, 0.03, 0.02, 0.01, 0.0], atol=1e-9)


def test_a_late_sample_can_end_the_loop(bench):
    loop = bench.loop(overrun=Overrun.STOP)
    late_by(bench, 0.05)
    record = loop.run()
    assert record.ending.reason is Reason.LATE
    ended_safely(bench)


@pytest.mark.parametrize("what", ["device", "controller"])
def test_missed_samples_are_no_silent_sensors_and_end_the_loop_in_time(bench, what):
    """Half a second after the observer has become blind, however few samples there are in it."""
    loop = bench.loop(observer=KalmanObserver(bench.plant, DT))
    spend = after(30, lambda: bench.clock.spend(0.13))
    if what == "device":
        bench.device.before_read = spend
    else:
        step = bench.controller.step
        bench.controller.step = lambda *arguments: (spend(), step(*arguments))[1]
    record = loop.run()
    assert record.ending.reason is Reason.LATE
    assert re.fullmatch(r"\d+ of the last second; controller or device take too long", record.ending.message)
    columns = record.columns
    first = columns["t"][np.argmax(columns["missed"] > 0)]
    assert columns["t"][columns["phase"] == Phase.STOP][0] - first < 1.2
    ended_safely(bench)


def test_a_system_that_oversleeps_leaves_samples_out(bench):
    sleep, calls = bench.clock.sleep_until, iter(range(10**9))

    def oversleep(t):
        sleep(t + (0.034 if next(calls) == 80 else 0.0))

    bench.clock.sleep_until = oversleep
    columns = bench.loop().run().columns
    assert columns["missed"].sum() == 3
    assert columns["late"].max() < DT


# --- devices that fail ---------------------------------------------------------------------------------------------


def test_a_few_missing_readings_do_not_end_a_run(bench):
    calls = iter(range(10**9))

    def sometimes():
        if next(calls) % 7 == 3:
            raise NoAnswer("late")

    bench.device.before_read = sometimes
    record = bench.loop().run()
    assert record.ending.reason is Reason.FINISHED
    assert 0.1 < np.isnan(angles_of(record)).all(axis=1).mean() < 0.2
    assert np.max(record.theta_rms) < 1.5 * DEG


def test_silence_ends_the_loop_by_a_ramp(bench):
    bench.device.before_read = after(60, fail(NoAnswer("silent")))
    record = bench.loop(watchdog=Watchdog(silence=0.2)).run()
    assert record.ending.reason is Reason.SILENT
    silent = np.isnan(angles_of(record)).all(axis=1) & (record.columns["phase"] != Phase.STOP)
    assert silent.sum() == pytest.approx(20, abs=1)
    ended_safely(bench)


def test_one_silent_encoder_of_several_does_not_end_the_loop(bench):
    """It is the observer's affair; without any angle the loop is blind."""
    bench.device.changed = lambda r: r if r.t < 0.6 else turned(r, np.nan)
    record = bench.loop().run()
    assert record.ending.reason is (Reason.FINISHED if bench.plant.n > 1 else Reason.SILENT)
    assert np.isnan(angles_of(record)[-1, -1])
    ended_safely(bench)


@pytest.mark.parametrize("since", [0.05, 0.93])  # soon, and at the end, of a soft start of a second
def test_an_encoder_that_falls_silent_before_the_observer_runs_ends_the_loop(bench, since):
    bench.device.changed = lambda r: r if r.t < since else turned(r, np.nan)
    record = bench.loop(start=SoftStart(rate=100 * BAR, dwell=1.0, settle=0.1)).run()
    assert record.ending.reason is Reason.SILENT
    silent = "no angle of elbow" if bench.plant.n > 1 else "no angle"
    assert f"{silent} was read for 0.2" in record.ending.message
    assert not np.isin(record.columns["phase"], [Phase.SETTLE, Phase.RUN]).any()
    ended_safely(bench)


def test_an_encoder_of_each_joint_has_a_zero(bench, tmp_path):
    zero = np.array([3.0, -4.0]) * DEG if bench.plant.n > 1 else 3 * DEG
    bench.device.changed = lambda r: r._replace(theta=r.theta + zero)
    record = bench.loop(zero=zero, log=tmp_path / "log.csv").run()
    assert np.max(record.theta_rms) < 1 * DEG
    remarks = [line for line in (tmp_path / "log.csv").read_text().splitlines() if "encoder zero" in line]
    assert remarks == [
        f"# encoder zero {float(one)!r} rad ({one / DEG:.4g}°), subtracted from {name}"
        for one, name in zip(np.ravel(zero), bench.sheet.fields["theta"], strict=True)
    ]
    with pytest.raises(InvalidInput, match="zero = "):
        bench.loop(zero=np.zeros(3))


def test_present_pressures_are_as_many_as_muscles(bench):
    with pytest.raises(InvalidInput, match=f"has to be m = {bench.plant.m} pressures"):
        bench.loop(start=SoftStart(present=(0.0,) * 4))


def test_a_reading_that_repeats_itself_counts_as_none(bench):
    bench.device.changed = lambda r: r if r.t < 0.5 else r._replace(t=0.5)
    record = bench.loop().run()
    assert record.ending.reason is Reason.SILENT
    ended_safely(bench)


@pytest.mark.parametrize(("off", "said"), [(-0.5, "0.5 s before"), (1.7e9, "1.7e+09 s after")])
def test_readings_of_another_time_are_refused_and_count_as_none(bench, off, said):
    """A queue of old readings, or a clock that is not the loop's."""
    bench.device.changed = lambda r: r._replace(t=r.t + off)
    with pytest.raises(RefusedStart, match=re.escape(f"dated {said} the present time of the loop's clock")):
        bench.loop().run()
    assert bench.device.commands == []
    bench.device.changed = lambda r: r if bench.clock.now() < 1.0 else r._replace(t=r.t + off)
    record = bench.loop().run()
    assert record.ending.reason is Reason.SILENT
    assert said in record.ending.message
    ended_safely(bench)


def test_a_device_that_takes_commands_late_ends_the_loop(bench):
    bench.device.before_write = after(60, lambda: bench.clock.spend(0.5))
    record = bench.loop().run()
    assert record.ending.reason is Reason.SILENT
    assert record.ending.message == "the device took no command for 0.5 s"
    ended_safely(bench)


def test_a_device_that_takes_no_commands_ends_the_loop(bench):
    bench.device.before_write = after(60, fail(NoAnswer("busy")))
    record = bench.loop().run()
    assert record.ending.reason is Reason.SILENT
    assert "took no command" in record.ending.message
    assert (record.columns["sent"] == 0).sum() >= 20
    ended_safely(bench)  # it still takes the vent


@pytest.mark.parametrize("where", ["before_read", "before_write"])
def test_a_lost_device_is_vented_if_that_still_works(bench, where):
    setattr(bench.device, where, after(60, fail(DeviceLost("unplugged"))))
    record = bench.loop().run()
    assert record.ending.reason is Reason.DEVICE
    assert "unplugged" in str(record.ending)
    assert record.ending.action is Action.VENT
    ended_safely(bench)


def test_a_loop_that_ended_in_the_soft_start_has_no_errors(bench):
    bench.device.before_read = after(25, fail(DeviceLost("unplugged")))  # with some samples of settling
    record = bench.loop().run()
    with pytest.raises(InvalidInput, match=r"ended before it followed its reference \(device lost: unplugged\)"):
        record.theta_rms  # noqa: B018


def test_a_device_that_takes_nothing_more_is_said_to(bench):
    loop = bench.loop()
    bench.device.before_read = after(60, fail(DeviceLost("unplugged")))
    bench.device.vent = fail(DeviceLost("unplugged"))
    assert not loop.run().ending.delivered


@pytest.mark.parametrize(
    ("garbage", "action"),
    [
        (lambda r: turned(r, 1e9), Action.RAMP),
        (lambda r: turned(r, float("-inf")), None),
        (lambda r: r._replace(P=(9e9, *r.P[1:])), Action.VENT),
        (lambda r: r._replace(t=float("nan")), None),
    ],
)
def test_garbage_is_not_followed(bench, garbage, action):
    bench.device.changed = lambda r: r if r.t < 0.6 else garbage(r)
    record = bench.loop().run()
    assert record.ending.reason in (Reason.LIMIT, Reason.SILENT)
    assert action is None or record.ending.action is action
    ended_safely(bench)
    assert np.isfinite(bench.device.commands).all()


# --- programs that fail --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("error", [ZeroDivisionError("in the controller"), MemoryError(), SystemExit(7)])
def test_an_error_of_the_controller_is_raised_after_the_safe_stop(bench, tmp_path, error):
    loop = bench.loop(log=tmp_path / "log.csv")
    bench.controller.step = fail(error)
    with pytest.raises(type(error)):
        loop.run()
    ended_safely(bench)
    assert loop.cycle.ending.reason is Reason.ERROR
    assert read_log(tmp_path / "log.csv")["t"].size == len(bench.device.commands) - bench.device.vents


def test_a_command_that_is_no_number_is_not_sent(bench):
    loop = bench.loop()
    step = bench.controller.step
    calls = iter(range(10**9))

    def broken(*arguments):
        plan = step(*arguments)
        if next(calls) > 30:
            object.__setattr__(plan, "u", np.full((10, bench.plant.m), np.nan))
        return plan

    bench.controller.step = broken
    assert loop.run().ending.reason is Reason.COMMAND
    assert np.isfinite(bench.device.commands).all()
    ended_safely(bench)


def test_a_program_can_stop_a_loop_and_insist(bench, tmp_path):
    loop = bench.loop(log=tmp_path / "log.csv")
    stops = after(60, loop.stop)
    bench.device.before_read = stops  # at every reading: the second one makes the ramp a vent
    record = loop.run()
    assert record.ending.reason is Reason.REQUESTED
    assert (record.columns["phase"] == Phase.STOP).sum() <= 1
    treated = "ramp, cut short (a vent was requested), then vent"
    assert record.ending.treatment == treated
    assert f"# ended: stopped by the program; {treated}: done" in (tmp_path / "log.csv").read_text()
    ended_safely(bench)


def test_a_disk_that_fills_up_ends_the_loop_and_leaves_whole_lines(bench, tmp_path, monkeypatch):
    room, write = [20_000], os.write

    def limited(file, data):
        taken = data[: room[0]]
        if not taken:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        room[0] -= len(taken)
        return write(file, taken)

    loop = bench.loop(log=tmp_path / "log.csv")
    monkeypatch.setattr("mpc.bench.record.os.write", limited)
    record = loop.run()
    assert record.ending.reason is Reason.LOG
    ended_safely(bench)
    logged = read_log(tmp_path / "log.csv")
    n = logged["t"].size
    assert n > 10
    np.testing.assert_array_equal(logged["P1_command"], record.columns["P1_command"][:n])
    assert (record.columns["phase"][n + 1 :] == Phase.STOP).all()  # one sample was run that did not fit
    assert (tmp_path / "log.csv").read_text().endswith("\n")


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="only Linux has /dev/full, a disk that is always full")
def test_a_full_disk_ends_it_before_anything_moves(bench):
    with pytest.raises(CannotWrite, match="No space left"):
        bench.loop(log="/dev/full").run()
    assert bench.device.commands == []


def test_a_limp_joint_beyond_its_range_is_led_into_it_but_not_left_there(bench):
    left = np.ravel(bench.plant.angle_limits[0])[-1]
    bench.device.changed = lambda r: turned(r, left - 5 * DEG) if r.t < 0.05 else r
    assert bench.loop().run().ending.reason is Reason.FINISHED
    bench.device.commands.clear()
    bench.device.changed = lambda r: turned(r, left - 5 * DEG)
    record = bench.loop().run()
    assert record.ending.reason is Reason.LIMIT
    assert not np.isin(record.columns["phase"], (Phase.SETTLE, Phase.RUN)).any()
    ended_safely(bench)


# --- endings of the loop's own choice ------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("stop", [None, SafeStop(Action.VENT)])
def test_an_ending_that_asks_to_hold_leaves_no_pressure_behind(bench, stop):
    """Half of the readings are missing: the observer asks to hold, and the loop ends in the safe stop."""
    calls = iter(range(10**9))

    def every_other():
        if next(calls) % 2:
            raise NoAnswer("late")

    bench.device.before_read = every_other
    loop = bench.loop(observer=KalmanObserver(bench.plant, DT, compiled=False), stop=stop)
    record = loop.run()
    assert record.ending.reason is Reason.UNHEALTHY
    assert record.ending.action is (Action.RAMP if stop is None else Action.VENT)
    ended_safely(bench)
