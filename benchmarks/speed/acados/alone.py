"""Times of the QP alone, in turns: ours with its proof, HPIPM's without the transfer of the QP."""

from collections.abc import Iterator, Sequence
from time import thread_time
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from benchmarks.speed.acados.library import HPIPM, Library, Mode, Settings
from benchmarks.speed.acados.recorded import LOOPS, RecordedQP, Recording
from benchmarks.speed.acados.stages import stages
from benchmarks.speed.clock import Measurement
from benchmarks.speed.truth import BenchmarkFailure

PART = "control"
DURATION = 10.0  # [s] of the loops
CLOSE = 1e-4  # [bar] tolerance of equal answers
SHARE = 0.99  # of the QPs: required of a setting
ROUNDS = 2  # the fastest counts
SETTINGS = [Settings(Mode.SPEED, False), Settings(Mode.SPEED, True), Settings(Mode.BALANCE, False)]


class Timed(NamedTuple):
    """Results of all QPs."""

    ours: Array  # (M,) [s]
    seconds: Array  # (M, settings) [s]
    apart: Array  # (M, settings) [bar] from our answers
    unsolved: Array  # (M, settings) according to HPIPM


def measure(N: int) -> Iterator[Measurement]:
    """Yield a row for each loop, against the fastest setting with correct answers."""
    library = Library.found()
    for loop, record in LOOPS.items():
        what = f"QP alone, N = {N}, {loop}"
        if library is None:
            yield Measurement(PART, what, np.nan, "QP", note="HPIPM was not found: its place is open")
        else:
            yield compared(what, timed(record(N, DURATION), library, SETTINGS), SETTINGS, library.target)


def timed(recording: Recording, library: Library, settings: Sequence[Settings]) -> Timed:
    """Time all QPs in order."""
    solvers = [HPIPM(library, len(recording.qps[0].model.u), each) for each in settings]
    found = Timed(*(np.empty((len(recording.qps), *shape)) for shape in ((), *3 * [(len(solvers),)])))
    for i, qp in enumerate(recording.qps):
        by_stages = stages(recording.problem, qp)
        remembered = [solver.remembered for solver in solvers]
        for solver in solvers:
            solver.take(by_stages)
        rounds = [(_ours(recording, qp), *map(_theirs, solvers, remembered)) for _ in range(ROUNDS)]
        found.ours[i], *found.seconds[i] = np.min(rounds, axis=0)
        z = recording.structured.z.reshape(-1, 2)
        found.apart[i] = [np.abs(solver.v - z).max() for solver in solvers]
        found.unsolved[i] = [solver.status != 0 for solver in solvers]
    return found


def _ours(recording: Recording, qp: RecordedQP) -> float:
    """Return the time of our solution and its proof [s], the faster of two in a row; fail without a proof."""
    took = []
    for _ in range(2):
        recording.set(qp)
        began = thread_time()
        proved = recording.structured.solved()
        took.append(thread_time() - began)
        if not proved:
            raise BenchmarkFailure("a recorded QP has no proved solution")
    return min(took)


def _theirs(solver: HPIPM, remembered: bytes) -> float:
    """Return the time of HPIPM's solution [s], the faster of two in a row from the remembered solution."""
    took = []
    for _ in range(2):
        solver.remembered = remembered
        began = thread_time()
        solver.solve()
        took.append(thread_time() - began)
    return min(took)


def compared(what: str, found: Timed, settings: Sequence[Settings], target: str) -> Measurement:
    """Return the comparison with the fastest correct setting; the note has the times and errors of all."""
    right = np.mean((found.apart <= CLOSE) & (found.unsolved == 0), axis=0) >= SHARE
    if not right.any():
        worst = ", ".join(f"{each} {off:.1e} bar" for each, off in zip(settings, found.apart.max(axis=0), strict=True))
        return Measurement(PART, what, float(np.median(found.ours)), "QP", note=f"HPIPM's answers are off: {worst}")
    best = min(np.flatnonzero(right), key=lambda j: np.median(found.seconds[:, j]))
    theirs = found.seconds[:, best]
    low, ratio, high = np.quantile(theirs / found.ours, (0.25, 0.5, 0.75))
    tails = (
        f"{name}: {1e6 * np.quantile(found.ours, share):.0f} µs against {1e6 * np.quantile(theirs, share):.0f} µs"
        for name, share in (("99 %", 0.99), ("99.9 %", 0.999), ("worst", 1.0))
    )
    note = (
        f"{'; '.join(tails)}; {np.mean(found.ours < np.median(theirs)):.1%} of ours are faster than its median; "
        f"HPIPM by settings, median and 99 % [µs], greatest distance from our answers [bar], unsolved: "
        f"{', '.join(_said(found, j, str(each)) for j, each in enumerate(settings))}; BLASFEO for {target}"
    )
    means = float(np.median(found.ours)), "QP", f"HPIPM {settings[best]}", float(np.median(theirs))
    return Measurement(PART, what, *means, ratio, low, high, note=note)


def _said(found: Timed, j: int, name: str) -> str:
    p50, p99 = 1e6 * np.quantile(found.seconds[:, j], (0.5, 0.99))
    unsolved = int(found.unsolved[:, j].sum())
    return f"{name} {p50:.0f} and {p99:.0f}, {found.apart[:, j].max():.1e}, {unsolved} of {len(found.ours)}"
