"""What is said, once and in one line, of something that works but not as it should."""

import sys
import warnings

_OURS = {"allocator", "mpc", "numba", "contextlib"}
_said: set[str] = set()


class CacheFault(UserWarning):
    """Warning that cached compiled code cannot be read, or cannot be written."""


def notice(message: str, category: type[Warning]) -> None:
    """Warn of `message` at the line outside of this project that led here."""
    depth, frame = 1, sys._getframe(1)
    while frame.f_back is not None and str(frame.f_globals.get("__name__")).partition(".")[0] in _OURS:
        depth, frame = depth + 1, frame.f_back
    warnings.warn(message, category, stacklevel=depth + 1)


def notice_once(message: str, category: type[Warning]) -> None:
    """Warn as `notice` does, unless it has been said in this process: whatever filters there are, once is enough."""
    if message not in _said:
        _said.add(message)
        notice(message, category)
