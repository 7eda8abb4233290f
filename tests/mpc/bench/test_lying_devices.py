"""Devices that raise anything and say anything: whatever they do, the last thing that the hardware gets is a vent.

The judge is the hardware: `Valves` keep what was delivered to them, whatever the loop believes.
"""

from contextlib import nullcontext
from itertools import product

import numpy as np
import pytest

from allocator import BAR
from mpc import Plant
from mpc.bench.cycle import Cycle, Decision, Phase, Settings
from mpc.bench.device import CallableDevice, DeviceError, DeviceLost, NoAnswer, Reading, SimulatedClock
from mpc.bench.logs import read_log
from mpc.bench.safety import Guard, Reason, RefusedStart, SafeStop, SoftStart, Watchdog
from mpc.bench.sweep import Sweep, Visit
from mpc.model.arm.model import Arm
from mpc.observer.base import Differentiator

DT = 0.01
PLANT, ARM = Plant(), Arm.machine("arm26")
MACHINES = {"joint": PLANT, "arm": ARM}
FOREVER = 10**9


class Interrupt(BaseException):
    """Exception that a framework raises to leave a program, outside `Exception`."""


class Unprintable(Exception):
    """Object whose repr raises."""

    def __str__(self):
        raise RuntimeError


EXCEPTIONS = (
    OSError(5, "Input/output error"), ValueError("no number"), TypeError("NoneType"), TimeoutError("late"),
    MemoryError(), KeyboardInterrupt(), BrokenPipeError(32, "Broken pipe"), SystemExit(1), GeneratorExit(),
    StopIteration(), RecursionError("deep"), AssertionError(), ZeroDivisionError(), UnicodeError("x"),
    ConnectionResetError(104, "reset"), DeviceError("refused"), DeviceLost("unplugged"), NoAnswer("silent"),
    RefusedStart("no"), Interrupt(), Unprintable(),
)  # fmt: skip
GARBAGE = (
    None, "", "2.3", b"2", 1j, (), (1.0,) * 2, (1.0,) * 4, (1.0, (2e5, 3e5), 1.0), [[0.1, 2e5, 2e5]], {}, object(),
    float("nan"), float("inf"), -float("inf"), 1e300, 10**400, np.array("x"), np.full((3, 3), 0.1),
    (float("nan"),) * 3, (0.1, float("inf"), 2e5), (0.1, 1e300, 2e5), (0.1, None, 2e5), (0.1, "2e5", 2e5), ValueError,
    Reading(None, None), Reading("0", 0.1, (2e5, 2e5)), Reading(0.0, "0.1", (2e5, 2e5)),
    Reading(0.0, 0.1, (None, None)), Reading(0.0, 0.1, 2e5), Reading(0.0, 0.1, (2e5, 2e5, 2e5)),
    Reading(float("nan"), 0.1, (2e5, 2e5)), Reading(float("inf"), 0.1, (2e5, 2e5)), Reading(1e300, 0.1, (2e5, 2e5)),
    Reading(0.0, 1j), Reading(np.array([0.0, 1.0]), np.array([0.1, 0.1])), Reading(10**400, 0.1, (2e5, 2e5)),
)  # fmt: skip
GARBAGE_OF_ARM = (
    (0.1, 0.1, *(2e5,) * 5), (0.1, 0.1, *(2e5,) * 7), (0.1, 0.1, *(2e5,) * 5, None), Reading(0.0, (0.1,), (2e5,) * 6),
    Reading(0.0, 0.1, (2e5,) * 6), Reading(0.0, (0.1, "0.1"), (2e5,) * 6), Reading(0.0, (0.1, 0.1, 0.1), (2e5,) * 6),
    Reading(0.0, np.full((2, 1), 0.1), (2e5,) * 6), Reading(0.0, np.array([0.1, 1j]), (2e5,) * 6), Reading(0.0, (), ()),
    Reading(0.0, np.array([0.1, None]), (2e5,) * 6), Reading(0.0, "ab", (2e5,) * 6), Reading(0.0, (0.1, 10**400), ()),
    Reading(0.0, np.full(2, 0.1), np.full(6, 9e9)), Reading(0.0, (0.1, -float("inf")), (2e5,) * 6),
)  # fmt: skip
WHEN = {"start": 0, "ramp": 10, "motion": 80, "stop": 215}  # calls before the first that fails
HOW_OFTEN = (1, 2, FOREVER)


