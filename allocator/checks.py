"""Checks of input from outside: one clear sentence for every wrong value."""

import operator
from collections.abc import Iterable
from math import inf, nan
from types import UnionType
from typing import Any, SupportsIndex

import numpy as np

from allocator.calculus import Array, Mask, Value, is_symbol
from allocator.errors import InvalidInput
from allocator.units import DEG

LONGEST, SLOWEST = 1.0, 10.0  # [s] of a delay, and of a time constant
LOOKS_LIKE_BAR = 0.1, 20.0  # [Pa] if the greatest of some pressures lies here, bar was meant


REAL = frozenset((int, float, *(np.dtype(code).type for code in np.typecodes["AllInteger"] + np.typecodes["Float"])))
"""The types of real numbers: Python's and NumPy's, truth values not among them."""
_SEQUENCES = frozenset((tuple, list, np.ndarray))


def real(name: str, value: object, unit: str) -> Array:
    """Return `value` as an array of finite floats: a number, or anything that NumPy takes for an array of real ones."""
    array = floats(name, value, unit)
    if not np.isfinite(array).all():
        raise InvalidInput(f"{name}{at(array, ~np.isfinite(array))} is not finite [{unit}]")
    return array


def floats(name: str, value: object, unit: str) -> Array:
    """Return `value` as an array of floats, which need not be finite."""
    _refuse_masks_and_units(name, value, unit)
    try:
        array = np.asarray(value)
        if array.dtype.kind not in "fiu":
            raise TypeError
        return array.astype(float, copy=False)
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {brief(value)} is not a number or an array of real numbers [{unit}]") from None


def _refuse_masks_and_units(name: str, value: object, unit: str) -> None:
    """Refuse masks, and the units of pint, astropy and the like, which `np.asarray` would drop silently."""
    if isinstance(value, list | tuple):
        for item in value:
            if type(item) is not float:
                _refuse_masks_and_units(name, item, unit)
    elif isinstance(value, np.ma.MaskedArray):
        if masked := int(np.sum(value.mask)):
            raise InvalidInput(f"{name} has {masked} masked of {value.size} elements; leave them out or fill them")
    elif hasattr(type(value), "units") or hasattr(type(value), "unit"):
        raise InvalidInput(f"{name} = {brief(value)} carries a unit of its own; pass plain numbers in {unit}")


def brief(value: object) -> str:
    """Describe `value` in one line: itself or its beginning, but of a long array shape and kind of elements."""
    shown = repr(value)
    if len(shown) <= 60 and "\n" not in shown:
        return shown
    if isinstance(value, list | tuple | str):
        return f"{' '.join(shown.split())[:56]} …"
    shape, dtype = getattr(value, "shape", None), getattr(value, "dtype", None)
    return f"{type(value).__name__}{shape or ''}" + (f" of {dtype}" if dtype is not None else "")


def count(name: str, value: SupportsIndex, least: int, most: int | None = None) -> int:
    """Return a whole number, `least` or more, and not over `most`."""
    try:
        number = operator.index(value)
    except TypeError:
        number = least - 1
    if number < least:
        raise InvalidInput(f"{name} = {value!r} has to be a whole number, {least} or more")
    if most is not None and number > most:
        raise InvalidInput(f"{name} = {number!s:.15} is over {most}, the most that is taken")
    return number


def at(array: Array, wrong: Mask) -> str:
    """Return '[3] = nan', the first element of `array` that is `wrong`; ' = nan' for a scalar."""
    index = tuple(int(i[0]) for i in np.nonzero(np.atleast_1d(wrong)))
    place = f"[{', '.join(map(str, index))}]" if array.ndim else ""
    return f"{place} = {np.atleast_1d(array)[index]:g}"


def angle(name: str, value: object) -> Array:
    """Return an angle [rad]; more than a turn is taken for degrees and refused."""
    array = real(name, value, "rad")
    if (wrong := np.abs(array) > 2 * np.pi).any():
        shown = at(array, wrong)
        degrees = float(np.atleast_1d(array)[np.atleast_1d(wrong)][0])
        raise InvalidInput(f"{name}{shown} rad is over a turn; if degrees were meant, pass {degrees * DEG:.4g} rad")
    return array


def contraction(name: str, value: object) -> Array:
    """Return a contraction ratio; more than 1 is taken for percent and refused."""
    array = real(name, value, "ratio")
    if (wrong := np.abs(array) > 1).any():
        raise InvalidInput(f"{name}{at(array, wrong)} is no contraction ratio; if percent was meant, divide by 100")
    return array


def stiffness(name: str, value: object) -> Array:
    """Return a stiffness [N·m/rad], positive."""
    array = real(name, value, "N·m/rad")
    if (wrong := array <= 0).any():
        raise InvalidInput(f"{name}{at(array, wrong)} N·m/rad has to be positive")
    return array


