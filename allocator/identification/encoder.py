"""Encoder zeros in the comments of logs: the angle that a loop has subtracted from the readings of its encoder.

Fits determine the zero of the encoder, and a joint's file stores it for the next loop. They need the readings, so
readers of logs add the zero again.
"""

import re
from collections.abc import Iterable

from allocator.units import DEG

_REMARK = re.compile(r"#\s*encoder zero (\S+) rad \(\S+\), subtracted from theta\s*")


def remark(zero: float, column: str = "theta") -> str:
    """Return the comment of a log whose angles in a `column` are the readings less `zero` [rad]."""
    return f"encoder zero {zero!r} rad ({zero / DEG:.4g}°), subtracted from {column}"


def subtracted(lines: Iterable[str]) -> float:
    """Return the zero [rad] in the comments of a log, 0 if there is none."""
    return next((float(found[1]) for line in lines if (found := _REMARK.fullmatch(line))), 0.0)