class Valves:
    """The valves of a machine behind two functions, of which some calls fail before anything reaches the hardware."""

    def __init__(self, machine=PLANT):
        self.clock, self.machine = SimulatedClock(), machine
        self.P = self.before = (2 * BAR,) * machine.m
        self.vented = self.commanded = False
        self.calls = dict.fromkeys(("read", "write", "vent", "watch"), 0)
        self.written = []
        self.faults = {}  # by call: (first, number, what to do)

    def fail(self, call, first, number, do):
        self.faults[call] = first, number, do
        return self

    def _called(self, call):
        n = self.calls[call]
        self.calls[call] += 1
        first, number, do = self.faults.get(call, (FOREVER, 0, None))
        return do() if first <= n < first + number else None

    def read(self):
        said = self._called("read")
        theta = np.full(self.machine.angle_shape, 0.1) if self.machine.angle_shape else 0.1
        return Reading(self.clock.now(), theta, self.P) if said is None else said[0]

    def write(self, *P):
        self.commanded = True
        self._called("write")
        self.P, self.vented = P, False
        self.written.append(self.P)

    def vent(self):
        self._called("vent")
        self.P, self.vented = (0.0,) * self.machine.m, True

    def watch(self, row):
        self._called("watch")

    @property
    def safe(self):
        """True if the last delivery was a vent; a start without commands leaves the valves as they were."""
        return self.vented or (not self.commanded and self.P == self.before)


class Raw(CallableDevice):
    """A device of somebody else's, which checks nothing."""

    def read(self):
        return self._read()


class Sine:
    """Two seconds of commands to follow."""

    dt = DT

    def __init__(self, machine=PLANT):
        self.first = 2.5 * BAR, *(1.5 * BAR,) * (machine.m - 1)

    def decide(self, tick):
        if tick.k > 150:
            return None
        return Decision((self.first[0] + 0.5 * BAR * float(np.sin(tick.k / 30)), *self.first[1:]), Phase.RUN)


def raising(error):
    def do():
        raise error

    return do


def run(valves, kind=CallableDevice, log=None, source=None, stop=None):
    """Run a loop on `valves`; return the cycle, and what was raised."""
    device = kind(valves.read, valves.write, valves.vent, clock=valves.clock, machine=valves.machine)
    settings = Settings(
        start=SoftStart(2 * BAR, dwell=0.1),
        stop=SafeStop(rate=2 * BAR) if stop is None else stop,
        watchdog=Watchdog(stall=30.0),  # nothing hangs here; a busy machine may pause for over a second
    )
    cycle = Cycle(
        device,
        source or Sine(valves.machine),
        valves.machine,
        settings,
        clock=valves.clock,
        watch=valves.watch,
        log=log,
    )
    try:
        cycle.run()
    except BaseException as error:  # whatever it is, it is judged by what the valves got
        return cycle, error
    return cycle, None


def unsafe(cases):
    """Return the cases whose valves were not vented at the end."""
    return [name for name, valves, kind in cases if not (run(valves, kind), valves.safe)[1]]


def of_exceptions(call, when, machine):
    for error, number in product(EXCEPTIONS, HOW_OFTEN):
        valves = Valves(machine).fail(call, WHEN[when], number, raising(error))
        yield f"{call} {when} {error!r} x{number}", valves, Raw


def of_garbage(kind, when, machine):
    for said, number in product((*GARBAGE, *GARBAGE_OF_ARM), HOW_OFTEN):
        valves = Valves(machine).fail("read", WHEN[when], number, lambda said=said: [said])
        yield f"{kind.__name__} {when} {said!r:.40} x{number}", valves, kind


