"""Answers that are well-formed Modbus, but not to the request: bytes by the specification, without pymodbus."""

import socket
import struct
import threading
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest

from allocator import BAR
from allocator.errors import InvalidFile
from mpc.bench.device import NoAnswer
from mpc.bench.devices.modbus import ModbusDevice, RegisterMap

MAP = replace(RegisterMap.generic(), timeout=5.0)
READ = bytes([4, 6]) + struct.pack(">3H", 100, 2000, 3000)  # three input registers
WRITTEN = bytes([16]) + struct.pack(">2H", 0, 2)  # two registers from 0 on


class Server:
    """A server that answers every request with the PDU of `answer(request PDU)`."""

    def __init__(self, answer):
        self.answer, self.connections = answer, 0
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        threading.Thread(target=self._serve, daemon=True).start()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._socket.close()

    def _serve(self):
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:
                return
            self.connections += 1
            threading.Thread(target=self._talk, args=(connection,), daemon=True).start()

    def _talk(self, connection):
        with connection, suppress(ConnectionError):  # the device may hang up before it has read an answer
            while len(head := connection.recv(7)) == 7:
                number, _, length, unit = struct.unpack(">3HB", head)
                pdu = self.answer(connection.recv(length - 1))
                connection.sendall(struct.pack(">3HB", number, 0, len(pdu) + 1, unit) + pdu)


def honest(request):
    return READ if request[0] == 4 else WRITTEN


def test_right_answers_are_taken():
    with Server(honest) as server, ModbusDevice.tcp("127.0.0.1", server.port, MAP) as device:
        reading = device.read()
        device.write(1 * BAR, 2 * BAR)
        device.vent()
    assert reading.P[0] == pytest.approx(2 * BAR)


@pytest.mark.parametrize(
    ("ask", "pdu"),
    [
        ("write", bytes([3, 4]) + bytes(4)),  # of reading holding registers
        ("write", READ),
        ("write", bytes([6]) + struct.pack(">2H", 0, 1)),  # of writing one register
        ("write", bytes([15]) + struct.pack(">2H", 0, 2)),  # of writing coils
        ("write", bytes([16]) + struct.pack(">2H", 0, 1)),  # one register fewer
        ("write", bytes([16]) + struct.pack(">2H", 7, 2)),  # others
        ("vent", READ),
        ("read", WRITTEN),
        ("read", bytes([3, 6]) + bytes(6)),  # of the other kind of registers
        ("read", bytes([4, 4]) + bytes(4)),  # one register fewer
        ("read", bytes([1, 1, 1])),  # of coils
    ],
)
def test_an_answer_to_something_else_is_no_answer_and_the_next_one_is_taken(ask, pdu):
    arguments = (1 * BAR, 2 * BAR) if ask == "write" else ()
    with Server(lambda request: pdu) as server, ModbusDevice.tcp("127.0.0.1", server.port, MAP) as device:
        with pytest.raises(NoAnswer):
            getattr(device, ask)(*arguments)
        server.answer = honest
        getattr(device, ask)(*arguments)
        assert server.connections == 2


def test_noise_in_answers_is_no_answer():
    rng = np.random.default_rng(1)
    registers = replace(MAP, timeout=0.02)

    def noise(request):
        answer = bytearray(honest(request))
        for _ in range(rng.integers(1, 4)):
            answer[rng.integers(len(answer))] = rng.integers(256)
        return bytes(answer[: rng.integers(1, len(answer) + 1)])

    with Server(noise) as server, ModbusDevice.tcp("127.0.0.1", server.port, registers) as device:
        for _ in range(60):
            for ask in (device.read, device.vent):
                with suppress(NoAnswer):
                    ask()


def test_a_map_that_is_not_utf_8_is_said_to_be(tmp_path):
    path = tmp_path / "map.toml"
    path.write_bytes("device_id = 1  # Druck in ½ bar".encode("latin-1"))
    with pytest.raises(InvalidFile, match=r"map\.toml.*UTF-8"):
        RegisterMap.load(path)
