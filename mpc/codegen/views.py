"""Views of arrays by name, for Python and for compiled code.

A named tuple states the shapes of its fields, some of which depend on sizes: `x: Annotated[Array, "N + 1", 4]`. The
fields lie in one flat array, in this order, including numbers and nested tuples; the caller supplies fields without a
shape. Sizes that are known beforehand are constants of the generated functions. These are generated as text, because
numba cannot compile code that reads annotations.
"""

import ast
import inspect
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from math import prod
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import populate_array
from numpy.typing import ArrayLike

from allocator.calculus import Array
from mpc.codegen.jit import inlined

if TYPE_CHECKING:
    from numba.core.types import Type


def part(flat: Array, begin: int, shape: tuple[int, ...]) -> Array:
    """Return the part of `flat` of this `shape` that starts at `begin`.

    Compiled code checks no sizes and counts no references: the part is valid while `flat` lives. numba compiles it in
    half the time of a slice that is reshaped.
    """
    return flat[begin : begin + prod(shape)].reshape(shape)


@type_callable(part)  # type: ignore[untyped-decorator]  # numba has no types
def _typed(context: object) -> Callable[..., object]:
    def typed(flat: Any, begin: "Type", shape: Any) -> "Type | None":
        if not isinstance(flat, types.Array) or (flat.ndim, flat.layout) != (1, "C"):
            return None
        made: Type = types.Array(flat.dtype, len(shape), "C")
        return made

    return typed


@lower_builtin(part, types.Array, types.Integer, types.BaseTuple)  # type: ignore[untyped-decorator, attr-defined]
def _lowered(context: Any, builder: Any, signature: Any, given: Sequence[Any]) -> object:
    """Return the array."""
    whole, (array, _, kinds) = context.get_value_type(types.intp), signature.args
    flat = context.make_array(array)(context, builder, given[0])
    sizes = zip(cgutils.unpack_tuple(builder, given[2]), kinds, strict=True)
    shape = [context.cast(builder, size, kind, types.intp) for size, kind in sizes]
    size = whole(context.get_abi_sizeof(context.get_data_type(array.dtype)))
    strides = [size]
    for length in shape[:0:-1]:
        strides.insert(0, builder.mul(strides[0], length))
    made, data = context.make_array(signature.return_type)(context, builder), builder.gep(flat.data, [given[1]])
    populate_array(made, data=data, shape=shape, strides=strides, itemsize=size, meminfo=None)
    return made._getvalue()


F = TypeVar("F", bound=Callable[..., object])
R = TypeVar("R")
_NAME = re.compile(r"[A-Za-z_]\w*")
_NUMBERS: dict[object, str] = {float: "{}", int: "int({})", bool: "{} != 0.0"}


def viewer(record: type[R], known: Mapping[str, int] = MappingProxyType({})) -> Callable[..., R]:
    """Return (flat, arrays without a shape, other sizes than the `known` ones) ↦ a `record` of views; a single size
    follows from the length.
    """
    text = _Text(record, known)
    sizes, begin = text.sizes, "    _0 = 0\n"
    if len(sizes) == 1:
        least = text.length(0)
        begin += f"    {sizes[0]} = (flat.size - {least}) // {text.length(1) - least}\n"
        sizes = []
    given = ", ".join(["flat", *text.arguments, *sizes])
    made = f"def viewed({given}):\n{begin}{''.join(text.lines)}    return {text.result}\n"
    return _compiled(record, made, text.records | {"part": part}, known)


def length_of(record: type, *sizes: int, known: Mapping[str, int] = MappingProxyType({})) -> int:
    """Return the length of the flat array of a `record` of views with the `known` sizes and these other `sizes`."""
    return _Text(record, known).length(*sizes)


def measure(record: type, known: Mapping[str, int] = MappingProxyType({})) -> Callable[..., int]:
    """Return other sizes than the `known` ones ↦ `length_of` a record, for compiled code."""
    text = _Text(record, known)
    return _compiled(record, f"def length({', '.join(text.sizes)}):\n    return {text.total}\n", {}, known)


def in_python(function: F) -> F:
    """Return the Python function behind a compiled one."""
    uncompiled: F = function.py_func  # type: ignore[attr-defined]
    return uncompiled


def flat(values: NamedTuple) -> Array:
    """Return the numbers of a record, in the order in which they are viewed."""
    return np.concatenate([np.ravel(value) for value in _leaves(values)]).astype(float)


def _compiled(record: type, text: str, space: Mapping[str, object], known: Mapping[str, int]) -> Callable[..., Any]:
    """Return the function of a `text`, which counts as one of the file that has the `record`.

    Its name includes that of the record and the `known` sizes. numba names compiled functions by module and function,
    and if two names are equal, one process loads the other function's code from the cache.
    """
    name = text[4 : text.index("(")]
    full = "_".join([name, record.__name__, *map(str, known.values())])
    made: dict[str, Any] = {"__name__": record.__module__, **space}
    exec(compile(text.replace(name, full, 1), inspect.getfile(record), "exec"), made)
    function: Callable[..., Any] = made[full]
    return inlined(function)


def _leaves(values: NamedTuple) -> Iterator[ArrayLike]:
    for name, hint in get_type_hints(type(values), include_extras=True).items():
        value = getattr(values, name)
        if hasattr(hint, "_fields"):
            yield from _leaves(value)
        elif hint in _NUMBERS or get_origin(hint) is Annotated:
            yield value


class _Text:
    """The text that makes a record of consecutive views."""

    def __init__(self, record: type, known: Mapping[str, int]) -> None:
        self._known = known
        self.records: dict[str, Any] = {}
        self.sizes: list[str] = []
        self.arguments: list[str] = []
        self.lines: list[str] = []
        self._lengths: list[str] = []
        self.result = self._record(record)

    @property
    def total(self) -> str:
        """The total length, an expression of the sizes."""
        return " + ".join(self._lengths)

    def length(self, *sizes: int) -> int:
        """Return the total length."""
        return int(eval(self.total, dict(zip(self.sizes, sizes, strict=True))))

    def _record(self, record: type) -> str:
        self.records[record.__name__] = record
        hints = get_type_hints(record, include_extras=True)
        return f"{record.__name__}({', '.join(self._field(*field) for field in hints.items())})"

    def _field(self, name: str, hint: object) -> str:
        if isinstance(hint, type) and hasattr(hint, "_fields"):
            return self._record(hint)
        if hint in _NUMBERS:
            return _NUMBERS[hint].format(f"flat[{self._taken('1')}]")
        if get_origin(hint) is not Annotated:
            self.arguments.append(name)
            return name
        shape = [_NAME.sub(lambda name: str(self._known.get(name[0], name[0])), str(s)) for s in get_args(hint)[1:]]
        for node in (node for size in shape for node in ast.walk(ast.parse(size))):
            if isinstance(node, ast.Name) and node.id not in self.sizes:
                self.sizes.append(node.id)
        begin = self._taken(" * ".join(f"({size})" for size in shape))
        return f"part(flat, {begin}, ({', '.join(shape)},))"

    def _taken(self, length: str) -> str:
        """Return the place of the next part, of `length` numbers."""
        count = len(self.lines)
        self.lines.append(f"    _{count + 1} = _{count} + {length}\n")
        self._lengths.append(length)
        return f"_{count}"
