"""Measurements as a line, a CSV file and a Markdown report."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from math import isnan
from pathlib import Path

from benchmarks.allocators.machine import machine
from benchmarks.speed.c_reference import FLAGS
from benchmarks.speed.clock import MISSED, Measurement

PACKAGES = ("numpy", "scipy", "numba", "llvmlite", "casadi", "daqp", "osqp")
HEADER = "| task | time | against | its time | times faster | quartiles | wanted |\n|---|--:|---|--:|--:|--:|--:|\n"


def line(m: Measurement) -> str:
    """Return one measurement for the terminal."""
    if isnan(m.ratio):
        return f"{m.part}: {m.what}: {m.note}"
    wanted = "" if isnan(m.wanted) else f", wanted {digits(m.wanted)}"
    return (
        f"{m.part}: {m.what} {duration(m.seconds)} a {m.unit}; {m.rival} {duration(m.rival_seconds)}: "
        f"{digits(m.ratio)} times faster ({digits(m.low)} to {digits(m.high)}{wanted})"
    )


def write(found: Sequence[Measurement], folder: Path) -> None:
    """Write `speed.csv` and `speed.md`."""
    with (folder / "speed.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, [f.name for f in fields(Measurement)])
        writer.writeheader()
        writer.writerows(asdict(m) for m in found)
    (folder / "speed.md").write_text("\n".join(lines(found)) + "\n", encoding="utf-8")


def read(folder: Path) -> list[Measurement]:
    """Return the measurements written there by `write`, if any."""
    try:
        with (folder / "speed.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        return []
    words = {f.name for f in fields(Measurement) if f.type is str or f.type == "str"}
    return [Measurement(**{k: v if k in words else float(v) for k, v in row.items()}) for row in rows]


def lines(found: Sequence[Measurement]) -> Iterator[str]:
    yield "# Speed\n"
    yield "Written by `python -m benchmarks.speed`; the figures are also in `speed.csv`.\n"
    yield "Ratios are medians, with quartiles, of times measured in turns; above 1 the left-hand side is faster."
    yield "Before anything was timed its answers were compared with the readable implementation's.\n"
    for part in dict.fromkeys(m.part for m in found):
        yield f"## {part.capitalize()}\n"
        yield HEADER + "\n".join(row(m) for m in found if m.part == part) + "\n"
    yield "## Asked for and missed\n"
    yield from (f"* {sentence}" for sentence in missed(found) or ["Nothing."])
    yield "\n## Limitations\n"
    yield from (f"* {sentence}" for sentence in LIMITATIONS)
    yield "\n## Machine and versions\n"
    yield f"{machine()}; {', '.join(f'{package} {version(package)}' for package in PACKAGES)}."
    yield f"C: `{' '.join(FLAGS)}`."


LIMITATIONS = (
    "Times are those of one, shared, virtual machine and are no promise; ratios also vary from machine to machine.",
    "The optimisers start from the middle of the box and receive the box and the nearest torque within reach. A "
    "better start would need fewer iterations; a compiled formulation would cost less per call.",
    "The C reference has the same formulas and one thread, and the flags that gcc needs to vectorise them. Other "
    "compilers, or intrinsics, may do better.",
    "The gain of two threads depends on the load of the second processor; hashing by two threads, measured alongside, "
    "shows the possible gain.",
    "Times are the processor's, except where threads are compared; on an idle machine they are the wall's. "
    "Those of MPC steps are the calling thread's: solver threads are not counted.",
    "MPC: the nonlinear MPCs solve their problem to convergence at every sample, TrackingMPC one QP of it; the costs "
    "of the closed loops are given with the times. One joint, one trajectory. In do-mpc and acados every stage has "
    "its own slacks. Of acados only the C function is timed, which linearises and solves a QP; of TrackingMPC a whole "
    "step in Python.",
    "HPIPM alone: its solution of a QP is timed, without the transfer of the QP; ours is timed with its proof. Both "
    "are the faster of consecutive runs. A BLASFEO for this processor is used if `$ACADOS_SOURCE_DIR` has one; the "
    "rest of HPIPM and acados is a generic build, while numba compiles for this processor.",
    "MPC: up to N = 40 the QP's solution takes less than the rest of a step: checks, reference, linear model, "
    "prediction. The slowest steps exchange many active limits.",
    "MPC: under Control only the controller's step is timed, without the observer; under Sample both, on another "
    "plant than IPOPT's. cvxpy is timed without the formulation of the QP.",
)


def missed(found: Sequence[Measurement]) -> list[str]:
    """Return each missed requirement once, though a note may occur with several rivals."""
    sentences = []
    for m in found:
        if m.missed:
            sentences.append(f"{m.what}: {digits(m.ratio)} times faster than {m.rival}; {digits(m.wanted)} asked.")
        sentences += [f"{m.what}: {note}." for note in m.note.split("; ") if note.endswith(MISSED)]
    return list(dict.fromkeys(sentences))


def row(m: Measurement) -> str:
    if isnan(m.ratio):
        return f"| {m.what} | {m.note} | | | | | |"
    what = f"{m.what} ({m.note})" if m.note else m.what
    wanted = "" if isnan(m.wanted) else f"≥ {digits(m.wanted)}{f', {MISSED}' if m.missed else ''}"
    cells = (what, f"{duration(m.seconds)} a {m.unit}", m.rival, duration(m.rival_seconds))
    return f"| {' | '.join(cells)} | {digits(m.ratio)} | {digits(m.low)} – {digits(m.high)} | {wanted} |"


def duration(seconds: float) -> str:
    """Return three digits and a unit."""
    for unit, size in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= size:
            return f"{seconds / size:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def digits(ratio: float) -> str:
    """Return three digits without an exponent."""
    return f"{ratio:.3g}" if ratio < 1000 else f"{float(f'{ratio:.3g}'):,.0f}".replace(",", " ")
