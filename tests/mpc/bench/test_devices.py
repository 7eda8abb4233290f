"""Simulated and callable devices, and how devices get their names."""

import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import AntagonistError, InvalidInput, MissingBackend
from mpc import Plant
from mpc.bench.device import CallableDevice, DeviceError, MonotonicClock, Reading, SimulatedClock
from mpc.bench.devices.registry import kinds, open_device
from mpc.bench.devices.simulated import STEP, SimulatedDevice
from mpc.model.arm.model import Arm
from mpc.model.real import RealPlant


def test_a_simulated_device_moves_as_its_plant_does(plant):
    """Against the exact solution of the lag, and the plant's own experiment."""
    plant = replace(plant, gas=False)
    clock = SimulatedClock()
    P0, P1, P2 = 2 * BAR, 3 * BAR, 1 * BAR
    with SimulatedDevice(plant, clock, theta=0.0, pressures=(P0, P0)) as device:
        device.write(P1, P2)
        clock.sleep_until(0.25)
        reading = device.read()
    experiment = RealPlant(plant).begin(STEP, np.array([0.0, 0.0, P0, P0]), 0)
    for _ in range(250):
        experiment.advance(np.array([P1, P2]))
    assert reading.t == pytest.approx(0.25)
    assert reading.P[0] == pytest.approx(P1 + (P0 - P1) * np.exp(-0.25 / 0.1), rel=1e-6)
    assert reading.theta == pytest.approx(experiment.x[0], rel=1e-9)
    assert reading.theta > 0  # the agonist turns the joint towards greater angles


def test_a_command_acts_from_when_it_was_written(plant):
    clock = SimulatedClock()
    lagging = replace(plant, gas=False)
    with SimulatedDevice(lagging, clock, theta=0.0, pressures=(2 * BAR, 2 * BAR)) as device:
        clock.sleep_until(0.0373)
        device.write(3 * BAR, 2 * BAR)
        clock.sleep_until(0.1)
        P1 = device.read().P[0]
    acted = 0.1 - 0.037  # to a step of its time base
    assert P1 == pytest.approx(BAR * (3 - np.exp(-acted / 0.1)), rel=1e-6)


def test_it_is_dated_by_its_state_and_not_by_how_long_that_took(plant):
    """A computer that is slow makes a reading late, not wrong."""
    with SimulatedDevice(plant, MonotonicClock(), theta=0.0) as device:
        before = time.monotonic()
        time.sleep(0.01)
        t = device.read().t
    assert before + 0.01 - 2 * STEP <= t <= time.monotonic()


def test_a_weight_pulls_the_angle_down(plant):
    clock = SimulatedClock()
    with SimulatedDevice(plant, clock, theta=0.0, pressures=(2 * BAR, 2 * BAR)) as device:
        device.write(2 * BAR, 2 * BAR)
        device.hang(1.0)
        for k in range(1, 1000):
            clock.sleep_until(0.01 * k)
            device.read()
        theta = device.x[0]
    assert theta == pytest.approx(float(plant.joint.equilibrium(2 * BAR, 2 * BAR, 1.0)), abs=0.1 * DEG)
    assert theta < 0


def test_a_device_that_is_not_entered_says_so():
    with pytest.raises(DeviceError, match="with device:"):
        SimulatedDevice().read()


def test_pressures_need_not_be_measured(plant):
    with SimulatedDevice(plant, SimulatedClock(), measures_pressure=False) as device:
        reading = device.read()
    assert np.isfinite(reading.theta)
    assert np.isnan(reading.P).all()


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (0.2, (0.2, np.nan, np.nan)),
        ((0.2, 1e5, 2e5), (0.2, 1e5, 2e5)),
        (np.array([0.2, np.nan, 2e5]), (0.2, np.nan, 2e5)),
        (Reading(3.0, 0.2, (1e5, 2e5)), (0.2, 1e5, 2e5)),
    ],
)
def test_a_callable_device_takes_what_a_function_says(said, expected):
    sent, closed = [], []
    device = CallableDevice(lambda: said, lambda *P: sent.append(P), close=lambda: closed.append(True))
    with device:
        _, theta, P = device.read()
        np.testing.assert_array_equal((theta, *P), expected)
        device.write(1e5, 2e5)
        device.vent()
    assert sent == [(1e5, 2e5), (0.0, 0.0)]
    assert closed == [True]


def test_a_callable_device_of_an_arm_splits_its_numbers_by_the_machine():
    said, sent = [(0.1, 0.2, *range(6))], []
    device = CallableDevice(lambda: said[0], lambda *P: sent.append(P), machine=Arm.machine("arm26"))
    np.testing.assert_array_equal(device.read().theta, [0.1, 0.2])
    assert device.read().P == tuple(range(6))
    said[0] = 0.1, 0.2
    assert np.isnan(device.read().P).sum() == 6
    for said[0] in ((0.1, 1e5, 2e5), 0.1, np.zeros((2, 4)), ((0.1, 0.2), (1e5,) * 6)):
        with pytest.raises(DeviceError, match=r"give a row of 2 angles .*, or of 2 angles and 6 pressures"):
            device.read()
    device.vent()
    assert sent == [(0.0,) * 6]


def test_a_weight_on_an_arm_pulls_the_joint_that_it_is_on(plant):
    clock = SimulatedClock()
    with SimulatedDevice(Arm.machine("arm26"), clock, pressures=2 * BAR) as device:
        device.hang(np.array([0.0, 0.5]))
        for k in range(1, 100):
            clock.sleep_until(0.01 * k)
            device.read()
    assert device.x[1] < -1 * DEG
    with pytest.raises(InvalidInput, match=r"pressures = .* has to be one number or a row of 6"):
        SimulatedDevice(Arm.machine("arm26"), pressures=(0.0, 0.0))


