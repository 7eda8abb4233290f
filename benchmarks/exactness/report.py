"""Scores and times as CSV files and a Markdown report."""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import fields
from importlib.metadata import version
from math import isnan
from pathlib import Path
from typing import Any, TypeVar

from benchmarks.allocators.machine import machine
from benchmarks.allocators.report import table, write_csv
from benchmarks.exactness.accuracy import INTERVALS, Score
from benchmarks.exactness.timing import BATCH, Time
from tests.exact_everywhere.judge import FIRST, FLAT, SECOND, WEIGHTS

NAME = "exactness"
Record = TypeVar("Record", Score, Time)

METHOD = f"""\
**Muscles and geometries**: `tests/exact_everywhere/joints.py`; every model is fitted to the shipped map of a
DMSP-20-300, "Tondu2021-report" is the report's. 0–5 bar, cables taut, no other limits.

**Targets**: random ones, over 1.5 times the feasible range at the angle, so most cannot be met; and those of random
taut pressures, which can all be met. Weighted: w_T = {WEIGHTS[0]:g}, w_K = {WEIGHTS[1]:g}.

**Judge**: a search that uses only a joint's torque, stiffness, forces and their derivatives by pressure
(`tests/exact_everywhere/dense_search.py`): both curves sampled at 400 pressures and at their special points, every
change of sign and every minimum refined. It is skipped if an answer meets both targets.

*beaten*: the first error (of the weighted cost the root) is undercut by more than {FIRST:g} of the scale, or else the
second by more than {SECOND:g} ({FLAT:g} beyond an extreme of the first, where 1e-14 of it is 1e-7 of the second).
*refused*: feasible, but not answered EXACT. *outside*: pressures outside the box. *status*: a missed target is reported
as met, or the reverse. *interval*: that of the torque or of the stiffness is false; every {INTERVALS}th answer.
*worst*: greatest excess of an answer, *gap*: the greatest stated, both in fractions of the scale. *several*: targets
met by several pairs of pressures. *unequalled*: answers not found by the search, which was not dense enough there.

**Times** of the processor, per target: scalar calls before and after `warm_up(joint=…)`, and a batch of
{BATCH} random targets after it, box included.
"""

HEADER = (
    "muscle",
    "geometry",
    "priority",
    "random",
    "made",
    "beaten",
    "refused",
    "outside",
    "status",
    "interval",
    "worst",
    "gap",
    "several",
    "unequalled",
    "scalar before [µs]",
    "after [µs]",
    "batch [µs]",
)


def read(folder: Path, name: str, kind: type[Record]) -> list[Record]:
    """Return the records written there by `write`, if any."""
    try:
        with (folder / f"{name}.csv").open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except FileNotFoundError:
        return []
    return [kind(**{f.name: f.type(row[f.name]) for f in fields(kind)}) for row in rows]


def write(scores: Sequence[Score], times: Sequence[Time], folder: Path) -> None:
    """Write `exactness.csv`, `exactness_time.csv` and `exactness.md`; joints not measured now keep their figures."""
    folder.mkdir(parents=True, exist_ok=True)
    kept = _merged(read(folder, NAME, Score), scores), _merged(read(folder, f"{NAME}_time", Time), times)
    for name, records in zip((NAME, f"{NAME}_time"), kept, strict=True):
        if records:
            write_csv(folder / f"{name}.csv", records)
    (folder / f"{NAME}.md").write_text("\n".join(markdown(*kept)) + "\n", encoding="utf-8")


def _key(record: Any) -> tuple[str, str, str]:
    return record.muscle, record.geometry, record.priority


def _merged(old: Sequence[Record], new: Sequence[Record]) -> list[Record]:
    return list(({_key(record): record for record in old} | {_key(record): record for record in new}).values())


def markdown(scores: Sequence[Score], times: Sequence[Time]) -> Iterator[str]:
    """Yield the report."""
    yield "# Is the exact answer exact?\n"
    yield f"Written by `python -m benchmarks.exactness`; the figures are also in `{NAME}.csv` and `{NAME}_time.csv`.\n"
    yield from (f"* {sentence}" for sentence in findings(scores, times))
    yield f"\n## Targets and checks\n\n{METHOD}\n## Every joint\n"
    clock = {_key(t): t for t in times}
    yield from table(HEADER, (row(s, clock.get(_key(s))) for s in scores))
    yield f"\n## Machine and versions\n\n{machine()}; {', '.join(f'{p} {version(p)}' for p in ('numpy', 'numba'))}."


def findings(scores: Sequence[Score], times: Sequence[Time]) -> Iterator[str]:
    """Yield one sentence per finding."""
    n = sum(s.random + s.made for s in scores)
    counts = {name: sum(getattr(s, name) for s in scores) for name in ("beaten", "refused", "outside", "false_status")}
    yield f"Of {n} answers {counts['beaten']} are beaten, by {max(s.worst for s in scores):.1e} of the scale at most."
    yield f"{counts['refused']} feasible targets are refused; {sum(s.made for s in scores)} were made feasible."
    yield f"{counts['outside']} answers are outside the box, {counts['false_status']} have a false status."
    yield f"Of {sum(s.intervals for s in scores)} intervals {sum(s.false_intervals for s in scores)} are false."
    stated = [s.gap for s in scores if not isnan(s.gap)]
    if stated:
        yield f"The greatest gap that an answer states is {max(stated):.1e} of the scale."
    if times:
        worst = max(times, key=lambda t: t.batch)
        yield f"The slowest batch: {worst.batch:.3g} µs a target ({worst.muscle}, {worst.geometry}, {worst.priority})."


def row(s: Score, t: Time | None) -> tuple[str, ...]:
    """Return one line of the table."""
    counts = (s.random, s.made, s.beaten, s.refused, s.outside, s.false_status, s.false_intervals)
    figures = "" if s.worst == 0 else f"{s.worst:.1e}", "" if isnan(s.gap) else f"{s.gap:.0e}"
    several = "" if isnan(s.several) else f"{s.several:.1%}"
    clock = ("", "", "") if t is None else (f"{x:.3g}" for x in (t.scalar_before, t.scalar_after, t.batch))
    return *_key(s), *map(str, counts), *figures, several, str(s.unequalled), *clock
