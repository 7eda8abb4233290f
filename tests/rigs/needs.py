"""What a test needs beyond Python is said here, once: `@needs("gcc")`, `@posix`.

CI skips nothing: `.ci/run` installs every program, and says so by ANTAGONIST_CI, under which a test that misses one is
not skipped and fails. Elsewhere, on a laptop without a cross-compiler, such a test says what it would have needed.
"""

import os
import shutil

import pytest


def needs(*programs):
    """Mark a test of what only these programs can show, such as that the exported C compiles and computes the same."""
    missing = [program for program in programs if shutil.which(program) is None]
    reason = f"no {' and no '.join(missing)} on this machine; .ci/run installs them"
    return pytest.mark.skipif(bool(missing) and not os.environ.get("ANTAGONIST_CI"), reason=reason)


posix = pytest.mark.skipif(os.name != "posix", reason="signals and pseudo-terminals are POSIX's")
