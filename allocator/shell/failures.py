"""Message of a command that fails, one sentence on stderr, and its exit code.

0    done
1    standard output is closed, or an unexpected error
2    wrong input, or a file that cannot be written
3    `antagonist allocate`: the target is not met
4    `antagonist run`, `sweep`: the loop ended itself, for safety
130  interrupted
143  `antagonist run`, `sweep`: terminated, or the terminal was closed
"""

import os
import sys
from collections.abc import Callable
from contextlib import suppress
from importlib import metadata
from io import TextIOWrapper
from traceback import walk_tb

from allocator.errors import AntagonistError

_DEBUG = "ANTAGONIST_DEBUG"  # environment variable; not empty: show tracebacks


def run(command: Callable[[], object]) -> int:
    """Run `command` and return its exit code; no exception leaves it unless ANTAGONIST_DEBUG is set."""
    if sys.stdout is None:
        return _fail("standard output is closed", 1)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):  # and not that of a notebook
            stream.reconfigure(errors="replace")  # ° and θ where the encoding has none
    code = 0
    try:
        code = _told(command)
        sys.stdout.flush()
    except BrokenPipeError:
        return _silenced(code or 1)  # the reader has read enough
    except OSError as error:
        return _silenced(code or _fail(f"standard output cannot be written ({error.strerror})", 1))
    return code


def _told(command: Callable[[], object]) -> int:
    """Return the exit code of `command`, and print its error."""
    try:
        command()
    except SystemExit as left:
        if left.code == 130:  # made of a KeyboardInterrupt by typer
            return _fail("interrupted", 130)
        return left.code if isinstance(left.code, int) else int(left.code is not None)
    except KeyboardInterrupt:
        return _fail("interrupted", 130)
    except AntagonistError as error:
        return _fail(str(error), 2)
    except MemoryError as error:
        return _fail(f"the memory does not suffice ({error or 'MemoryError'})", 1)
    except OSError as error:
        if error.filename is None:  # no file: standard output
            raise
        return _fail(f"{error.filename}: {error.strerror}", 2)
    except Exception as error:
        if os.environ.get(_DEBUG):
            raise
        what = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
        if asked := _asked_gl(error):
            return _fail(
                f"MUJOCO_GL = {asked!r} cannot be used ({what}); choose another of egl, osmesa and glfw, or unset it", 2
            )
        ask = f"please report it to {_tracker()} ({_DEBUG}=1 shows the traceback)"
        return _fail(f"unexpected error ({what}); {ask}", 1)
    return 0


def _asked_gl(error: Exception) -> str:
    """Return the MUJOCO_GL with which MuJoCo cannot be imported; empty if the error has another cause."""
    modules = (frame.f_globals.get("__name__", "") for frame, _ in walk_tb(error.__traceback__))
    return os.environ.get("MUJOCO_GL", "") if any(name.endswith("gl_context") for name in modules) else ""


def _fail(sentence: str, code: int) -> int:
    """Print the sentence in one line; returns `code`."""
    if sys.stderr is not None:
        with suppress(OSError):  # the terminal is closed: there is only the code
            print(f"antagonist: {' '.join(sentence.split())}", file=sys.stderr)
    return code


def _silenced(code: int) -> int:
    """Discard the rest of the buffer of standard output, about which Python would complain at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return code


def _tracker() -> str:
    """Return the address of the issue tracker, from the package's metadata."""
    try:
        urls = metadata.metadata("antagonist").get_all("Project-URL") or []
    except metadata.PackageNotFoundError:
        urls = []
    known: dict[str, str] = dict(url.split(", ", 1) for url in urls)
    return known.get("Issues", "the project's issue tracker")
