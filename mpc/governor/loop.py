"""Loop over commands, compiled by numba from the kernel and a mechanism's formulas, or plain Python.

numba needs as much time to unpack thirty arrays as the kernel for several commands. Its numbers and memory are
therefore parts of one table, and the states and commands rows of another.
"""

from collections.abc import Callable
from functools import cache
from itertools import accumulate, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import notice
from mpc.governor import kernel
from mpc.tracking.qp.step import SlowStep

_PLACE = "FORMULAS: Any = None\nmotion = potential = FORMULAS\n"  # of the formulas, in the kernel's text
_LOOP = '''

def govern_rows(table, counts, rows, safe, status):
    """Govern the commands in `rows` (N, 2n + 3m) of q, ω, P, the last command and the next."""
    rules = Rules({rules})
    memory = Memory({memory})
    for i in range(len(status)):
        status[i] = govern(rules, {row}, safe[i], memory)
'''
_COMPILED = """

from allocator.compilation.jit import compiled, register

register((motion, potential), inline=False, unaliased=True)  # which are long
govern_rows = compiled(govern_rows, FUNCTIONS, inline=True, unaliased=True)
"""


class Loop(NamedTuple):
    """Function that fills `safe` (N, m) and `status` (N): (table, counts, rows, safe, status) ↦ None."""

    govern: Callable[..., None]
    compiled: bool


class Packed(NamedTuple):
    """Numbers and memory of a kernel, and the text of the loop that unpacks them."""

    table: Array
    counts: NDArray[np.int64]
    text: str


def packed(formulas: str, rules: kernel.Rules, memory: kernel.Memory) -> Packed:
    """Return the table of `rules` and `memory`, and the kernel's text with the `formulas` and the loop."""
    parts: list[Array | NDArray[np.int64]] = [*rules, *memory]
    ends = [0, *accumulate(part.size for part in parts if part is not rules.counts)]
    views = iter(pairwise(ends))
    texts = ["counts" if part is rules.counts else _view("table[{}:{}]", part, *next(views)) for part in parts]
    n, m = memory.angles.size, memory.pressures.size
    states = [0, *accumulate((n, n, m, m, m))]
    row = ", ".join(f"rows[i, {begin}:{end}]" for begin, end in pairwise(states))
    given = {"rules": ", ".join(texts[: len(rules)]), "memory": ", ".join(texts[len(rules) :]), "row": row}
    table = np.concatenate([part.ravel() for part in parts if part is not rules.counts])
    head, place, rest = Path(str(kernel.__file__)).read_text(encoding="utf-8").partition(_PLACE)
    assert place
    return Packed(table, rules.counts, head + formulas + rest + _LOOP.format(**given))


def _view(text: str, part: Array | NDArray[np.int64], begin: int, end: int) -> str:
    shape = f".reshape({', '.join(map(str, part.shape))})" if part.ndim > 1 else ""
    return text.format(begin, end) + shape


@cache
def plain_loop(text: str) -> Loop:
    """Return the loop of a `Packed.text` as a Python function."""
    names: dict[str, Any] = {"__name__": "mpc.governor.kernel with formulas"}
    exec(compile(text, "mpc/governor/kernel.py with formulas", "exec"), names)
    return Loop(names["govern_rows"], False)


@cache
def compiled_loop(text: str) -> Loop:
    """Return the loop compiled at its first call; if that fails, warn with `SlowStep` and return the plain one."""
    reason = "numba is missing, or told not to compile"
    try:
        from mpc.codegen.modules import imported

        made = imported(text + _COMPILED).govern_rows
        if made is not None:
            return Loop(made, True)
    except (ImportError, OSError) as failure:  # no numba, or no writable cache
        reason = str(failure)
    notice(f"the governor is not compiled and takes about a thousand times as long: {reason}", SlowStep)
    return plain_loop(text)
