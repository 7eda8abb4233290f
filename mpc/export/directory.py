"""Files are written to a new directory here, all or none."""

import shutil
import tempfile
from os import PathLike
from pathlib import Path

from allocator.errors import InvalidInput
from mpc.export.parts import Files


def write(files: Files, out: str | PathLike[str]) -> Path:
    """Write `files` to the directory `out`, which must not exist or be empty; nothing is left behind by a failure."""
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
    """Check that `directory` is free."""
    if directory.exists() and not directory.is_dir():
        raise InvalidInput(f"out = {directory} is a file; give a directory that does not exist or is empty")
    if directory.is_dir() and any(directory.iterdir()):
        raise InvalidInput(f"out = {directory} is not empty; give a directory that does not exist or is empty")
