"""A Modbus device against pymodbus' own server: what is commanded arrives, and what cannot be is said."""

from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR, DEG
from allocator.errors import InvalidFile, InvalidInput
from mpc.bench.device import DeviceError, DeviceLost, NoAnswer, SimulatedClock
from mpc.bench.devices.modbus import Entry, ModbusDevice, RegisterMap, open_modbus
from mpc.bench.devices.simulated import SimulatedDevice
from mpc.model.real import RealPlant
from tests.mpc.bench.valve_terminal import HOST, ValveTerminal

MAP = replace(RegisterMap.generic(), timeout=9.0)  # [s]: a busy machine is no silent device


@pytest.fixture
def terminal(plant):
    clock = SimulatedClock()
    joint = SimulatedDevice(RealPlant(plant), clock, theta=-0.3, pressures=(1 * BAR, 2 * BAR))
    with ValveTerminal(joint) as served:
        served.clock = clock
        yield served


def connected(terminal, registers=MAP):
    return ModbusDevice.tcp(HOST, terminal.port, registers)


def test_readings_and_commands_are_those_of_the_joint(terminal):
    with connected(terminal) as device:
        reading = device.read()
        assert reading.theta == pytest.approx(-0.3, abs=0.005 * DEG + 1e-12)
        assert reading.P == pytest.approx((1 * BAR, 2 * BAR), abs=0.5e-3 * BAR + 1)
        device.write(3.1234 * BAR, 0.5 * BAR)
        np.testing.assert_allclose(terminal.device.command, [3.123 * BAR, 0.5 * BAR])
        device.vent()
        np.testing.assert_array_equal(terminal.device.command, [0, 0])


def test_neighbouring_registers_are_one_request(terminal):
    with connected(terminal) as device:
        device.read()
        device.write(1 * BAR, 1 * BAR)
    assert terminal.requests == {4: 1, 16: 1}


def test_a_device_that_refuses_or_is_silent_gives_no_answer_and_recovers(terminal):
    with connected(terminal, replace(MAP, timeout=1.0)) as device:
        terminal.refuse = True
        for ask in (device.read, device.vent):
            with pytest.raises(NoAnswer, match="refused"):
                ask()
        terminal.refuse, terminal.silent = False, True
        with pytest.raises(NoAnswer, match="no answer"):
            device.read()
        terminal.silent = False
        assert device.read().theta == pytest.approx(-0.3, abs=1e-3)


def test_a_terminal_that_is_gone_is_lost(terminal):
    with connected(terminal) as device:
        device.read()
        terminal.close()
        terminal._thread.join(10)
        with pytest.raises(NoAnswer):
            device.read()
        with pytest.raises(DeviceLost, match=HOST):
            device.read()
        with pytest.raises(DeviceError):
            device.vent()


def test_a_device_that_is_not_entered_says_so(terminal):
    with pytest.raises(DeviceError, match="with device:"):
        connected(terminal).read()


@pytest.mark.parametrize("kind", ["int16", "uint16", "int32", "uint32", "float32"])
@pytest.mark.parametrize("big", [True, False])
def test_numbers_survive_the_registers(kind, big):
    entry = Entry("P1", 0, kind, "bar", 0.001, 0.25)
    for P in (0.25, 1.234, 6.0):
        words = entry.words(P * BAR, big)
        assert len(words) == entry.size
        assert all(0 <= word < 65536 for word in words)
        assert entry.value(words, big) == pytest.approx(P * BAR, rel=1e-7)


def test_registers_are_laid_out_as_modbus_has_them():
    """From the specification's data model: most significant byte, and with `big` word, first."""
    assert Entry("theta", 0, "int16", "deg", 0.01).words(-1 * DEG, True) == [0xFF9C]
    assert Entry("P1", 0, "uint32", "Pa").words(0x00012345, True) == [0x0001, 0x2345]
    assert Entry("P1", 0, "uint32", "Pa").words(0x00012345, False) == [0x2345, 0x0001]
    assert Entry("P1", 0, "float32", "Pa").words(1.0, True) == [0x3F80, 0x0000]  # IEEE 754


def test_a_command_that_no_register_holds_is_not_sent(terminal):
    with connected(terminal) as device, pytest.raises(DeviceError, match="would be 66000, which no uint16 holds"):
        device.write(66 * BAR, 0.0)
    assert terminal.requests == {}


GOOD = """
[read.theta]
register = 0
unit = "deg"
[write.P1]
register = 0
unit = "bar"
[write.P2]
register = 7
unit = "bar"
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD.replace("theta", "phi"), r"\[read\] has no phi; it has theta, P1, P2"),
        (GOOD.replace("[read.theta]", "[read.P1]").replace('"deg"', '"bar"'), "without its angle"),
        (GOOD.replace('"deg"', '"grad"'), "unit = 'grad' has to be one of deg, rad"),
        (GOOD.replace("register = 7", "register = 70000"), "register"),
        (GOOD.replace("register = 7", "registre = 7"), "has no registre"),
        (GOOD.replace("register = 7\n", ""), "needs register"),
        ("timeout = 20\n" + GOOD, "timeout = 20"),
        ('word_order = "middle"\n' + GOOD, "word_order"),
        ("speed = 3\n" + GOOD, "a register map has no speed"),
        (GOOD + "scale = 0.0\n", "scale = 0 makes all numbers alike"),
        (GOOD + 'type = "int8"\n', "type = 'int8' has to be one of int16"),
        (GOOD + "[[vent]]\nregister = 3\n", r"\[vent 1\]: it needs number"),
        ("[read\n", "is not TOML"),
    ],
)
def test_a_map_that_makes_no_sense_is_refused_in_a_sentence(tmp_path, text, said):
    (tmp_path / "map.toml").write_text(text)
    with pytest.raises(InvalidFile, match=said):
        RegisterMap.load(tmp_path / "map.toml")


def test_registers_apart_are_requests_apart(tmp_path, terminal):
    (tmp_path / "map.toml").write_text(
        "timeout = 9\n" + GOOD.replace("register = 7", "register = 5") + "scale = 0.001\n"
    )
    device = open_modbus(f"{HOST}:{terminal.port}:{tmp_path / 'map.toml'}")
    with device:
        device.write(1 * BAR, 2 * BAR)
    assert terminal.requests == {16: 2}


@pytest.mark.parametrize(
    ("address", "said"),
    [
        ("", "expected HOST:PORT"),
        ("host:port", "'port' is no port"),
        ("host:1:2", "expected"),
        ("host:70000", "no port"),
        ("map.toml", "expected HOST:PORT"),
    ],
)
def test_an_address_that_is_none_is_refused(address, said):
    with pytest.raises(InvalidInput, match=said):
        open_modbus(address)
