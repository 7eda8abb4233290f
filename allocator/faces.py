"""Public faces of packages, whose names are listed once and imported on first use.

The `__init__.py` of such a package imports its public names for type checkers only:

    if TYPE_CHECKING:
        from mpc.model.plant import Plant as Plant
    else:
        __all__, __getattr__, __dir__ = face(__name__, __file__)

`face` reads this list, so that `dir()`, tab completion and `from mpc import *` show the same names. Sub-packages such
as `mpc.export` are also imported on first use.
"""

import ast
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def face(package: str, file: str) -> tuple[list[str], Callable[[str], Any], Callable[[], list[str]]]:
    """Return `__all__`, `__getattr__` and `__dir__` of the package whose `__init__.py` is `file`."""
    homes = _homes(Path(file).read_text(encoding="utf-8"))
    rooms = {inner.parent.name for inner in Path(file).parent.glob("*/__init__.py")}

    def getattr_(name: str) -> Any:
        """Return the public name or sub-package `name`, imported. Raises `AttributeError` for others."""
        if name in rooms:
            return import_module(f"{package}.{name}")
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        value = getattr(import_module(homes[name]), name)
        setattr(sys.modules[package], name, value)
        return value

    def dir_() -> list[str]:
        """Return the public names."""
        return sorted(homes)

    return sorted(homes), getattr_, dir_


def _homes(text: str) -> dict[str, str]:
    """Return the modules of the names that `text` imports under TYPE_CHECKING."""
    blocks = (node.body for node in ast.parse(text).body if isinstance(node, ast.If) and _for_types(node.test))
    imports = (node for body in blocks for node in body if isinstance(node, ast.ImportFrom))
    return {alias.name: str(node.module) for node in imports for alias in node.names}


def _for_types(test: ast.expr) -> bool:
    """Return whether a condition is `TYPE_CHECKING`."""
    return isinstance(test, ast.Name) and test.id == "TYPE_CHECKING"
