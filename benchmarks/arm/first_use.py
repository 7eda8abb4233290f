"""First use of an arm, with empty caches of compiled code: times to the first line and to the answer, and silences.

    python -m benchmarks.arm.first_use [--out benchmarks/results]

Every use is a new process that prints to a pipe or to a terminal. The answer of `track` is its table after a whole run,
behind which its files are written; that of the others is the first pressures. The same use is repeated when nothing
compiles in the background any more.
"""

import argparse
import os
import pty
import subprocess
import sys
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import NamedTuple

from benchmarks.allocators.machine import machine

RESULTS, NAME = Path(__file__).parents[1] / "results", "arm_first_use"
_TABLE = b"time of a step"  # the last rows of `track`
COMPILING = 600.0  # [s] limit of the compiler
_ARM = "from mpc import Arm; arm = Arm.machine('arm26'); q = arm.middle; K = [8.0, 8.0]; "
_ENVIRONMENT = (
    "from mpc.arm.learning.environment import ArmEnvironment; from mpc.arm.learning.task import Reaching; "
    "env = ArmEnvironment(Reaching(actions='{}')); env.reset(seed=0); print(env.step(env.action_space.sample())[4])"
)
USES = {
    "`antagonist track --machine arm26`": ("-m", "mpc", "track", "--machine", "arm26"),
    "`allocate(…)` of arm26": (
        "-c",
        f"{_ARM}from allocator import allocate; print(allocate(q, K, joint=arm.mechanism).P)",
    ),
    "`TrackingMPC(arm26, wait=False).step(…)`": (
        "-c",
        f"{_ARM}import numpy as np; from mpc import TrackingMPC; x = arm.at_rest(q, K); "
        "print(TrackingMPC(arm, wait=False).step(x, q, np.diag(K)).u[0])",
    ),
    "`ArmEnvironment`, pressures": ("-c", _ENVIRONMENT.format("pressures")),
    "`ArmEnvironment`, postures and stiffnesses": ("-c", _ENVIRONMENT.format("posture-stiffness")),
}

_LIMITATION = (
    "All processes need priority over other work on the machine; beside it they take two to four times as long. Films\n"
    "are rendered on the processor where there is no graphics card."
)


class Use(NamedTuple):
    """One process; times in s."""

    first: float  # until the first line
    silence: float  # longest time without one, until the answer
    answer: float
    done: float


def used(command: tuple[str, ...], caches: str, terminal: bool) -> Use:
    """Run a command of Python with these caches."""
    homes = dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA", "NUMBA_CACHE_DIR"), caches)
    path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
    environment = {**os.environ, **homes, "PYTHONPATH": path, "ANTAGONIST_WAIT": "0"}
    ours, theirs = pty.openpty() if terminal else os.pipe()
    with TemporaryDirectory() as folder:
        began = monotonic()
        process = subprocess.Popen(
            [sys.executable, *command], stdin=subprocess.DEVNULL, stdout=theirs, stderr=theirs, env=environment,
            cwd=folder,
        )  # fmt: skip
        os.close(theirs)
        printed, text, answer = [began], b"", None
        with suppress(OSError):  # raised at the end of a terminal
            while new := os.read(ours, 4096):
                printed.append(monotonic())
                text += new
                answer = printed[-1] if answer is None and _TABLE in text else answer
        os.close(ours)
        if process.wait():
            raise SystemExit(f"{command} failed")
    done = monotonic()
    answer = done if answer is None else answer
    gaps = [later - earlier for earlier, later in pairwise(printed) if later <= answer]
    return Use(printed[1] - began, max(gaps), answer - began, done - began)


def measured(command: tuple[str, ...], terminal: bool) -> tuple[Use, Use]:
    """Return the first use, and the same use when everything is compiled."""
    with TemporaryDirectory() as caches:
        first = used(command, caches, terminal)
        end = monotonic() + COMPILING
        while [*Path(caches).rglob("*.lock")]:
            if monotonic() > end:
                raise SystemExit(f"nothing was compiled in {COMPILING:g} s")
            sleep(1.0)
        return first, used(command, caches, terminal)


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.arm.first_use", description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report")
    out = parser.parse_args().out
    lines = [
        "# First use of an arm\n",
        "Written by `python -m benchmarks.arm.first_use`: new processes with empty caches of compiled code, and the",
        "same later, when everything is compiled. Wall times, which include the imports. The answer of `track` is its",
        "table after a whole run of 800 samples, before it renders a film; that of the others the first pressures.\n",
        "| use | output | first line [s] | longest silence [s] | answer [s] | later [s] | end [s] | later [s] |",
        "|---|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name, command in USES.items():
        for kind in ("pipe", "terminal"):
            first, again = measured(command, kind == "terminal")
            figures = *first[:3], again.answer, first.done, again.done
            line = f"| {name} | {kind} | {' | '.join(f'{figure:.1f}' for figure in figures)} |"
            print(line, flush=True)
            lines.append(line)
    out.mkdir(parents=True, exist_ok=True)
    lines += ["\n" + _LIMITATION, f"\n{machine()}."]
    (out / f"{NAME}.md").write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
