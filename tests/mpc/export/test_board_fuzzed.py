"""Whatever comes over the line: neither end crashes, and nothing is obeyed or believed that nobody said."""

import numpy as np
import pytest

from mpc import Arm, Plant, TrackingMPC
from mpc.bench.device import NoAnswer
from mpc.bench.devices.serial_protocol import Sizes
from mpc.export.serial.firmware import export_board

from ...rigs import fuzz
from ...rigs.needs import needs

pytestmark = pytest.mark.slow
BYTES = 60_000  # `python -m benchmarks.serial_fuzz` takes a million
MACHINES = {"a joint": Plant, "an arm": lambda: Arm.machine("arm26")}
from_gcc = [needs("gcc"), pytest.mark.tools]


@pytest.fixture(scope="module", params=[pytest.param(make, id=name, marks=from_gcc) for name, make in MACHINES.items()])
def machine(request):
    return request.param()


@pytest.fixture
def sizes(machine):
    return Sizes(machine.n, machine.m)


@pytest.fixture(scope="module")
def board(machine, tmp_path_factory):
    return fuzz.board(export_board(tmp_path_factory.mktemp("fuzzed") / "c", process=machine))


def test_noise_moves_no_valve(board, sizes):
    assert not len(fuzz.accepted(board, fuzz.noise(np.random.default_rng(0), BYTES), sizes))


def test_of_damaged_and_repeated_frames_the_whole_ones_are_obeyed_once_and_in_order(board, sizes):
    stream = fuzz.damaged(np.random.default_rng(1), BYTES, sizes=sizes)
    places = {command: k for k, command in enumerate(stream.meant)}
    obeyed = [places[tuple(row)] for row in fuzz.accepted(board, stream.line, sizes)]  # KeyError: nobody said that
    assert (np.diff(obeyed) >= 0).all()
    assert set(stream.whole) <= set(obeyed)
    assert len(stream.whole) > 300


def test_whole_frames_of_nonsense_move_no_valve_beyond_its_limits(board, sizes):
    rows = fuzz.accepted(board, fuzz.forged(np.random.default_rng(2), BYTES, sizes), sizes)
    assert len(rows) > 50
    assert ((rows[:, 1:] >= 0) & (rows[:, 1:] <= fuzz.HIGH)).all()  # which NaN is not


def test_a_board_with_the_controller_takes_no_reference_that_nobody_sent(machine, sizes, tmp_path):
    controller = TrackingMPC(machine, N=3, compiled=False)
    board = fuzz.board(export_board(tmp_path / "c", controller=controller), controls=True)
    stream = fuzz.damaged(np.random.default_rng(4), BYTES, follows=True, sizes=sizes)
    places = {command: k for k, command in enumerate(stream.meant)}
    taken = [places[tuple(row)] for row in fuzz.accepted(board, stream.line, sizes)]
    assert (np.diff(taken) > 0).all()
    assert len(taken) > 20
    rows = fuzz.accepted(board, fuzz.forged(np.random.default_rng(5), BYTES, sizes), sizes)
    references = rows[rows[:, 0] == 1, 1:]
    assert len(references) > 20
    assert np.isfinite(references).all()
    assert (np.linalg.eigvalsh(fuzz.stiffnesses(references, sizes)) > 0).all()


def test_a_host_believes_no_answer_but_the_one_to_its_question():
    line = fuzz.NoisyLine(np.random.default_rng(3))
    read = refused = 0
    with fuzz.NoisyDevice(line) as device:
        while line.carried < BYTES:
            try:
                reading = device.read()
            except NoAnswer:
                refused += 1
            else:
                assert (reading.theta, *reading.P) == (line.said[device.asked], 2e5, 3e5)
                read += 1
    assert read > 300
    assert refused > 100
    assert device.late > 30
    assert device.damaged > 100
