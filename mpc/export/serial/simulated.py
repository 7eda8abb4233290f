"""Simulated board: the exported firmware compiled for this PC, behind a pseudo-terminal, with a simulated joint or arm.

with SimulatedBoard() as board, SerialDevice(board.port) as device:
    device.read()
"""

import subprocess
import tempfile
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import AntagonistError, InvalidInput
from mpc.export.building import compile_c, write
from mpc.export.serial.firmware import Safety, board_files, simulated_machine
from mpc.model.machine import Machine
from mpc.model.real_experiment import RealMachine
from mpc.observer.kalman import KalmanObserver
from mpc.tracking.controller import TrackingMPC

_PROGRAM = "simulated_board"


class SimulatedBoard:
    """Simulated board, a context manager; hosts open its `port`."""

    def __init__(
        self,
        process: Machine | RealMachine | None = None,
        controller: TrackingMPC | None = None,
        *,
        observer: KalmanObserver | None = None,
        safety: Safety | None = None,
        x0: ArrayLike | None = None,
        step: float = 0.0,
        flags: tuple[str, ...] = ("-O2",),
    ) -> None:
        """Describe the board, see `export_board`.

        With a `step` [s] the board's clock advances only by that step at every command, so the host need not keep real
        time. Raises `InvalidInput` for settings that C does not support.
        """
        self.files = board_files(process, controller, observer, safety or Safety(), x0=x0)
        self._joints = simulated_machine(process, controller).nominal.n
        self._step = checks.not_negative("step", step, "s")
        self._controls, self._flags = controller is not None, flags
        self._directory: tempfile.TemporaryDirectory[str] | None = None
        self._process: subprocess.Popen[str] | None = None
        self.port = ""

    def __enter__(self) -> Self:
        """Compile the board and start it. Raises `MissingBackend` without a C compiler."""
        self._directory = tempfile.TemporaryDirectory(prefix="antagonist-board-")
        try:
            program = compiled(write(self.files, Path(self._directory.name) / "c"), self._controls, self._flags)
            self._process = subprocess.Popen(
                [program, *([repr(self._step)] if self._step else [])],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
            assert self._process.stdout is not None  # because stdout is a pipe
            self.port = self._process.stdout.readline().strip()
            if not self.port:
                raise AntagonistError(f"the simulated board did not begin: {self.stop()}")
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *raised: object) -> None:
        self.stop()
        if self._directory is not None:
            self._directory.cleanup()
            self._directory = None

    @property
    def pid(self) -> int:
        """Process id of the board, 0 if it does not run."""
        return 0 if self._process is None else self._process.pid

    def hang(self, torque: ArrayLike) -> bool:
        """Apply weights of this torque [N·m], (n,) for an arm, positive if they pull θ down; return whether the board
        confirms it.
        """
        if self._process is None or self._process.stdin is None or self._process.stdout is None:
            raise AntagonistError("the simulated board does not run: use it as a context, `with board:`")
        each = np.atleast_1d(checks.real("torque", torque, "N·m"))
        if each.shape != (self._joints,):
            raise InvalidInput(f"torque of shape {each.shape} has to be one number a joint, {self._joints}")
        self._process.stdin.write(" ".join(map(repr, (-each).tolist())) + "\n")
        self._process.stdin.flush()
        return bool(self._process.stdout.readline())

    def stop(self) -> str:
        """Stop the board, as if its cable were unplugged, and return its messages."""
        process, self._process = self._process, None
        if process is None:
            return ""
        try:
            return process.communicate("", timeout=5)[1]  # the board ends with its standard input
        except subprocess.TimeoutExpired:
            process.kill()
            return process.communicate()[1]


def compiled(directory: Path, controls: bool, flags: tuple[str, ...]) -> Path:
    """Compile the simulated board from the files in `directory` and return its path. Raises `MissingBackend`."""
    shared = [directory / "serial" / f"{name}.c" for name in ("board", "frames")]
    if controls:
        shared += [directory / "serial" / "follow.c", *sorted((directory / "src").glob("*.c"))]
    included = [f"-I{name}" for name in (".", "src", "serial", "simulated")]
    sources = [*sorted((directory / "simulated").glob("*.c")), *shared]
    compile_c("the simulated board", directory, *flags, *included, *map(str, sources), "-lm", "-o", _PROGRAM)
    return directory / _PROGRAM
