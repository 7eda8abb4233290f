"""Compiling in a background process, so that no call waits; the next call finds the result in the cache.

It is a process and no thread, because numba compiles under a lock and Python under another. It outlives the one that
has started it, works at a low priority, and holds a lock on a file as long as it is at it: a file without one tells of
a process that was ended or has failed.
"""

import gc
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO

_NICE = 10
_ONLY_KEPT: ContextVar[bool] = ContextVar("_ONLY_KEPT", default=False)


class NotKept(Exception):
    """Code was called that is not compiled yet, where none may be."""


@contextmanager
def only_kept() -> Iterator[None]:
    """Compile nothing that would be kept: a first call loads compiled code, or raises `NotKept`."""
    token = _ONLY_KEPT.set(True)
    try:
        yield
    finally:
        _ONLY_KEPT.reset(token)


def check_may_compile(what: str) -> None:
    """Insist that `what` may be compiled now. Raises `NotKept`."""
    if _ONLY_KEPT.get():
        raise NotKept(f"{what} is not compiled yet")


def begin(name: str, directory: Path, work: Callable[..., object], *arguments: object) -> bool:
    """Return whether a process is at `work(*arguments)`, started now if none is yet.

    False where an earlier one called `name` came to nothing, or none can be started: the work is the caller's then.
    """
    lock = directory / f"{name}.lock"
    try:
        if lock.exists():
            return _held(lock)
        _start(pickle.dumps((lock, work, arguments)), directory)
    except (OSError, pickle.PicklingError, AttributeError, TypeError):  # the last three: of what cannot be pickled
        return False
    return True


def _start(payload: bytes, directory: Path) -> None:
    """Start a process that finds modules where this one does, and outlives it."""
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "allocator.compilation.beside"],
        stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        cwd=directory, env={**os.environ, "PYTHONPATH": path}, start_new_session=True,
        creationflags=_flags(),
    )  # fmt: skip
    _STARTED.append(process)
    assert process.stdin is not None
    with process.stdin as pipe:
        pipe.write(payload)


_STARTED: list["subprocess.Popen[bytes]"] = []  # Python warns of processes that are forgotten


def _flags() -> int:
    """Return what on Windows makes a process that has no console, outlives ours, and leaves it the processor."""
    names = "DETACHED_PROCESS", "CREATE_NEW_PROCESS_GROUP", "BELOW_NORMAL_PRIORITY_CLASS"
    return sum(int(getattr(subprocess, name, 0)) for name in names)


def _held(lock: Path) -> bool:
    """Return whether a process holds this file."""
    with lock.open("ab") as file:
        return not _locked(file)


def _locked(file: IO[bytes]) -> bool:
    """Return whether `file` is now locked, until it is closed; False if another process has done so."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # the latter is Windows's
        return False
    return True


def main() -> None:
    """Do the work that standard input tells of, unless another process is at it."""
    lock, work, arguments = pickle.load(sys.stdin.buffer)
    with lock.open("ab") as file:
        if not _locked(file):
            return
        if hasattr(os, "nice"):
            os.nice(_NICE)
        gc.disable()  # a compiler makes little garbage and many objects to look through: a tenth of its time
        work(*arguments)
    lock.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
