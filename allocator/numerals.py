"""Numbers as people read them."""

from typing import Any

_NOISE = 1e-12  # below it a quantity in N·m, N, bar or degrees is the rounding error of a zero


def shown(value: Any, digits: int = 4) -> str:
    """`value` with so many significant digits, and rounding errors of a zero as 0.

    >>> shown(-8.9e-16), shown(2.31458)
    ('0', '2.315')
    """
    return "0" if abs(value) < _NOISE else f"{value:.{digits}g}"


__all__ = ["shown"]
