"""Marks for tests that need more than Python: `@needs("gcc")`, `@posix`.

CI skips nothing: `.ci/run` installs every program and sets ANTAGONIST_CI, which makes a test with a missing program
fail instead of being skipped. Elsewhere, e.g. without a cross-compiler, such a test is skipped with the missing
program.
"""

import os
import shutil

import pytest


def needs(*programs):
    """Mark a test that requires these programs, such as a comparison of the exported C with Python."""
    missing = [program for program in programs if shutil.which(program) is None]
    reason = f"no {' and no '.join(missing)} on this machine; .ci/run installs them"
    return pytest.mark.skipif(bool(missing) and not os.environ.get("ANTAGONIST_CI"), reason=reason)


posix = pytest.mark.skipif(os.name != "posix", reason="signals and pseudo-terminals are POSIX's")
