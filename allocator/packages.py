"""Errors of missing libraries, with the command that installs them.

Libraries are imported by the function that uses them, so that `allocate` needs only NumPy. A finder behind all others
turns the failed imports of these packages' own files into a `MissingPackage`, which names the extra to install.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import FrameType

from allocator.errors import MissingPackage

_OURS = ("allocator", "mpc")
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


class _NameMissing(MetaPathFinder):
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        """Find nothing. Raises `MissingPackage` if a file of these packages imports it."""
        if fullname in _INSTALL and _imported_by_us(sys._getframe(1)):
            raise MissingPackage(fullname, _INSTALL[fullname])


def _imported_by_us(frame: FrameType | None) -> bool:
    """Return whether a file of these packages runs an `import`; looking for a module is none."""
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib._"):
        frame = frame.f_back
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] in _OURS


def name_what_is_missing() -> None:
    """Append the finder to `sys.meta_path`, once."""
    if not any(isinstance(finder, _NameMissing) for finder in sys.meta_path):
        sys.meta_path.append(_NameMissing())
