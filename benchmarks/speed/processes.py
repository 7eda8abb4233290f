"""What a new process pays: imports, first calls with and without compiled code on disk, memory."""

import os
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.speed.allocation import answers
from benchmarks.speed.clock import Measurement
from benchmarks.speed.targets import Targets
from benchmarks.speed.truth import BenchmarkFailure

PART = "processes"
ANSWER = 38  # [B] P1, P2, T, K; status, local; limits
BATCH = "import numpy as np; from allocator import allocate; allocate(np.linspace(-1, 1, {n}), 7.5, 1.0)"
SINGLE = "from allocator import allocate; allocate(0.3, 7.5, 1.0)"


def measure(light: bool) -> Iterator[Measurement]:
    """Medians over fresh processes."""
    rounds = 3 if light else 7
    with TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"], kept = cache, os.environ.get("NUMBA_CACHE_DIR")
        try:
            first = run(BATCH.format(n=300_000))
            python, numpy = times("pass", rounds), times("import numpy", rounds)
            yield figure("import numpy", numpy, "bare Python", python)
            imported = times("import allocator", rounds)
            # half the time of NumPy's own import on top of it, or twice that on a busy machine
            yield figure("import allocator", imported, "import numpy", numpy, floor=0.25)
            yield figure("import, first scalar", times(SINGLE, rounds), "import allocator", imported, floor=0.5)
            again = times(BATCH.format(n=300_000), rounds)
            yield figure("import, first batch of 3e5, compiled on disk", again, "import allocator", imported)
            yield figure("import, first batch of 3e5, not compiled", np.array([first]), "compiled on disk", again)
        finally:
            del os.environ["NUMBA_CACHE_DIR"]
            if kept is not None:
                os.environ["NUMBA_CACHE_DIR"] = kept
    for n in (10**6,) if light else (10**6, 10**7):
        yield memory(n)


def memory(n: int) -> Measurement:
    """What `allocate` has in memory at the most, beyond its arguments."""
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


def run(code: str) -> float:
    """Processor time of a fresh process [s]."""
    before = os.times()
    subprocess.run([sys.executable, "-c", code], check=True)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def times(code: str, rounds: int) -> np.ndarray:
    """The same, several times."""
    return np.array([run(code) for _ in range(rounds)])


def figure(what: str, mine: np.ndarray, rival: str, theirs: np.ndarray, floor: float = np.nan) -> Measurement:
    low, ratio, high = np.quantile(np.median(theirs) / mine, (0.25, 0.5, 0.75))
    a, b = float(np.median(mine)), float(np.median(theirs))
    return Measurement(PART, what, a, "process", rival, b, float(ratio), float(low), float(high), floor=floor)
