"""Costs of a new process: imports, first calls with and without compiled code on disk, memory."""

import os
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import monotonic, sleep
from typing import Any

import numpy as np

from benchmarks.speed.allocation import answers
from benchmarks.speed.clock import Measurement
from benchmarks.speed.targets import Targets
from benchmarks.speed.truth import BenchmarkFailure

PART = "processes"
COMPILING = 600.0  # [s] limit of the compiler
SAME = 1e-4  # tolerance between runs, in degrees, degrees/s, bar and N·m/rad
ANSWER = 38  # [B] P1, P2, T, K; status, local; limits
BATCH = "import numpy as np; from allocator import allocate; allocate(np.linspace(-1, 1, {n}), 7.5, 1.0)"
SINGLE = "from allocator import allocate; allocate(0.3, 7.5, 1.0)"


def measure(light: bool) -> Iterator[Measurement]:
    """Yield medians over fresh processes."""
    rounds = 3 if light else 7
    with TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"], kept = cache, os.environ.get("NUMBA_CACHE_DIR")
        try:
            first = run("-c", BATCH.format(n=300_000))
            python, numpy = times("pass", rounds), times("import numpy", rounds)
            yield figure("import numpy", numpy, "bare Python", python)
            imported = times("import allocator", rounds)
            yield figure("import allocator", imported, "import numpy", numpy, floor=1.0)  # which it does not import
            yield figure("import, first scalar", times(SINGLE, rounds), "import numpy", numpy, floor=0.25)
            again = times(BATCH.format(n=300_000), rounds)
            yield figure("import, first batch of 3e5, compiled on disk", again, "import numpy", numpy)
            yield figure("import, first batch of 3e5, not compiled", np.array([first]), "compiled on disk", again)
        finally:
            del os.environ["NUMBA_CACHE_DIR"]
            if kept is not None:
                os.environ["NUMBA_CACHE_DIR"] = kept
    for n in (10**6,) if light else (10**6, 10**7):
        yield memory(n)
    if not light:
        yield from first_use()


def first_use() -> Iterator[Measurement]:
    """Measure the first use: an empty cache, `antagonist track`, its table; and the same waiting for compilation."""
    waited, table = tracked("--wait")
    with TemporaryDirectory() as caches:
        first, readable = tracked(caches=caches)
        end = monotonic() + COMPILING
        while [*Path(caches).rglob("*.lock")]:
            if monotonic() > end:
                raise BenchmarkFailure(f"first use: nothing was compiled beside it in {COMPILING:g} s")
            sleep(1.0)
        again, compiled = tracked(caches=caches)
    for other in (readable, compiled):
        if np.abs(other - table).max() > SAME:
            raise BenchmarkFailure(f"first use: runs differ by {np.abs(other - table).max():.2g}, over {SAME:g}")
    yield figure("`antagonist track`, nothing compiled", np.array([first]), "the same with --wait", np.array([waited]))
    yield figure("`antagonist track`, compiled beside the first one", np.array([again]), "the first", np.array([first]))


def tracked(*options: str, caches: str = "") -> tuple[float, np.ndarray]:
    """Return the processor time of `antagonist track` [s], without background compilation, and its rows."""
    with TemporaryDirectory() as folder:
        homes = dict.fromkeys(("XDG_CACHE_HOME", "LOCALAPPDATA"), caches or folder)
        path = os.pathsep.join(os.path.abspath(entry) for entry in sys.path)
        environment = {**os.environ, **homes, "PYTHONPATH": path, "ANTAGONIST_WAIT": "0", "NUMBA_CACHE_DIR": ""}
        command = ("-m", "mpc", "track", "--out", f"{folder}/run", *options)
        took = run(*command, env=environment, cwd=folder, stdout=subprocess.DEVNULL)
        return took, np.genfromtxt(f"{folder}/run/tracking.csv", delimiter=",", skip_header=1, usecols=range(10))


def memory(n: int) -> Measurement:
    """Measure the peak memory of `allocate` beyond its arguments."""
    targets = Targets(n)
    answers(targets)
    tracemalloc.start()
    answers(targets)
    peak = tracemalloc.get_traced_memory()[1] / n
    tracemalloc.stop()
    if peak > 2 * ANSWER:
        raise BenchmarkFailure(f"memory: {peak:.0f} B a target, where the answer takes {ANSWER} B")
    note = f"{peak:.1f} B a target at the peak; the answer takes {ANSWER} B"
    return Measurement(PART, f"memory of a batch of 1e{len(str(n)) - 1}", np.nan, "target", note=note)


def run(*arguments: str, **options: Any) -> float:
    """Return the processor time of a fresh Python with these arguments [s]."""
    before = os.times()
    subprocess.run([sys.executable, *arguments], check=True, **options)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def times(code: str, rounds: int) -> np.ndarray:
    """Return the same, several times."""
    return np.array([run("-c", code) for _ in range(rounds)])


def figure(what: str, mine: np.ndarray, rival: str, theirs: np.ndarray, floor: float = np.nan) -> Measurement:
    low, ratio, high = np.quantile(np.median(theirs) / mine, (0.25, 0.5, 0.75))
    a, b = float(np.median(mine)), float(np.median(theirs))
    return Measurement(PART, what, a, "process", rival, b, float(ratio), float(low), float(high), floor=floor)
