"""Printing of commands: sentences, and JSON for other programs."""

import json
import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
import typer

from allocator.lazy import Console

AsJSON = Annotated[
    bool, typer.Option("--json", help="print JSON instead of text; its names carry their units, e.g. P1_bar")
]


def say(console: "Console", sentence: str) -> None:
    """Print `sentence` as it is, however long."""
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
