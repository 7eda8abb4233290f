"""Output of exported files as a new directory, all or none, and their compilation on this machine."""

import shutil
import subprocess
import tempfile
from os import PathLike
from pathlib import Path

from allocator.errors import AntagonistError, InvalidInput, MissingBackend
from mpc.export.parts import Files

_LONGEST = 300.0  # [s] of compiling


def write(files: Files, out: str | PathLike[str]) -> Path:
    """Write `files` to the directory `out`, which must not exist or must be empty; a failure leaves nothing behind."""
    directory = Path(out)
    check(directory)
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=directory.parent, prefix=".antagonist-export-") as made:
            draft = Path(made) / "draft"
            for name, content in files.items():
                path = draft / name
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(content, encoding="utf-8")
            if directory.exists():
                directory.rmdir()
            shutil.move(draft, directory)
    except OSError as error:
        raise InvalidInput(f"out = {directory} cannot be written ({error.strerror})") from None
    return directory


def check(directory: Path) -> None:
    """Check that `directory` does not exist or is empty. Raises `InvalidInput`."""
    if directory.exists() and not directory.is_dir():
        raise InvalidInput(f"out = {directory} is a file; give a directory that does not exist or is empty")
    if directory.is_dir() and any(directory.iterdir()):
        raise InvalidInput(f"out = {directory} is not empty; give a directory that does not exist or is empty")


COMPILERS = ("cc", "gcc", "clang")


def compiler() -> str:
    """Return the path of a C compiler. Raises `MissingBackend` if there is none."""
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    if found is None:
        raise MissingBackend("C compiler", "cc", [*COMPILERS, "after apt install gcc"])
    return found


def compile_c(what: str, directory: Path, *arguments: str) -> None:
    """Compile C in `directory`. Raises `AntagonistError`, and `MissingBackend` without a compiler."""
    command = [compiler(), "-std=c99", *arguments]
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=_LONGEST)
    if done.returncode:
        raise AntagonistError(f"{what} cannot be compiled: {done.stderr}")
