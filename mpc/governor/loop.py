"""The kernel becomes a function here: compiled by numba with a mechanism's formulas, or plain Python with the same."""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from allocator.notices import notice
from mpc.governor import kernel
from mpc.tracking.qp.step import SlowStep

_PLACE = "FORMULAS: Any = None\nmotion = potential = FORMULAS\n"  # of the formulas, in the kernel's text
_COMPILED = """

from mpc.tracking.compiled.jit import compiled, inlined

motion, potential = inlined(motion), inlined(potential)
{inner} = map(inlined, ({inner}))
govern_batch = compiled(govern_batch)
"""


class Loop(NamedTuple):
    """A `Loop` is `mpc.governor.kernel.govern_batch` with formulas."""

    govern: Callable[..., None]
    compiled: bool


@cache
def plain_loop(formulas: str) -> Loop:
    """Return the kernel with the formulas in a text, as Python runs it."""
    names: dict[str, Any] = {"__name__": "mpc.governor.kernel with formulas"}
    exec(compile(_with(formulas), "mpc/governor/kernel.py with formulas", "exec"), names)
    return Loop(names["govern_batch"], False)


@cache
def compiled_loop(formulas: str) -> Loop:
    """Return it for numba, which compiles at the first call; plain, with a `SlowStep` warning, where it cannot."""
    try:
        from mpc.tracking.compiled.module import imported

        inner = ", ".join(function.__name__ for function in kernel.FUNCTIONS)
        return Loop(imported(_with(formulas) + _COMPILED.format(inner=inner)).govern_batch, True)
    except (ImportError, OSError) as failure:  # no numba, or no place for what it compiles
        notice(f"the governor is not compiled and takes some thousand times as long: {failure}", SlowStep)
    return plain_loop(formulas)


def _with(formulas: str) -> str:
    head, place, rest = Path(str(kernel.__file__)).read_text(encoding="utf-8").partition(_PLACE)
    assert place
    return head + formulas + rest


__all__ = ["Loop", "compiled_loop", "plain_loop"]
