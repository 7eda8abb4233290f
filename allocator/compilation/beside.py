"""Compilation in a background process, so that no call waits; the next call finds the result in the cache.

A thread would not do, because numba compiles under a global lock and Python holds the GIL. The process outlives its
parent, runs at a low priority, and locks a file until it is done: an unlocked file means that the process was killed or
failed.
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
    """Uncompiled code was called inside `only_kept`."""


@contextmanager
def only_kept() -> Iterator[None]:
    """Forbid compilation: a first call loads cached code, or raises `NotKept`."""
    token = _ONLY_KEPT.set(True)
    try:
        yield
    finally:
        _ONLY_KEPT.reset(token)


def check_may_compile(what: str) -> None:
    """Raise `NotKept` if compilation is forbidden; `what` names the function in the message."""
    if _ONLY_KEPT.get():
        raise NotKept(f"{what} is not compiled yet")


def begin(name: str, directory: Path, work: Callable[..., object], *arguments: object) -> bool:
    """Return whether a process runs `work(*arguments)`; start one if none does.

    If an earlier process called `name` failed, or none can be started, return False: the caller must do the work.
    """
    lock = directory / f"{name}.lock"
    try:
        if lock.exists():
            return _held(lock)
        _start(pickle.dumps((lock, work, arguments)), directory)
    except (OSError, pickle.PicklingError, AttributeError, TypeError):  # the last three: raised by pickle
        return False
    return True


def _start(payload: bytes, directory: Path) -> None:
    """Start a process that has this one's module search path and outlives it."""
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


_STARTED: list["subprocess.Popen[bytes]"] = []  # keeps a reference: Python warns when a running Popen is collected


def _flags() -> int:
    """Return the Windows flags of a low-priority process without a console that outlives ours; 0 elsewhere."""
    names = "DETACHED_PROCESS", "CREATE_NEW_PROCESS_GROUP", "BELOW_NORMAL_PRIORITY_CLASS"
    return sum(int(getattr(subprocess, name, 0)) for name in names)


def _held(lock: Path) -> bool:
    """Return whether a process has locked this file."""
    with lock.open("ab") as file:
        return not locked(file)


def locked(file: IO[bytes]) -> bool:
    """Lock `file` until it is closed; return False if another process holds the lock."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):  # the latter on Windows
        return False
    return True


def main() -> None:
    """Do the work pickled on standard input, unless another process is doing it."""
    lock, work, arguments = pickle.load(sys.stdin.buffer)
    with lock.open("ab") as file:
        if not locked(file):
            return
        if hasattr(os, "nice"):
            os.nice(_NICE)
        gc.disable()  # compilation makes many objects and little garbage: saves a tenth of its time
        work(*arguments)
    lock.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
