"""Output of commands: sentences, JSON for other programs, and files.

A command never overwrites its inputs, and other files only with --force.
"""

import json
import math
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from allocator.errors import InvalidInput
from allocator.files.atomic import check_writable
from allocator.lazy import Console

AsJSON = Annotated[
    bool, typer.Option("--json", help="print JSON instead of text; its names carry their units, e.g. P1_bar")
]


def say(console: "Console", *sentences: str) -> None:
    """Print each sentence as it is, however long; an empty one is skipped."""
    for sentence in filter(None, sentences):
        console.print(sentence, highlight=False, markup=False, soft_wrap=True)


def print_json(values: Mapping[str, object]) -> None:
    """Print `values` as JSON, in ASCII; a number that is not finite becomes null."""
    print(json.dumps(_plain(values), indent=2, allow_nan=False))


def _plain(value: object) -> object:
    """Turn NumPy's values into Python's, for the standard library's JSON."""
    if isinstance(value, dict):
        return {str(name): _plain(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part) for part in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


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


def claim_result(
    out: Path | None, plot: Path | None, *others: Path | None, inputs: Iterable[str | Path | None], force: bool
) -> None:
    """Check that a result can be written to --out, a TOML file, and drawn to --plot; see `claim`."""
    check_ending("--plot", plot, IMAGES)
    claim(out, plot, *others, inputs=inputs, force=force)
    check_toml("--out", out)


def write(path: Path | None, save: Callable[[Path], object], console: "Console") -> None:
    """Write a file by `save` and say so; None is skipped."""
    if path is not None:
        save(path)
        say(console, f"written: {path}")


def check_toml(option: str, path: Path | None) -> None:
    """Insist that `path` ends in .toml, by which --machine and --muscle know it; /dev/stdout and the like need not."""
    if path is not None and not (path.is_char_device() or path.is_fifo()):
        check_ending(option, path, (".toml",))


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
        raise InvalidInput(
            f"{option} {path}: the ending has to be {'one of ' * (len(endings) > 1)}{', '.join(endings)}"
        )
