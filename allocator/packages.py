"""A library that is missing is named in one sentence, wherever in these packages it is wanted.

Each of them is imported only in the file that uses it and when it is used, so that `allocate` runs on NumPy alone.
What Python says where one is missing (ModuleNotFoundError) helps nobody to install it. So a finder stands behind all
others and turns the failed imports of our own files, and of nobody else's, into a `MissingPackage`.
"""

import sys
from collections.abc import Sequence
from importlib.abc import MetaPathFinder
from types import FrameType

from allocator.errors import MissingPackage

_OURS = ("allocator", "mpc")
_INSTALL = {  # what to say to pip; extras of ours bring versions that were tried
    "casadi": "casadi",
    "cma": "cma",
    "control": "control",
    "cvxpy": "cvxpy",
    "daqp": "daqp",
    "distributed": "'antagonist[dask]'",
    "gymnasium": "'antagonist[gym]'",
    "matplotlib": "matplotlib",
    "mcap": "'antagonist[ros]'",
    "mujoco": "'antagonist[mujoco]'",
    "numba": "numba",
    "osqp": "osqp",
    "pymodbus": "'antagonist[modbus]'",
    "qpsolvers": "qpsolvers",
    "rich": "typer rich",
    "rosbags": "'antagonist[ros]'",
    "scipy": "scipy",
    "serial": "'antagonist[serial]'",
    "typer": "typer rich",
}


class _NameMissing(MetaPathFinder):
    def find_spec(self, fullname: str, path: Sequence[str] | None, target: object = None) -> None:
        """Find nothing, and say so in our words if a file of ours imports it."""
        if fullname in _INSTALL and _imported_by_us(sys._getframe(1)):
            raise MissingPackage(fullname, _INSTALL[fullname])


def _imported_by_us(frame: FrameType | None) -> bool:
    """Return whether the `import` under way stands in a file of ours; to look for a module is no import."""
    while frame is not None and frame.f_code.co_filename.startswith("<frozen importlib._"):
        frame = frame.f_back
    name = "" if frame is None else str(frame.f_globals.get("__name__", ""))
    return name.partition(".")[0] in _OURS


def name_what_is_missing() -> None:
    """Put the finder behind all others, once."""
    if not any(isinstance(finder, _NameMissing) for finder in sys.meta_path):
        sys.meta_path.append(_NameMissing())
