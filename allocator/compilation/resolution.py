"""Memory of the calls that numba has resolved.

For every call, `a + b` and `x[i]` among them, numba tries all implementations that are registered, from the most
special one on, and writes an error message for each that does not suit. The same operations on the same types recur in
every function, so the answers are kept while one function and its callees are compiled: the controller compiles in
three quarters of the time.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.targetconfig import ConfigStack
from numba.core.types.functions import BaseFunction


@contextmanager
def remembering() -> Iterator[None]:
    """Keep the answers of numba's resolution of calls; the caller holds numba's lock of compilation."""
    numbas: Any = BaseFunction
    resolve = numbas.get_call_type
    known: dict[Any, tuple[Any, Any]] = {}

    def recalled(self: Any, context: Any, args: Any, kws: Any) -> Any:
        """Return the signature of a call, as numba does."""
        key = context, self.typing_key, self.templates, tuple(args), tuple(kws.items()), ConfigStack.top_or_none()
        if key in known:
            signature, implementation = known[key]
            self._impl_keys[signature.args] = implementation
        else:
            signature = resolve(self, context, args, kws)
            known[key] = signature, self._impl_keys[signature.args]
        return signature

    numbas.get_call_type = recalled
    try:
        yield
    finally:
        numbas.get_call_type = resolve