def of_stubborn_vents(call, when):
    for error, number, refused in product(EXCEPTIONS, (1, 4), (1, 5)):
        valves = Valves().fail(call, WHEN[when], number, raising(error)).fail("vent", 0, refused, raising(error))
        yield f"{call} {when} {error!r} x{number}, vent x{refused}", valves, Raw


@pytest.mark.parametrize("machine", MACHINES)
def test_nothing_but_the_trajectory_ends_an_honest_loop(machine):
    valves = Valves(MACHINES[machine])
    cycle, error = run(valves)
    assert error is None
    assert valves.safe
    phases = cycle.recorder.columns["phase"]
    first_of_stop = int(np.argmax(phases == Phase.STOP))
    assert phases[WHEN["ramp"]] == Phase.RAMP
    assert phases[WHEN["motion"]] == Phase.RUN
    assert first_of_stop < WHEN["stop"] < phases.size


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("call", ["read", "write", "watch"])
def test_whatever_a_call_raises_the_muscles_are_vented(call, when, machine):
    assert unsafe(of_exceptions(call, when, MACHINES[machine])) == []


@pytest.mark.parametrize("machine", MACHINES)
@pytest.mark.parametrize("when", WHEN)
@pytest.mark.parametrize("kind", [CallableDevice, Raw])
def test_whatever_a_reading_says_the_muscles_are_vented(kind, when, machine):
    assert unsafe(of_garbage(kind, when, MACHINES[machine])) == []


def test_an_arm_is_not_measured_by_wrong_numbers():
    """The sizes are those of the machine; NaN in place of a row means that none of it was measured."""
    guard = Guard(ARM, DT, Watchdog(), 0.0)
    for said in GARBAGE_OF_ARM[3:8]:
        with pytest.raises(DeviceError, match="Reading"):
            guard.checked(said)
    nothing = guard.checked(Reading(0.5))
    assert (nothing.t, nothing.theta.shape, len(nothing.P)) == (0.5, (2,), 6)
    assert np.isnan([*nothing.theta, *nothing.P]).all()
    read = guard.checked(Reading(0.5, [0.1, np.nan], np.arange(6)))
    assert guard.lacking(read) == "no angle of elbow"
    assert read.P == tuple(map(float, range(6)))


@pytest.mark.parametrize(("call", "when"), list(product(("read", "write", "watch"), ("motion", "stop"))))
def test_a_vent_that_fails_is_insisted_upon(call, when):
    assert unsafe(of_stubborn_vents(call, when)) == []


# --- how it ends ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["read", "write", "watch"])
def test_the_exception_is_raised_and_the_log_says_how_it_ended(call, tmp_path):
    for k, error in enumerate(EXCEPTIONS):
        log = tmp_path / f"{k}.csv"
        cycle, raised = run(Valves().fail(call, WHEN["motion"], FOREVER, raising(error)), Raw, log=log)
        if not isinstance(error, KeyboardInterrupt | DeviceError):
            assert raised is error
        assert cycle.ending is not None
        assert cycle.ending.reason is not Reason.FINISHED
        assert log.read_text().splitlines()[-1].startswith(f"# ended: {cycle.ending.reason}")
        assert read_log(log)["t"].size >= WHEN["motion"] - 1


def test_a_cable_that_is_pulled_ends_in_a_ramp_and_not_in_a_jolt():
    """Without an encoder the valves still obey: the pressures fall at the rate asked for, then comes the vent."""
    valves = Valves().fail("read", WHEN["motion"], FOREVER, raising(OSError(5, "Input/output error")))
    cycle, raised = run(valves, Raw)
    assert isinstance(raised, OSError)
    assert cycle.ending.reason is Reason.DEVICE
    assert "read() raised OSError: [Errno 5] Input/output error" in cycle.ending.message
    assert valves.safe
    falling = np.array(valves.written[WHEN["motion"] - 1 :])
    assert (np.diff(falling, axis=0) <= 0).all()
    assert np.abs(np.diff(falling, axis=0)).max() <= 2 * BAR * DT * (1 + 1e-6)
    assert falling[-1].max() < 0.01 * BAR


