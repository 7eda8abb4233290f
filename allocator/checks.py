"""Checks of what comes in from outside: one clear sentence for every wrong input."""

from typing import Any

import numpy as np

from allocator.calculus import Array, is_symbol
from allocator.errors import InvalidInput
from allocator.units import DEG

_LOOKS_LIKE_BAR = 0.1, 20.0  # [Pa] if the greatest of some pressures lies here, bar was meant


def real(name: str, value: Any, unit: str) -> Array:
    """`value` as an array of finite floats."""
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError
        array = array.astype(float, copy=False)
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {value!r} is not a number or an array of numbers [{unit}]") from None
    if not np.isfinite(array).all():
        raise InvalidInput(f"{name}{at(array, ~np.isfinite(array))} is not finite [{unit}]")
    return array


def at(array: Array, wrong: Any) -> str:
    """'[3] = nan', the first element of `array` that is `wrong`; ' = nan' for a scalar."""
    index = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(wrong)))
    place = f"[{', '.join(map(str, index))}]" if array.ndim else ""
    return f"{place} = {np.atleast_1d(array)[index]:g}"


def angle(name: str, value: Any) -> Array:
    """An angle [rad]; more than a turn is taken for degrees and refused."""
    array = real(name, value, "rad")
    if (wrong := np.abs(array) > 2 * np.pi).any():
        shown = at(array, wrong)
        degrees = float(np.atleast_1d(array)[np.atleast_1d(wrong)][0])
        raise InvalidInput(f"{name}{shown} rad is over a turn; if degrees were meant, pass {degrees * DEG:.4g} rad")
    return array


def stiffness(name: str, value: Any) -> Array:
    """A stiffness [N·m/rad], positive."""
    array = real(name, value, "N·m/rad")
    if (wrong := array <= 0).any():
        raise InvalidInput(f"{name}{at(array, wrong)} N·m/rad has to be positive")
    return array


def pressure(name: str, value: Any) -> Array:
    """Gauge pressure(s) [Pa]; values that can only be bar are refused."""
    array = real(name, value, "Pa")
    greatest = float(np.abs(array).max(initial=0.0))
    if _LOOKS_LIKE_BAR[0] <= greatest <= _LOOKS_LIKE_BAR[1]:
        raise InvalidInput(f"{name}{at(array, array != 0)} Pa is next to nothing; if bar was meant, multiply by 1e5")
    return array


def force(name: str, value: Any) -> float | None:
    """One force [N], not negative; None passes."""
    if value is None:
        return None
    array = real(name, value, "N")
    if array.ndim or array < 0:
        raise InvalidInput(f"{name} = {value!r} N has to be one number that is not negative")
    return float(array)


def slew(previous: Any, max_step: Any) -> dict[str, Array]:
    """Previous pressures and greatest step, by name; empty when there is no slew limit."""
    if (previous is None) is not (max_step is None):
        raise InvalidInput("previous and max_step go together; one came without the other")
    if previous is None:
        return {}
    try:
        P1, P2 = previous
    except (TypeError, ValueError):
        raise InvalidInput(f"previous = {previous!r} has to be the two pressures (P1, P2) [Pa]") from None
    step = pressure("max_step", max_step)
    if (step <= 0).any():
        raise InvalidInput(f"max_step{at(step, step <= 0)} Pa has to be positive")
    now = real("previous", P1, "Pa"), real("previous", P2, "Pa")
    pressure("previous", np.concatenate([np.ravel(P) for P in now]))
    return {"previous P1": now[0], "previous P2": now[1], "max_step": step}


def pressure_or_symbol(name: str, value: Any) -> Any:
    """The same, but CasADi symbols pass."""
    return value if is_symbol(value) else pressure(name, value)


def angle_or_symbol(name: str, value: Any) -> Any:
    """An angle, but CasADi symbols pass."""
    return value if is_symbol(value) else angle(name, value)


def broadcast(**arrays: Array) -> tuple[Array, ...]:
    """All arrays in their common shape; an error that names the shapes when there is none."""
    try:
        return np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise InvalidInput(f"shapes do not broadcast: {shapes}") from None


__all__ = [
    "angle",
    "angle_or_symbol",
    "at",
    "broadcast",
    "force",
    "pressure",
    "pressure_or_symbol",
    "real",
    "slew",
    "stiffness",
]