def pressure(name: str, value: object) -> Array:
    """Return gauge pressure(s) [Pa]; values that can only be bar are refused."""
    array = real(name, value, "Pa")
    greatest = float(np.abs(array).max(initial=0.0))
    if LOOKS_LIKE_BAR[0] <= greatest <= LOOKS_LIKE_BAR[1]:
        raise InvalidInput(f"{name}{at(array, array != 0)} Pa is next to nothing; if bar was meant, multiply by 1e5")
    return array


def pressure_and_contraction(P: Value, eps: Value) -> tuple[Value, Value]:
    """Return the arguments of a force law, P [Pa] and ε [-]; CasADi symbols and complex numbers pass."""
    if any(is_symbol(x) or (isinstance(x, complex | np.ndarray) and np.iscomplexobj(x)) for x in (P, eps)):
        return P, eps
    ratio, greatest = real("eps", eps, "ratio"), np.abs(real("P", P, "Pa")).max(initial=0.0)
    if (wrong := np.abs(ratio) > 1).any():
        swapped = greatest <= 1 and (greatest > 0 or np.abs(ratio).max() > 100)
        hint = "P and eps look swapped, the pressure comes first" if swapped else "if percent was meant, divide by 100"
        raise InvalidInput(f"eps{at(ratio, wrong)} is no contraction ratio (l0 - l)/l0; {hint}")
    return _as_number(P, pressure("P", P)), _as_number(eps, ratio)


def _as_number(value: Value, checked: Array) -> Value:
    """Return `value` itself if it is a number, so that the answer is one too."""
    return value if isinstance(value, float | int) else checked


def positive_pressure(name: str, value: object) -> Array:
    """Return a pressure [Pa] above zero."""
    array = pressure(name, value)
    if (wrong := array <= 0).any():
        raise InvalidInput(f"{name}{at(array, wrong)} Pa has to be positive")
    return array


def pressure_pair(name: str, value: Iterable[object] | None, labels: tuple[str, str]) -> dict[str, Array]:
    """Return the pressures (P1, P2) [Pa], under the names `labels`."""
    if isinstance(value, np.ndarray) and value.shape == (2, 2):
        raise InvalidInput(
            f"{name} of the shape (2, 2) is two arrays or two targets' rows of pressures; write (P1, P2) [Pa]"
        )
    try:
        P1, P2 = () if value is None else value
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {brief(value)} has to be two pressures (P1, P2) [Pa]") from None
    pair = real(name, P1, "Pa"), real(name, P2, "Pa")
    pressure(name, np.concatenate([np.ravel(P) for P in pair]))
    return dict(zip(labels, pair, strict=True))


def axis(name: str, value: object, ndim: int) -> int | None:
    """Return an axis of targets, counted from 0, or None."""
    if value is None:
        return None
    if not isinstance(value, int | np.integer) or isinstance(value, bool) or not -ndim <= value < ndim:
        raise InvalidInput(f"{name} = {brief(value)} is no axis of the targets, which have {ndim}")
    return int(value) % ndim


def one_of(name: str, value: object, among: Iterable[str]) -> str:
    """Return one of the words `among`."""
    words = tuple(among)
    if not isinstance(value, str) or value not in words:
        raise InvalidInput(f"{name} = {brief(value)} is unknown; choose one of {', '.join(words)}")
    return value


def flag(name: str, value: object) -> bool:
    """Return a truth value, True or False."""
    if not isinstance(value, bool | np.bool_):
        raise InvalidInput(f"{name} = {brief(value)} has to be True or False")
    return bool(value)


def number(name: str, value: object, unit: str) -> float:
    """Return one finite real number."""
    array = real(name, value, unit)
    if array.ndim:
        raise InvalidInput(f"{name} = {brief(value)} has to be one number [{unit}]")
    return float(array)


def number_or_inf(name: str, value: object, unit: str) -> float:
    """Return one real number, which may be infinite."""
    return value if isinstance(value, float) and value == inf else number(name, value, unit)


def row(name: str, value: object) -> tuple[Any, ...]:
    """Return the entries of a tuple, a list or an array with one axis."""
    if not isinstance(value, tuple | list) and np.ndim(value) != 1:  # type: ignore[arg-type]  # any object has one
        raise InvalidInput(f"{name} = {brief(value)} has to be a row of values")
    return tuple(value)  # type: ignore[arg-type]  # it has an axis


def pair(name: str, value: Any, expected: str) -> tuple[Any, Any]:
    """Return both parts of a pair, or raise `InvalidInput` with a sentence that ends in `expected`."""
    try:
        first, second = value
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {brief(value)} {expected}") from None
    return first, second


def instance(name: str, value: object, kind: type | UnionType, known: str) -> None:
    """Insist that `value` is of this kind, in words `known`."""
    if not isinstance(value, kind):
        raise InvalidInput(f"{name} = {brief(value)} has to be {known}")


def not_negative(name: str, value: object, unit: str) -> float:
    """Return one number that is zero or more."""
    found = number(name, value, unit)
    if found < 0:
        raise InvalidInput(f"{name} = {brief(value)} has to be one number that is not negative [{unit}]")
    return found


