"""Kernel of the report's joint in C, compiled on this machine: the limit for compiled Python."""

import ctypes
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from allocator.allocation.two_muscles.kernels.choice import TonduNumbers
from benchmarks.speed.targets import Answers, Targets

SOURCE = Path(__file__).with_name("reference.c")
# in addition to -O3 -march=native: gcc vectorises only if sqrt need not set errno and comparisons need not trap
FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC")
_PROVED = ("least", "most")  # without a slew limit no pressure is outside


class _Numbers(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_int32 if kind is int else ctypes.c_double)
        for name, kind in TonduNumbers.__annotations__.items()
        if name not in _PROVED
    ]


def compiler() -> str | None:
    """Return a C compiler, or None."""
    return shutil.which("gcc") or shutil.which("cc")


@contextmanager
def c_reference(targets: Targets) -> Iterator[Callable[[Answers], None]]:
    """Yield a function that fills `Answers` for the targets."""
    with TemporaryDirectory() as folder:
        library = Path(folder) / "reference.so"
        subprocess.run([str(compiler()), *FLAGS, str(SOURCE), "-o", str(library), "-lm"], check=True)
        allocate = ctypes.CDLL(str(library)).allocate
        numbers = TonduNumbers.of(targets.joint)
        assert numbers is not None
        shared = _Numbers(**{name: value for name, value in numbers._asdict().items() if name not in _PROVED})
        given = [np.ascontiguousarray(x).ctypes.data_as(ctypes.c_void_p) for x in targets.arrays]

        def run(out: Answers) -> None:
            filled = [x.ctypes.data_as(ctypes.c_void_p) for x in out]
            allocate(ctypes.c_int64(targets.n), *given, ctypes.byref(shared), ctypes.c_double(0.0), *filled)

        yield run