@pytest.mark.parametrize("said", [None, "high", (1.0, 2.0), ()])
def test_what_is_no_reading_is_said(said):
    with CallableDevice(lambda: said, print) as device, pytest.raises(DeviceError, match=r"read\(\) returned"):
        device.read()


def test_a_device_of_another_package_has_a_name(tmp_path, monkeypatch):
    (tmp_path / "acme_valves.py").write_text('def make(address):\n    """Drive Acme valves."""\n    return address\n')
    (tmp_path / "broken_valves.py").write_text("import nothing_of_this_name\n")
    info = tmp_path / "acme-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: acme\nVersion: 1.0\n")
    entries = "acme = acme_valves:make\nbroken = broken_valves:make\nsim = acme_valves:make\n"
    (info / "entry_points.txt").write_text(f"[antagonist.devices]\n{entries}")
    monkeypatch.syspath_prepend(tmp_path)
    known = kinds()
    assert (known["acme"].summary, known["acme"].brought_by) == ("Drive Acme valves.", "acme")
    assert open_device("acme:COM3:9600") == "COM3:9600"
    assert "nothing_of_this_name" in known["broken"].summary
    with pytest.raises(InvalidInput, match="cannot be loaded"):
        open_device("broken")
    assert known["sim"].brought_by == ""  # ours cannot be replaced


def test_an_unknown_device_names_the_known_ones():
    with pytest.raises(MissingBackend, match=r"unknown device 'analog'; available: .*modbus.*sim"):
        open_device("analog:1")


RIG = """
from mpc.bench import CallableDevice

commands, number = [], 3


def open_device():
    return CallableDevice(lambda: 0.1, lambda P1, P2: commands.append((P1, P2)))


def needs(address):
    return address


def broken():
    return 1 / 0


def empty():
    return None
"""


@pytest.fixture
def rig(tmp_path, monkeypatch):
    """A folder with the user's module, from which commands are called."""
    (tmp_path / "my_own_rig.py").write_text(RIG)
    (tmp_path / "lacking_rig.py").write_text("import nothing_of_this_name\n")
    (tmp_path / "wrong_rig.py").write_text("def open_device(:\n")
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("my_own_rig", None)


def test_a_device_of_one_s_own_is_a_function_of_a_module_in_this_folder(rig):
    with open_device("my_own_rig:open_device") as device:
        assert device.read().theta == 0.1
        device.write(1e5, 2e5)
    assert sys.modules["my_own_rig"].commands == [(1e5, 2e5)]


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        ("my_own_rig:needs", r"needs\(\) raised TypeError: .* missing 1 required positional argument"),
        ("my_own_rig:broken", r"broken\(\) raised ZeroDivisionError: .* \(my_own_rig.py, line 16\)"),
        ("my_own_rig:empty", r"empty\(\) = None has to be a device"),
        ("my_own_rig:number", "my_own_rig has number, which is not a function"),
        ("my_own_rig:nowhere", "my_own_rig has no function nowhere"),
        ("lacking_rig:open_device", "lacking_rig needs nothing_of_this_name, which is not installed"),
        ("wrong_rig:open_device", r"importing wrong_rig raised SyntaxError: .*wrong_rig.py, line 1\)$"),
        ("no_such_rig:open_device", "there is no module no_such_rig; known are modbus, serial, sim and the modules"),
        ("my_own_rig.part:open_device", "there is no module my_own_rig.part"),
        ("my_own_rig", "unknown device 'my_own_rig'; available: MODULE:FUNCTION, modbus"),
        ("my_own_rig:", "unknown device 'my_own_rig'"),
    ],
)
def test_what_is_no_device_of_one_s_own_is_one_sentence(rig, spec, said):
    with pytest.raises(AntagonistError, match=said) as raised:
        open_device(spec)
    assert "\n" not in str(raised.value)


def test_names_of_devices_come_before_modules(rig):
    (rig / "sim.py").write_text("def open_device():\n    raise AssertionError\n")
    with pytest.raises(InvalidInput, match="open_device: does not exist"):
        open_device("sim:open_device")


def test_a_joint_of_a_file_is_simulated(tmp_path):
    Plant(inertia=0.07).save(tmp_path / "plant.toml")
    assert open_device(f"sim:{tmp_path / 'plant.toml'}").plant.nominal.inertia == 0.07


def test_an_arm_without_pressure_lies_on_its_end_stops():
    arm = Arm.machine("arm26")
    heavy, clock = replace(arm, bodies=replace(arm.bodies, gravity=(0.0, -9.81))), SimulatedClock()
    with SimulatedDevice(heavy, clock) as device:
        clock.sleep_until(2.0)
        device.read()
        clock.sleep_until(3.0)
        lying = device.read().theta
    low, _ = heavy.angle_limits
    assert np.all(lying > low - 5 * DEG)
    assert lying[0] < low[0]
    assert np.abs(device.x[2:4]).max() < 0.01


@pytest.mark.parametrize(("stop", "least", "most"), [(0.6, 0.6, 0.65), (None, 0.7, 2.0)])
def test_a_joint_without_pressure_lies_on_its_end_stop_if_it_has_one(stop, least, most):
    limits = None if stop is None else (-stop, stop)
    joint, clock = replace(Plant().joint, angle_limits=limits), SimulatedClock()
    with SimulatedDevice(Plant(joint, gravity_torque=5.0, hanging_angle=2.0), clock) as device:
        for t in (2.0, 4.0):
            clock.sleep_until(t)
            theta = device.read().theta
    assert least < theta < most
