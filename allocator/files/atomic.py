"""Atomic writing of files: readers see the old file until the new one is complete.

The content goes to a temporary file next to the target, which then replaces the target.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from allocator.errors import CannotWrite


@contextmanager
def replacing(path: str | PathLike[str]) -> Iterator[Path]:
    """Yield a temporary path with the suffix of `path`; on exit its file replaces `path`.

    Missing directories are created. Links are followed; devices and pipes are written to directly. Raises
    `CannotWrite`; a failure leaves an older `path` unchanged.
    """
    try:
        target = Path(os.path.realpath(path))
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.exists() and not target.is_file() and not target.is_dir():
            yield target
            return
        check_writable(target)
        draft = target.with_name(f".{target.stem[:64]}-{os.urandom(8).hex()}{target.suffix}")
        try:
            yield draft
            if target.exists():
                draft.chmod(target.stat().st_mode)
            os.replace(draft, target)
        finally:
            draft.unlink(missing_ok=True)
    except CannotWrite:
        raise
    except OSError as error:
        raise CannotWrite(path, error) from error


def check_writable(path: str | PathLike[str]) -> None:
    """Raise `CannotWrite` if `path` is a directory, below a file, or if it or its directory is write-protected."""
    target = Path(path)
    try:
        directory = target.is_dir()
    except OSError as error:  # such as a name that is too long
        raise CannotWrite(path, error) from None
    if directory:
        raise CannotWrite(path, "it is a directory")
    if target.exists() and not os.access(target, os.W_OK):
        raise CannotWrite(path, "it is write-protected")
    above = next(folder for folder in target.absolute().parents if folder.exists())
    if not above.is_dir():
        raise CannotWrite(path, f"{above.name} is a file, not a directory")
    if (target.is_file() or not target.exists()) and not os.access(above, os.W_OK):
        raise CannotWrite(path, f"the directory {above} is write-protected")


def write_text(path: str | PathLike[str], text: str) -> None:
    """Write `text` to `path` in UTF-8, atomically. Raises `CannotWrite`."""
    with replacing(path) as draft:
        draft.write_text(text, encoding="utf-8", newline="")
