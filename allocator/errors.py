"""Exceptions of this project, warnings given once, and names of libraries that are not installed.

AntagonistError
├── InvalidInput (also a ValueError)   an argument that makes no sense, with its value and the unit expected
│   └── InvalidFile                    a file that cannot be read, with its line and column
├── MissingBackend (also a ValueError) a method or solver that does not exist here, with the ones that do
│   └── MissingPackage (also a ModuleNotFoundError)  a library that is not installed, with the line that does
└── CannotWrite (also an OSError)      a file that cannot be written, and why

Each library is imported only in the file that uses it and when it is used, so that `allocate` runs on NumPy alone. A
finder behind all others turns failed imports by our own files into a `MissingPackage`, which says how to install it.
"""

import sys
import warnings
from collections.abc import Iterable, Sequence
from types import FrameType


class AntagonistError(Exception):
    """All errors of this project derive from this one."""


class InvalidInput(AntagonistError, ValueError):
    """An argument that makes no sense; the message names it, its value and what was expected."""


class InvalidFile(InvalidInput):
    """A file that cannot be read as what it should be; the message names the line and the column."""

    def __init__(self, path: object, what: str, *, line: int | None = None, column: str | None = None) -> None:
        """Locate `what` in the file `path` at `line` (counted from 1) and `column` (its name)."""
        place = "".join([f", line {line}" if line else "", f", column {column!r}" if column else ""])
        super().__init__(f"{path}{place}: {what}")


class MissingBackend(AntagonistError, ValueError):
    """A method or solver that does not exist or is not installed; the message lists the ones that are."""

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        """Say that the `kind` called `name` does not exist, and which are `available`."""
        super().__init__(f"unknown {kind} {name!r}; available: {', '.join(sorted(available))}")


class MissingPackage(MissingBackend, ModuleNotFoundError):
    """Required library that is not installed; the message has the command that installs it."""

    def __init__(self, name: str, install: str) -> None:
        """Say how to install the library called `name`."""
        Exception.__init__(self, f"this needs {name}, which is not installed: pip install {install}")
        self.name = name


class CannotWrite(AntagonistError, OSError):
    """A file that cannot be written; the message names it and says why."""

    def __init__(self, path: object, why: str | BaseException) -> None:
        """Say `why` the file `path` cannot be written; of an `OSError` what the system said."""
        said = (why.strerror if isinstance(why, OSError) else None) or str(why)
        super().__init__(f"{path} cannot be written ({said})")


_OURS = {"allocator", "mpc", "numba", "contextlib"}
_said: set[str] = set()


class CacheFault(UserWarning):
    """Warning that cached compiled code cannot be read, or cannot be written."""


def notice(message: str, category: type[Warning]) -> None:
    """Warn of `message` at the line outside of this project that led here."""
    depth, frame = 1, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _OURS:
        depth, frame = depth + 1, frame.f_back
    warnings.warn(message, category, stacklevel=depth + 1)


def notice_once(message: str, category: type[Warning]) -> None:
    """Warn as `notice` does, unless it has been said in this process: whatever filters there are, once is enough."""
    if message not in _said:
        _said.add(message)
        notice(message, category)


_PACKAGES = ("allocator", "mpc")
_INSTALL = {  # arguments of pip, by the library
    "casadi": "casadi",
    "cma": "cma",
    "control": "control",
    "cvxpy": "'antagonist[solvers]'",
    "daqp": "daqp",
    "distributed": "'antagonist[dask]'",
    "gymnasium": "'antagonist[gym]'",
    "matplotlib": "matplotlib",
    "mcap": "'antagonist[ros]'",
    "mujoco": "'antagonist[mujoco]'",
    "numba": "numba",
    "osqp": "'antagonist[solvers]'",
    "pymodbus": "'antagonist[modbus]'",
    "qpsolvers": "'antagonist[solvers]'",
    "rich": "typer rich",
    "rosbags": "'antagonist[ros]'",
    "scipy": "scipy",
    "serial": "'antagonist[serial]'",
    "typer": "typer rich",
}


class _NameMissing:
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        """Find nothing. Raises `MissingPackage` if a file of these packages imports it."""
        if fullname in _INSTALL and _imported_by_us(sys._getframe(1)):
            raise MissingPackage(fullname, _INSTALL[fullname])


def _imported_by_us(frame: FrameType | None) -> bool:
    """Return whether a file of these packages runs an `import`; looking for a module is none."""
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib._"):
        frame = frame.f_back
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] in _PACKAGES


def name_what_is_missing() -> None:
    """Append the finder to `sys.meta_path`, once."""
    if not any(isinstance(finder, _NameMissing) for finder in sys.meta_path):
        sys.meta_path.append(_NameMissing())
