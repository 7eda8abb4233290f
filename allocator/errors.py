"""Exceptions of this project, warnings given once, and names of libraries that are not installed.

AntagonistError
├── InvalidInput (also a ValueError)   an invalid argument, with its value and the expected unit
│   └── InvalidFile                    a file that cannot be read, with its line and column
├── MissingBackend (also a ValueError) an unknown method or solver, with the available ones
│   └── MissingPackage (also a ModuleNotFoundError)  a library that is not installed, with the pip command
└── CannotWrite (also an OSError)      a file that cannot be written, and why

Libraries are imported on use, so `allocate` needs only NumPy. A finder at the end of `sys.meta_path` turns failed
imports in these packages into `MissingPackage`, which gives the pip command.
"""

import sys
import warnings
from collections.abc import Iterable, Sequence
from types import FrameType


class AntagonistError(Exception):
    """Base class of all errors of this project."""


class InvalidInput(AntagonistError, ValueError):
    """Invalid argument; the message gives its name, its value and the expected values."""


class InvalidFile(InvalidInput):
    """File with invalid content; the message gives the line and the column."""

    def __init__(self, path: object, what: str, *, line: int | None = None, column: str | None = None) -> None:
        """Report the fault `what` in the file `path` at `line` (counted from 1) and `column` (its name)."""
        place = "".join([f", line {line}" if line else "", f", column {column!r}" if column else ""])
        super().__init__(f"{path}{place}: {what}")


class MissingBackend(AntagonistError, ValueError):
    """Unknown or uninstalled method or solver; the message lists the available ones."""

    def __init__(self, kind: str, name: object, available: Iterable[str]) -> None:
        """Report that the `kind` called `name` does not exist, and list those `available`."""
        super().__init__(f"unknown {kind} {name!r}; available: {', '.join(sorted(available))}")


class MissingPackage(MissingBackend, ModuleNotFoundError):
    """Missing library; the message gives the command that installs it."""

    def __init__(self, name: str, install: str) -> None:
        """Report how to install the library called `name`."""
        Exception.__init__(self, f"this needs {name}, which is not installed: pip install {install}")
        self.name = name


class CannotWrite(AntagonistError, OSError):
    """File that cannot be written; the message gives its name and the reason."""

    def __init__(self, path: object, why: str | BaseException) -> None:
        """Report `why` the file `path` cannot be written; for an `OSError`, the system's text."""
        said = (why.strerror if isinstance(why, OSError) else None) or str(why)
        super().__init__(f"{path} cannot be written ({said})")


_OURS = {"allocator", "mpc", "numba", "contextlib"}
_said: set[str] = set()


class CacheFault(UserWarning):
    """Warning that cached compiled code cannot be read, or cannot be written."""


def notice(message: str, category: type[Warning]) -> None:
    """Warn with `message` at the calling line outside of this project."""
    depth, frame = 1, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _OURS:
        depth, frame = depth + 1, frame.f_back
    warnings.warn(message, category, stacklevel=depth + 1)


def notice_once(message: str, category: type[Warning]) -> None:
    """Warn as `notice` does, but once per process and message, regardless of warning filters."""
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
    "ziglang": "'antagonist[fmu]'",
}


class _NameMissing:
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        """Find nothing. Raises `MissingPackage` if a file of these packages imports it."""
        if fullname in _INSTALL and _imported_by_us(sys._getframe(1)):
            raise MissingPackage(fullname, _INSTALL[fullname])


def _imported_by_us(frame: FrameType | None) -> bool:
    """Return whether a file of these packages runs an `import` (`importlib.util.find_spec` is none)."""
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib._"):
        frame = frame.f_back
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] in _PACKAGES


def name_what_is_missing() -> None:
    """Append the finder of `MissingPackage` to `sys.meta_path`, once."""
    if not any(isinstance(finder, _NameMissing) for finder in sys.meta_path):
        sys.meta_path.append(_NameMissing())
