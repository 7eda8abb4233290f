"""Calls of compiled functions by their addresses.

numba compiles a linked function again into each of its callers, which for the solution of the QP takes longer than for
the rest of a step. A call by address takes a nanosecond and uses the cached function.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from numba.core import cgutils, types
from numba.core.errors import TypingError
from numba.core.types import Type
from numba.extending import intrinsic

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.dispatcher import Dispatcher
    from numba.core.typing.templates import Signature

_FLOATS, _INTEGERS, _SIGNS = (types.Array(kind, 1, "C") for kind in (types.float64, types.int64, types.int8))
SETTLE = _FLOATS, _INTEGERS, _FLOATS, _FLOATS, _SIGNS, _FLOATS  # of `structured_qp.settle`
_SETTLED = types.Tuple((types.boolean, types.int64))  # type: ignore[attr-defined]


def address_of(function: "Dispatcher", kinds: tuple[Type, ...] = SETTLE, result: Type = _SETTLED) -> int:
    """Return the address of a compiled `function` for arguments of these `kinds`.

    Raises a `TypeError` if it returns another type than `result`.
    """
    function.compile(kinds)
    made = function.overloads[kinds]
    if made.signature.return_type != result:
        raise TypeError(f"{function.py_func.__name__} returns {made.signature.return_type}, not {result}")
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


def caller(kinds: tuple[Type, ...], result: Type = _SETTLED) -> Callable[..., Any]:
    """Return (address, tuple of arguments) ↦ the result of the function there, for compiled code."""

    @intrinsic  # type: ignore[untyped-decorator]  # numba has no types
    def call(typing: object, address: Type, arguments: Any) -> "tuple[Signature, Callable[..., object]]":
        if tuple(arguments) != kinds:
            raise TypingError(f"arguments of the types {tuple(arguments)}, not {kinds}")

        def generate(context: "BaseContext", builder: Any, signature: "Signature", given: Sequence[Any]) -> object:
            convention = context.call_conv
            pointer = convention.get_function_type(result, kinds).as_pointer()
            function, values = builder.inttoptr(given[0], pointer), cgutils.unpack_tuple(builder, given[1])
            status, found = convention.call_function(builder, function, result, kinds, values)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return context.get_dummy_value() if result is types.none else found

        return result(address, arguments), generate

    made: Callable[..., Any] = call
    return made


settle_at = caller(SETTLE)
STAGE = types.int64, _FLOATS, _FLOATS  # of `mpc.tracking.compiled.step.rubbed` and `rested`
stage_at = caller(STAGE, types.boolean)


def stage_of(function: "Dispatcher") -> int:
    """Return the address of a stage, compiled now."""
    return address_of(function, STAGE, types.boolean)