def test_an_encoder_that_hangs_during_the_ramp_is_not_read_again_and_makes_no_jolt():
    valves = Valves()
    valves.fail("read", 200, FOREVER, lambda: valves.clock.spend(1.0))  # in the ramp after the sine
    cycle, _ = run(valves)
    assert cycle.ending.reason is Reason.FINISHED
    assert valves.calls["read"] <= 201
    falling = np.array(valves.written[valves.calls["read"] - 10 :])
    assert np.abs(np.diff(falling, axis=0)).max() <= 2 * BAR * DT * (1 + 1e-6)
    assert falling[-1].max() < 0.01 * BAR


def test_a_display_that_fails_is_not_asked_again_and_the_ramp_goes_on():
    valves = Valves().fail("watch", WHEN["motion"], FOREVER, raising(BrokenPipeError(32, "Broken pipe")))
    cycle, raised = run(valves)
    assert isinstance(raised, BrokenPipeError)
    assert "watch() raised BrokenPipeError" in cycle.ending.message
    assert valves.calls["watch"] == WHEN["motion"] + 1
    assert max(valves.written[-1]) < 0.01 * BAR


def test_valves_that_cannot_vent_are_commanded_to_the_lowest_pressure(tmp_path):
    log = tmp_path / "log.csv"
    valves = Valves().fail("vent", 0, FOREVER, raising(RuntimeError("no vent here")))
    valves.fail(
        "read", WHEN["motion"], 1, lambda: [Reading(valves.clock.now(), 0.1, (9e9, 2e5))]
    )  # which asks for a vent
    cycle, _ = run(valves, log=log)
    assert valves.P == (0.0, 0.0)
    assert valves.calls["vent"] >= 3
    assert not cycle.ending.delivered
    assert "no vent here" in log.read_text().splitlines()[-1]


def test_a_device_that_takes_nothing_ever_again_is_given_up_in_seconds():
    valves = Valves()
    for call in ("write", "vent"):
        valves.fail(call, WHEN["motion"] if call == "write" else 0, FOREVER, raising(OSError(5, "gone")))
    before = WHEN["motion"] * DT
    cycle, raised = run(valves)
    assert isinstance(raised, OSError)
    assert not cycle.ending.delivered
    assert valves.calls["vent"] >= 3
    assert valves.clock.now() - before < 3.0


def test_a_close_that_fails_does_not_hide_why_the_loop_ended():
    valves = Valves().fail("read", WHEN["motion"], FOREVER, raising(ValueError("the cause")))
    device = Raw(valves.read, valves.write, valves.vent, close=raising(OSError(5, "on closing")), clock=valves.clock)
    cycle = Cycle(device, Sine(), PLANT, Settings(start=SoftStart(2 * BAR)), clock=valves.clock)
    with pytest.raises(ValueError, match="the cause"):
        cycle.run()
    assert valves.safe


def test_a_hold_is_kept_only_if_it_was_asked_for_by_name():
    """An ending of a loop's own choice vents; a user who asked for `hold` keeps the pressures."""
    valves = Valves()
    cycle, _ = run(valves, stop=SafeStop("hold"))
    assert cycle.ending.reason is Reason.FINISHED
    assert not valves.vented
    assert min(valves.P) > 1 * BAR


@pytest.mark.parametrize("error", [ZeroDivisionError(), SystemExit(1), RefusedStart("too late"), Interrupt()])
def test_a_source_of_commands_that_fails_ends_the_same_way(error):
    class Failing(Sine):
        def decide(self, tick):
            if tick.k > WHEN["motion"]:
                raise error
            return super().decide(tick)

    valves = Valves()
    cycle, raised = run(valves, source=Failing())
    assert raised is error
    assert cycle.ending.reason is Reason.ERROR
    assert valves.safe


