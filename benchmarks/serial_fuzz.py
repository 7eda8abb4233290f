"""Robustness of both ends of the serial protocol to a million corrupted bytes.

    python -m benchmarks.serial_fuzz [--bytes 1000000] [--seed 0] [--machine arm26]

The board is the exported C under the address and undefined-behaviour sanitizers (gcc), the host is `SerialDevice`.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from mpc import Arm, Plant, TrackingMPC
from mpc.bench.device import NoAnswer
from mpc.bench.devices.serial_protocol import Sizes
from mpc.export.serial.firmware import export_board
from mpc.model.machine import Machine
from tests.rigs import fuzz


def terminal(directory: Path, machine: Machine, n: int, rng: np.random.Generator) -> None:
    sizes, board = Sizes(machine.n, machine.m), fuzz.board(export_board(directory / "terminal", process=machine))
    obeyed = fuzz.accepted(board, fuzz.noise(rng, n), sizes)
    print(f"board, noise:          {n} bytes, {len(obeyed)} commands obeyed")
    stream = fuzz.damaged(rng, n, sizes=sizes)
    places = {command: k for k, command in enumerate(stream.meant)}
    rows = [tuple(row) for row in fuzz.accepted(board, stream.line, sizes)]
    strange = sum(row not in places for row in rows)
    order = np.diff([places[row] for row in rows if row in places])
    missed = len(set(stream.whole) - {places.get(row) for row in rows})
    print(
        f"board, damaged frames: {len(stream.line)} bytes, {len(stream.meant)} commands sent, {len(rows)} obeyed, "
        f"of these {strange} never sent and {(order < 0).sum()} out of order; "
        f"of {len(stream.whole)} whole ones {missed} missed"
    )
    line = fuzz.forged(rng, n, sizes)
    rows = fuzz.accepted(board, line, sizes)
    beyond = int((~((rows[:, 1:] >= 0) & (rows[:, 1:] <= fuzz.HIGH)).all(axis=1)).sum())
    print(f"board, forged frames:  {len(line)} bytes, {len(rows)} commands obeyed, {beyond} beyond the limits")


def controller(directory: Path, machine: Machine, n: int, rng: np.random.Generator) -> None:
    sizes = Sizes(machine.n, machine.m)
    firmware = export_board(directory / "controller", controller=TrackingMPC(machine, N=3, compiled=False))
    board = fuzz.board(firmware, controls=True)
    stream = fuzz.damaged(rng, n, follows=True, sizes=sizes)
    rows = [tuple(row) for row in fuzz.accepted(board, stream.line, sizes)]
    strange = len(set(rows) - set(stream.meant))
    print(
        f"board with controller, damaged frames: {len(stream.line)} bytes, {len(rows)} references taken of "
        f"{len(stream.meant)}, {strange} never sent"
    )
    line = fuzz.forged(rng, n, sizes)
    rows = fuzz.accepted(board, line, sizes)
    references = rows[rows[:, 0] == 1, 1:]
    least = np.linalg.eigvalsh(fuzz.stiffnesses(references, sizes))[:, 0]
    wrong = int((~(np.isfinite(references).all(axis=1) & (least > 0))).sum())
    print(f"board with controller, forged frames: {len(line)} bytes, {len(references)} references taken, {wrong} wrong")


def host(n: int, rng: np.random.Generator) -> None:
    line = fuzz.NoisyLine(rng)
    read = lost = strange = 0
    with fuzz.NoisyDevice(line) as device:
        while line.carried < n:
            try:
                reading = device.read()
            except NoAnswer:
                lost += 1
            else:
                read += 1
                strange += (reading.theta, *reading.P) != (line.said[device.asked], 2e5, 3e5)
    print(
        f"host: {line.carried} bytes, {read} readings, {strange} of them not the answer; {lost} times none in time, "
        f"{device.late} late, {device.damaged} damaged"
    )


def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bytes", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--machine", default="", help="a ready-made arm on the board; by default a joint")
    given = parser.parse_args(arguments)
    rng, machine = np.random.default_rng(given.seed), Arm.machine(given.machine) if given.machine else Plant()
    host(given.bytes, rng)
    with tempfile.TemporaryDirectory() as made:
        terminal(Path(made), machine, given.bytes, rng)
        controller(Path(made), machine, given.bytes, rng)


if __name__ == "__main__":
    main()
