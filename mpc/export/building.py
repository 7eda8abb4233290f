"""Output of exported files as a new directory, all or none, and their compilation on this machine."""

import shutil
import subprocess
import sys
import tempfile
from os import PathLike
from pathlib import Path

from allocator.errors import AntagonistError, InvalidInput, MissingBackend
from mpc.export.parts import Files

_LONGEST = 1800.0  # [s] of compiling; Zig builds the C library of a new target first


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


def compiler(target: str | None = None) -> list[str]:
    """Return the command of a C compiler, by default this machine's; for a `target` of Zig's, the package ziglang.

    Raises `MissingBackend` if there is none, and `MissingPackage`.
    """
    if target is not None:
        import ziglang  # noqa: F401, refused with the command that installs it

        return [sys.executable, "-m", "ziglang", "cc", "-target", target]
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    if found is None:
        raise MissingBackend("C compiler", "cc", [*COMPILERS, "after apt install gcc"])
    return [found]


def compile_c(what: str, directory: Path, *arguments: str, target: str | None = None) -> None:
    """Compile C in `directory`, for this machine or a `target`. Raises `AntagonistError` and those of `compiler`."""
    command = [*compiler(target), "-std=c99", *arguments]
    done = subprocess.run(command, cwd=directory, capture_output=True, text=True, timeout=_LONGEST)
    if done.returncode:
        raise AntagonistError(f"{what} cannot be compiled: {done.stderr}")
