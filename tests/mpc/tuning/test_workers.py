"""Worker processes of `antagonist tune`."""

import subprocess
import sys

WORK = """
import os
from mpc.tuning_cli import _executor

if __name__ == "__main__":
    with _executor(2, None) as pool:
        print(*{one.result() for one in [pool.submit(os.getpid) for _ in range(4)]}, flush=True)
        input()
"""


def test_workers_end_with_a_command_that_was_killed():
    """They waited for work for ever, and held the terminal's pipe."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen([sys.executable, "-c", WORK], **pipes) as command:
        assert command.stdout.readline().split()
        command.kill()
        assert command.communicate(timeout=20)[0] == ""  # ends when no process holds the pipe any more
