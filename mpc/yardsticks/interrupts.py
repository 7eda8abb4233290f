"""Ctrl-C inside CasADi reaches the caller as the `KeyboardInterrupt` that it is."""

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def interruptible() -> Iterator[None]:
    """Raise `KeyboardInterrupt` for whatever CasADi makes of it inside the block.

    It becomes a `RuntimeError` whose text names it, or CasADi returns to Python with it still set, which Python reports
    as a `SystemError` caused by it. Anything else goes through. CasADi's conversions of arrays lose it without a trace:
    functions are called through `mpc.model.buffered` where an interrupt may come.
    """
    try:
        yield
    except (RuntimeError, SystemError) as error:
        if "KeyboardInterrupt" in str(error) or isinstance(error.__cause__, KeyboardInterrupt):
            raise KeyboardInterrupt from None
        raise
