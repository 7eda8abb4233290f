"""Entry of the command `antagonist`, and of `python -m mpc`."""

import _thread
import os
import signal
import sys
import threading
from collections.abc import Callable
from types import FrameType

_INTERRUPTED = "antagonist: interrupted\n"


def main() -> None:
    """Run the command; an interrupt prints one line and exits with 130."""
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # and not ignored, as in a background job
        signal.signal(signal.SIGINT, _interrupt)
    try:
        _commands()()
    except KeyboardInterrupt:
        sys.stderr.write(_INTERRUPTED)
        sys.exit(130)


def _commands() -> Callable[[], None]:
    """Load the commands, or exit with the name of a missing library."""
    import allocator  # noqa: F401  # a missing library is reported by name from this point on

    try:
        from mpc.cli import main
    except ModuleNotFoundError as missing:
        from allocator.errors import MissingPackage

        if isinstance(missing, MissingPackage):
            sys.exit(f"antagonist: {missing}")
        raise
    return main


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, unless the running code would lose it.

    Callbacks of Python's import locks and the initialisation of some compiled modules lose it. Loading holds nothing
    that needs cleaning up, so exit at once. CasADi loses it while it converts arguments, so interrupt again later.
    """
    if _loading(frame):
        os.write(2, _INTERRUPTED.encode())
        os._exit(130)
    if frame is not None and _in_casadi(frame) and frame.f_code.co_name not in ("call", "__call__"):
        again = threading.Timer(0.02, _thread.interrupt_main)
        again.daemon = True
        again.start()
        return
    raise KeyboardInterrupt


def _loading(frame: FrameType | None) -> bool:
    """Return whether a module is being imported."""
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False


def _in_casadi(frame: FrameType) -> bool:
    return os.path.basename(frame.f_code.co_filename) == "casadi.py"


if __name__ == "__main__":
    main()