@pytest.mark.parametrize("u", [None, (1e5,), ("1e5", "1e5"), (1j, 1j), (float("nan"), 1e5), (np.zeros(2), 1e5)])
def test_commands_that_are_no_pressures_are_not_sent(u):
    class Lying(Sine):
        def decide(self, tick):
            return Decision(u, Phase.RUN) if tick.k > WHEN["motion"] else super().decide(tick)

    valves = Valves()
    run(valves, source=Lying())
    assert valves.safe
    assert all(type(P) is float for pair in valves.written for P in pair)


@pytest.mark.parametrize("jump", [3600.0, -3600.0, float("nan"), float("inf")])
def test_a_clock_that_jumps_leaves_no_pressure(jump):
    valves = Valves()
    now = valves.clock.now
    valves.clock.now = lambda: now() + (jump if len(valves.written) > WHEN["motion"] else 0.0)
    run(valves)
    assert valves.safe


# --- the loops that people run ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("call", ["read", "write", "watch"])
def test_a_sweep_leaves_no_pressure_behind(call, tmp_path):
    for error in EXCEPTIONS:
        valves = Valves().fail(call, WHEN["motion"], FOREVER, raising(error))
        sweep = Sweep([], [(2.5 * BAR, 1.5 * BAR)] * 3, DT, bool, tmp_path)
        run(valves, Raw, source=sweep)
        assert valves.calls[call] > WHEN["motion"], "it did not come so far"
        assert valves.safe, error


def test_a_weight_that_cannot_be_asked_for_leaves_no_pressure_behind(tmp_path):
    for error in EXCEPTIONS:
        valves = Valves()
        visit = Visit(1.0, (2.5 * BAR, 1.5 * BAR), (2.5 * BAR, 1.5 * BAR), 1)

        def ask(torque, error=error):
            raise error

        _, raised = run(valves, source=Sweep([visit], [], DT, ask, tmp_path))
        assert valves.commanded
        assert valves.safe, error
        assert raised is not None or isinstance(error, KeyboardInterrupt | DeviceError)


@pytest.mark.parametrize("part", ["controller", "observer", "read", "write", "watch"])
@pytest.mark.parametrize("error", [OSError(5, "gone"), KeyboardInterrupt(), MemoryError(), Interrupt()], ids=repr)
def test_a_tracking_loop_leaves_no_pressure_behind(bench, part, error):
    calls = iter(range(10**9))

    def fail(*_):
        if next(calls) >= 40:
            raise error

    def failing(do):
        return lambda *given: fail() or do(*given)

    observer = Differentiator(DT)
    bench.device.before_read = fail if part == "read" else None
    bench.device.before_write = fail if part == "write" else None
    loop = bench.loop(observer, watch=fail if part == "watch" else None)
    if part == "controller":
        bench.controller.step = failing(bench.controller.step)
    if part == "observer":
        observer.estimate = failing(observer.estimate)
    with nullcontext() if isinstance(error, KeyboardInterrupt) else pytest.raises(type(error)):
        loop.run()
    assert bench.device.commands[-1] == (0.0, 0.0)
    assert bench.device.vents
    assert loop.record.ending.delivered


@pytest.mark.parametrize(
    ("machine", "reading", "sentence"),
    [
        (ARM, Reading(0.0, 0.1, (2e5, 2e5)), "expected a Reading .* of 2 angles and 6"),
        (PLANT, Reading(0.0, np.zeros(2), (2e5,) * 6), r"expected a Reading \(t, theta, \(P1"),
        (ARM, Reading(0.0, [[0.1], [0.1, 0.2]], (2e5,)), "expected a Reading"),
    ],
)
def test_a_device_of_another_machine_is_refused(machine, reading, sentence):
    with pytest.raises(DeviceError, match=sentence):
        Guard(machine, DT, Watchdog(), 0.0).checked(reading)
