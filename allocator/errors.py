"""Everything that `antagonist` raises on purpose.

AntagonistError
├── InvalidInput (also a ValueError)   an argument that makes no sense, with its value and the unit expected
│   └── InvalidFile                    a file that cannot be read, with its line and column
├── MissingBackend (also a ValueError) a method or solver that does not exist here, with the ones that do
│   └── MissingPackage (also a ModuleNotFoundError)  a library that is not installed, with the line that does
└── CannotWrite (also an OSError)      a file that cannot be written, and why
"""

from collections.abc import Iterable


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
