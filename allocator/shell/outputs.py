"""Checks of output files: a command never overwrites its inputs, and other files only with --force."""

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated

import typer

from allocator.errors import InvalidInput
from allocator.files.atomic import check_writable

Force = Annotated[bool, typer.Option("--force", help="replace files that exist")]

IMAGES = (".png", ".pdf", ".svg")


def claim(
    *outputs: Path | None, inputs: Iterable[str | Path | None] = (), force: bool = False, own: Iterable[str] = ()
) -> None:
    """Check that `outputs` can be written, before any work; None is skipped.

    Raises `InvalidInput` for one of the `inputs`, for the same file twice, and for a file that exists, unless `force`
    or its name is among the command's `own`. Raises `CannotWrite` for a directory or a write-protected file.
    """
    read = {Path(os.path.realpath(path)) for path in inputs if path is not None}
    seen: set[Path] = set()
    for path in (path for path in outputs if path is not None):
        target = Path(os.path.realpath(path))
        if target in read or any(target.exists() and one.exists() and target.samefile(one) for one in read):
            raise InvalidInput(f"{path} is read by this command and cannot be written by it; give another name")
        if target in seen:
            raise InvalidInput(f"{path} is to be written twice; give two names")
        check_writable(path)
        if target.is_file() and not force and path.name not in own:
            raise InvalidInput(f"{path} exists; give another name, or --force to replace it")
        seen.add(target)


def files_of_run(out: Iterable[Path], endings: tuple[str, ...], own: Iterable[str]) -> list[Path]:
    """Return the files of a run that --out names: each itself, or a directory's files of the `own` names."""
    files = []
    for path in out:
        if path.suffix and path.suffix.lower() not in endings:
            raise InvalidInput(f"--out {path}: a run is written as {', '.join(endings)} or into a directory")
        files += [path] if path.suffix else [path / name for name in own]
    return files


def check_ending(option: str, path: Path | None, endings: tuple[str, ...]) -> None:
    """Insist that the ending of `path` is one of these."""
    if path is not None and path.suffix.lower() not in endings:
        raise InvalidInput(f"{option} {path}: the ending has to be one of {', '.join(endings)}")
