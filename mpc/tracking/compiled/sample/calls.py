"""Call of the QP's solution by its address.

numba compiles a linked function again into each of its callers, which for the solution of the QP takes longer than for
the rest of a step. A call by address takes a nanosecond and uses the cached function.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from numba.core import cgutils, types
from numba.core.types import Type
from numba.extending import intrinsic

if TYPE_CHECKING:
    from numba.core.base import BaseContext
    from numba.core.dispatcher import Dispatcher
    from numba.core.typing.templates import Signature

_SETTLED = types.Tuple((types.boolean, types.int64))  # type: ignore[attr-defined]


def address_of(settle: "Dispatcher") -> int:
    """Return the address of `structured_qp.solve.settle`, which has been called with one type of arguments.

    Raises a `TypeError` if its return type is not that of `settle_at`.
    """
    [made] = settle.overloads.values()
    if made.signature.return_type != _SETTLED:
        raise TypeError(f"{settle.py_func.__name__} returns {made.signature.return_type}, not {_SETTLED}")
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def settle_at(
    typing: object, address: Type, numbers: Type, starts: Type, given: Type, buffer: Type, guess: Type, z: Type
) -> "tuple[Signature, Callable[..., object]]":
    """Call `structured_qp.solve.settle` at this address."""
    arrays = (numbers, starts, given, buffer, guess, z)

    def generate(context: "BaseContext", builder: Any, signature: "Signature", given: Sequence[object]) -> object:
        convention = context.call_conv
        pointer = convention.get_function_type(_SETTLED, arrays).as_pointer()
        function = builder.inttoptr(given[0], pointer)
        status, settled = convention.call_function(builder, function, _SETTLED, arrays, given[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return settled

    return _SETTLED(address, *arrays), generate
