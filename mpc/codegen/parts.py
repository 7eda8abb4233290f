"""Parts of flat arrays, for Python and for compiled code."""

from collections.abc import Callable, Sequence
from math import prod
from typing import TYPE_CHECKING, Any

from numba.core import cgutils, types
from numba.extending import lower_builtin, type_callable
from numba.np.arrayobj import populate_array

from allocator.calculus import Array

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
