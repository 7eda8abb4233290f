"""Modules of compiled functions: a template and formulas as one cached Python module.

numba keeps compiled code next to its source file and checks no other file to decide whether that code is up to date.
All kept code therefore comes from modules in the user's cache directory, named by the hash of everything that they are
made from. Plants that differ only in their numbers share one. The text that runs is the one in memory; the files are
written for numba and for readers.
"""

import os
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from types import ModuleType

import numba

from allocator import units
from allocator.allocation import status
from allocator.allocation.two_muscles import kernels as compiled
from allocator.allocation.two_muscles.kernels import source as kernels
from allocator.compilation import jit
from allocator.compilation.cache import check_own, clear_stale
from allocator.files.atomic import write_text
from mpc.codegen.jit import KEPT

_MPC = Path(__file__).parents[1]
_CODEGEN = "jit", "addresses", "records", "tables", "views"


def with_formulas(template: Path, formulas: str) -> str:
    """Return the text of a template with the formulas and their imports inserted."""
    lines = template.read_text(encoding="utf-8").splitlines(keepends=True)
    start = next(i for i, line in enumerate(lines) if line.startswith("FORMULAS"))
    return "".join([*lines[:start], formulas, *lines[start + 2 :]])


@cache
def imported(text: str) -> ModuleType:
    """Return the module of this text, from the cache directory if it is cached."""
    version = f"{KEPT}{_hash(_surroundings(), numba.__version__, length=8)}_"
    name = version + _hash(text, length=24)
    directory = _directory()
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    check_own(directory)
    file = directory / f"{name}.py"
    if not _holds(file, text):
        write_text(file, text)
        clear_stale(directory, KEPT, version)
    module = ModuleType(name)
    module.__file__ = str(file)
    sys.modules[name] = module  # where numba looks when it loads cached code
    try:
        exec(compile(text, str(file), "exec"), vars(module))
    except BaseException:
        del sys.modules[name]
        raise
    return module


def _hash(*texts: str, length: int) -> str:
    return sha256("\0".join(texts).encode()).hexdigest()[:length]


def _holds(file: Path, text: str) -> bool:
    """Return whether `file` exists and is complete."""
    try:
        return file.read_bytes() == text.encode()
    except OSError:
        return False


@cache
def _surroundings() -> str:
    """Return the project code that may be compiled into a module."""
    files = [
        *sorted(_MPC.glob("*/compiled/**/*.py")),
        *sorted(file for part in ("arm", "model") for file in (_MPC / part).glob("*/compiled/*.py")),
        *(_MPC / "codegen" / f"{name}.py" for name in _CODEGEN),
        _MPC / "model" / "compiled_friction.py",
        _MPC / "model" / "experiment.py",
        _MPC / "tracking" / "resting.py",
        _MPC / "trials" / "many" / "driving.py",
        *(Path(str(m.__file__)) for m in (kernels, compiled, jit, status, units)),
    ]
    return "".join(file.read_text(encoding="utf-8") for file in files)


def _directory() -> Path:
    """Return the user's cache directory; raises an `OSError` if there is none.

    A relative XDG_CACHE_HOME is ignored, as the XDG Base Directory Specification asks.
    """
    given = {"win32": "LOCALAPPDATA", "darwin": ""}.get(sys.platform, "XDG_CACHE_HOME")
    below_home = {"win32": "AppData/Local", "darwin": "Library/Caches"}.get(sys.platform, ".cache")
    try:
        root = Path(os.environ.get(given, ""))
        return (root if root.is_absolute() else Path.home() / below_home) / "antagonist"
    except RuntimeError as error:
        raise FileNotFoundError(f"no directory to keep compiled code in: {error}") from None
