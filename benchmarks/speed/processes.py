"""What a new process pays: imports, first calls with and without compiled code on disk, memory."""

import os
import subprocess
import sys
from collections.abc import Iterator
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from benchmarks.speed.clock import Measurement

PART = "processes"
BATCH = "import numpy as np; from allocator import allocate; allocate(np.linspace(-1, 1, {n}), 7.5, 1.0)"
SINGLE = "from allocator import allocate; allocate(0.3, 7.5, 1.0)"
MEMORY = """
import numpy as np, resource
from allocator import allocate, warm_up
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
theta = np.linspace(-1, 1, {n}); K, T = np.full({n}, 7.5), np.ones({n})
warm_up(); allocate(theta[:300_000], K[:300_000], T[:300_000]); before = peak()
a = allocate(theta, K, T); print((peak() - before) / {n})
"""


def measure(light: bool) -> Iterator[Measurement]:
    """Medians over fresh processes."""
    rounds = 3 if light else 7
    with TemporaryDirectory() as cache:
        os.environ["NUMBA_CACHE_DIR"], kept = cache, os.environ.get("NUMBA_CACHE_DIR")
        try:
            first = run(BATCH.format(n=100_000))
            python, numpy = times("pass", rounds), times("import numpy", rounds)
            yield figure("import numpy", numpy, "bare Python", python)
            imported = times("import allocator", rounds)
            # half the time of NumPy's own import on top of it, or twice that on a busy machine
            yield figure("import allocator", imported, "import numpy", numpy, floor=0.25)
            yield figure("import, first scalar", times(SINGLE, rounds), "import allocator", imported, floor=0.5)
            again = times(BATCH.format(n=100_000), rounds)
            yield figure("import, first batch of 1e5, compiled on disk", again, "import allocator", imported)
            yield figure("import, first batch of 1e5, not compiled", np.array([first]), "compiled on disk", again)
        finally:
            del os.environ["NUMBA_CACHE_DIR"]
            if kept is not None:
                os.environ["NUMBA_CACHE_DIR"] = kept
    if not light:
        for n in (1_000_000, 10_000_000):
            done = subprocess.run(
                [sys.executable, "-c", MEMORY.format(n=n)], capture_output=True, text=True, check=True
            )
            note = f"{float(done.stdout):.0f} B a target more at the peak; the answers take 39 B"
            yield Measurement(PART, f"memory of a batch of 1e{len(str(n)) - 1}", np.nan, "target", note=note)


def run(code: str) -> float:
    """Seconds of a fresh process."""
    start = perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return perf_counter() - start


def times(code: str, rounds: int) -> np.ndarray:
    """The same, several times."""
    return np.array([run(code) for _ in range(rounds)])


def figure(what: str, mine: np.ndarray, rival: str, theirs: np.ndarray, floor: float = np.nan) -> Measurement:
    low, ratio, high = np.quantile(np.median(theirs) / mine, (0.25, 0.5, 0.75))
    a, b = float(np.median(mine)), float(np.median(theirs))
    return Measurement(PART, what, a, "process", rival, b, float(ratio), float(low), float(high), floor=floor)
