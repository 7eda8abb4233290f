"""What commands and notebooks say on stderr, besides the seconds of compilation that depend on caches and machines."""

import re

_SECONDS = re.compile(r"^(building|compiling) [^:\n]+: \d+ s\n", re.MULTILINE)


def besides_compiling(text):
    """The text without lines such as "compiling the observer: 5 s"."""
    return _SECONDS.sub("", text)
