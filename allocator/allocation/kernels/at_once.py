"""Arrays of targets at once are answered by the kernels as operations of NumPy, digit for digit, without a compiler."""

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from allocator.allocation.kernels import source


@cache
def batch(name: str) -> Callable[..., tuple[int, int]]:
    """Return what does the work of `source`'s loop `<name>_batch` on whole arrays; made once, in some 20 ms."""
    from allocator.compilation.printer import Source, array_functions

    exact, odd = array_functions(Source.of(source), f"{name}_exact", "odd")

    def at_once(*arguments: Any) -> tuple[int, int]:
        *given, out = arguments
        with np.errstate(all="ignore"):  # of what lies in the branches that are not taken
            if strange := int(np.sum(odd(*given[:3]))):
                return strange, 0
            answers = exact(*given)
        for array, values in zip(out, answers, strict=True):
            array[...] = values
        return 0, int(np.count_nonzero(~out[6]))

    return at_once
