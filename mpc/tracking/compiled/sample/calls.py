"""Calls of the QP's solution by its address.

A function that numba links is compiled into each of its callers anew, which for the solution of the QP takes longer
than all the rest of a step. By its address it is called in a nanosecond, and stays where it was made and kept.
"""

from typing import Any

from numba.core import cgutils, types
from numba.extending import intrinsic

_SETTLED: Any = types.Tuple((types.boolean, types.int64))  # type: ignore[attr-defined]


def address_of(settle: Any) -> int:
    """Return the address of `structured_qp.solve.settle`, which has been called with one kind of arguments.

    Raises a `TypeError` if it does not return what `settle_at` takes.
    """
    [made] = settle.overloads.values()
    if made.signature.return_type != _SETTLED:
        raise TypeError(f"{settle.__name__} returns {made.signature.return_type}, not {_SETTLED}")
    return int(made.library.get_pointer_to_function(made.fndesc.llvm_func_name))


@intrinsic  # type: ignore[untyped-decorator]  # numba has no types
def settle_at(
    typing: Any, address: Any, numbers: Any, starts: Any, given: Any, buffer: Any, guess: Any, z: Any
) -> tuple[Any, Any]:
    """Call `structured_qp.solve.settle`, which stands at this address."""
    arrays = (numbers, starts, given, buffer, guess, z)

    def generate(context: Any, builder: Any, signature: Any, given: Any) -> Any:
        convention = context.call_conv
        pointer = convention.get_function_type(_SETTLED, arrays).as_pointer()
        function = builder.inttoptr(given[0], pointer)
        status, settled = convention.call_function(builder, function, _SETTLED, arrays, given[1:])
        with cgutils.if_unlikely(builder, status.is_error):
            convention.return_status_propagate(builder, status)
        return settled

    return _SETTLED(address, *arrays), generate
