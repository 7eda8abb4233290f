"""The C compiler of this machine is looked for here, where exported C is run at once."""

import shutil

from allocator.errors import MissingBackend

COMPILERS = ("cc", "gcc", "clang")


def compiler() -> str:
    """Return the path of a C compiler. Raises `MissingBackend` where there is none."""
    found = next(filter(None, map(shutil.which, COMPILERS)), None)
    if found is None:
        raise MissingBackend("C compiler", "cc", [*COMPILERS, "after apt install gcc"])
    return found