def positive(name: str, value: object, unit: str) -> float:
    """Return one number above zero."""
    found = number(name, value, unit)
    if found <= 0:
        raise InvalidInput(f"{name} = {brief(value)} has to be one number above 0 [{unit}]")
    return found


def delay(name: str, value: object, part: str, longest: float = LONGEST) -> float:
    """Return a delay [s] of a `part`, such as a sensor, or its time constant; over `longest` are milliseconds."""
    found = not_negative(name, value, "s")
    if found > longest:
        raise InvalidInput(f"{name} = {found:g} s is none of a {part}; if milliseconds were meant, divide by 1000")
    return found


def limits(name: str, value: object, unit: str) -> tuple[float, float]:
    """Return a lower and an upper limit, two numbers."""
    array = real(name, value, unit)
    if array.shape != (2,):
        raise InvalidInput(f"{name} = {brief(value)} has to be two numbers (lower, upper) [{unit}]")
    return float(array[0]), float(array[1])


def probability(name: str, value: object) -> float:
    """Return a number between 0 and 1/2, exclusive."""
    found = number(name, value, "probability")
    if not 0 < found < 0.5:
        raise InvalidInput(f"{name} = {value!r} has to be a probability between 0 and 0.5, such as 0.05")
    return found


def covariance(name: str, value: object, size: int | None = None) -> tuple[tuple[float, ...], ...]:
    """Return the rows of a covariance matrix, of `size` parameters if given: symmetric, no variance negative."""
    expected = "a square matrix of finite numbers" if size is None else f"{size} rows of {size} finite numbers"
    try:
        C = real(name, value, "products of the parameters' units")
    except InvalidInput:
        raise InvalidInput(f"{name} = {brief(value)} is no covariance, {expected}") from None
    if C.ndim != 2 or C.shape != (size or len(C),) * 2:
        raise InvalidInput(f"{name} has to be {expected}, got shape {C.shape}")
    scale = np.sqrt(np.abs(np.diag(C)))
    scale = np.where(scale > 0, scale, 1.0)
    correlation = C / scale / scale[:, None]
    if not np.allclose(correlation, correlation.T, rtol=0, atol=1e-8):
        raise InvalidInput(f"{name} has to be symmetric, as a covariance is")
    if np.linalg.eigvalsh(correlation).min(initial=0.0) < -1e-8:
        raise InvalidInput(f"{name} has a negative eigenvalue: a covariance is positive semi-definite")
    return tuple(map(tuple, C.tolist()))


def pressures_or_symbols(P1: Value, P2: Value) -> tuple[Value, Value]:
    """Return gauge pressures [Pa] of both muscles, of which one may be next to nothing; CasADi symbols pass."""
    if is_symbol(P1) or is_symbol(P2):
        return P1, P2
    pair = real("P1", P1, "Pa"), real("P2", P2, "Pa")
    if max(np.abs(P).max(initial=0.0) for P in pair) <= LOOKS_LIKE_BAR[1]:
        return pressure("P1", pair[0]), pressure("P2", pair[1])
    return pair


def angle_or_symbol(name: str, value: Value) -> Value:
    """Return an angle [rad], but let CasADi symbols pass."""
    return value if is_symbol(value) else angle(name, value)


def broadcast(**arrays: Array) -> tuple[Array, ...]:
    """Return all arrays in their common shape; an error that names the shapes when there is none."""
    try:
        return np.broadcast_arrays(*arrays.values())
    except ValueError:
        shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
        raise InvalidInput(f"shapes do not broadcast: {shapes}") from None


def fitting(**values: Value) -> tuple[Any, ...]:
    """Return arrays whose shapes broadcast; CasADi symbols pass."""
    if len({array.shape for array in values.values() if array.shape}) > 1 and not any(map(is_symbol, values.values())):
        broadcast(**values)
    return tuple(values.values())


# --- numbers that may be none ---------------------------------------------------------------------------------------


def float_or_nan(x: Any) -> float:
    """Return `x` as a float where it is one real number of Python's or NumPy's, a 0-d array included; else NaN.

    No range includes NaN, so that a check of the range needs no check of the type.
    """
    if type(x) is float:
        return x
    kind = type(x)
    if kind in REAL or (kind is np.ndarray and not x.ndim and x.dtype.type in REAL):
        try:
            return float(x)
        except OverflowError:  # an integer of more than 308 digits
            return nan
    return nan


def pair_or_nan(x: Any) -> tuple[Any, Any]:
    """Return both pressures in a tuple, list or array of two; NaN for anything else."""
    if type(x) is tuple and len(x) == 2:
        return x
    if type(x) not in _SEQUENCES or getattr(x, "shape", None) == (2, 2):  # which are pairs or rows
        return nan, nan
    try:
        P1, P2 = x
    except (TypeError, ValueError):  # of no length, of another length
        return nan, nan
    return P1, P2
