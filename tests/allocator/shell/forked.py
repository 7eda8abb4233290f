"""Runs `antagonist` many times for the price of one import: every case in a forked child of this process.

Reads cases as JSON from standard input, answers on standard output. A case is {arguments, file_size}: `file_size`
bounds what the child may write to a file [bytes], as a full disk does; null: it does not.
"""

import json
import os
import resource
import sys
import time

from mpc import cli

_PATIENCE = 60.0  # [s] for a case


def child(arguments, file_size):
    """Become the command; never returns."""
    for number, name in ((1, ".stdout"), (2, ".stderr")):
        os.dup2(os.open(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), number)
    sys.stdout, sys.stderr = os.fdopen(1, "w", encoding="utf-8"), os.fdopen(2, "w", encoding="utf-8")
    if file_size is not None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (file_size, resource.RLIM_INFINITY))
    sys.argv = ["antagonist", *arguments]
    code = 99
    try:
        cli.main()
    except SystemExit as left:
        code = left.code or 0
    finally:  # a traceback is not printed here; the code tells
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def answer(arguments, file_size=None):
    """Exit code (None: had to be stopped), stdout and stderr of one case."""
    if not (pid := os.fork()):
        child(arguments, file_size)
    began = time.monotonic()
    while not (ended := os.waitpid(pid, os.WNOHANG))[0]:
        if time.monotonic() - began > _PATIENCE:
            os.kill(pid, 9)
            os.waitpid(pid, 0)
            break
        time.sleep(0.01)
    texts = {}
    for name in ("stdout", "stderr"):
        with open(f".{name}", encoding="utf-8") as file:
            texts[name] = file.read()
        os.unlink(f".{name}")
    return {"code": os.waitstatus_to_exitcode(ended[1]) if ended[0] else None, **texts}


if __name__ == "__main__":
    json.dump([answer(**case) for case in json.load(sys.stdin)], sys.stdout)
