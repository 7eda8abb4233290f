"""Memory of answers that numba looks for again and again.

For every call, `a + b` and `x[i]` among them, numba tries all implementations that are registered, from the most
special one on, and writes an error message for each that does not suit. For every variable, LLVM parses a module that
numba writes to learn the size of its type. The same operations on the same types recur in every function, so the
answers are kept while one function and its callees are compiled: the controller compiles in three quarters of the time.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any

from numba.core.base import BaseContext
from numba.core.targetconfig import ConfigStack, TargetConfig
from numba.core.types.functions import BaseFunction

Method = Callable[..., Any]


@contextmanager
def remembering() -> Iterator[None]:
    """Keep the answers of numba's questions; the caller holds numba's lock of compilation."""
    with (
        _replaced(BaseFunction, "get_call_type", _recalling),
        _replaced(BaseContext, "get_abi_sizeof", _measuring),
        _replaced(TargetConfig, "values", lambda _: _options),
    ):
        yield


@contextmanager
def _replaced(owner: type, name: str, replacement: Callable[[Method], Method]) -> Iterator[None]:
    """Replace a method by the `replacement` of it."""
    before = getattr(owner, name)
    setattr(owner, name, replacement(before))
    try:
        yield
    finally:
        setattr(owner, name, before)


def _recalling(resolve: Method) -> Method:
    """Return numba's resolution of calls, which asks `resolve` once for each call and types."""
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

    return recalled


def _measuring(measure: Method) -> Method:
    """Return numba's size of a type of LLVM, which calls `measure` once for each type."""
    known: dict[str, int] = {}

    def measured(self: Any, kind: Any) -> int:
        """Return the size [bytes]; equal types have equal texts."""
        text = str(kind)
        if text not in known:
            known[text] = measure(self, kind)
        return known[text]

    return measured


def _options(self: Any) -> dict[str, Any]:
    """Return the options of a `TargetConfig`, which are compared for every call, without a property for each."""
    kind: Any = type(self)
    return {**_defaults(kind), **self._values}


@cache
def _defaults(config: Any) -> dict[str, Any]:
    return {name: option.default for name, option in config.options.items()}
