"""Rows of a log in time: order, restarts of the clock, unit of the time stamps, gaps, and spikes.

A spike is a run of at most three rows that lies on one side of the rows before and after, by far more than usual
differences, while the rows around lie nearly on a parabola. A commanded pressure may jump and return; it is a spike
only if it leaves the range of the others, or reads zero for less than 60 ms, which is rare.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile
from allocator.files.cells import listed
from allocator.identification.columns import Measured
from allocator.identification.headers import UNITS
from allocator.units import BAR, DEG, MM

GAP = 1.0  # [s] without a row, which ends a stretch of a log
UNEVEN = 0.05  # standard deviation of the steps over their median, above which rows are resampled at even times
MOST_ROWS = 15_000  # of longer logs every second, third … row is used
_BETWEEN = 10.0  # [s] put between two recordings
_PLAUSIBLE_STEP = (1e-4, 0.5)  # [s] between rows
_LEAST_DURATION = 1.0  # [s]
_LEAST_ROWS = 30  # of a recording after which the clock begins anew
_PRESSURES = ("pressure", "measured")
_LEAST = {"theta": 2 * DEG, "force": 20.0, "contraction": 0.02, "length": 6 * MM, "shortening": 6 * MM}  # of a spike
_LONGEST = 3  # rows of a spike, or of stamps that are late
_USUAL = 5.0  # times the jump and return exceeded by 3 % of the rows
_NEAR = 5  # rows, of which three must be without a jump
_AROUND = 3.0  # times the scatter of the rows around about their parabola
_LEAST_PRESSURE = 1 * BAR
_LEAST_DROP = 0.3 * BAR  # least pressure before a drop-out,
_EMPTY = 0.05 * BAR  # and greatest during it
_RARE = 0.05  # greatest share of drop-outs
_LONGEST_DROP = 1.0  # [s] of a measured pressure, and
_LONGEST_DROP_COMMANDED = 0.06  # [s] of a commanded one


def in_time(measured: Measured) -> Measured:
    """Return the log in the order of time, without repeated rows.

    Up to three rows in succession that are not later than an earlier row are left out. If the clock begins anew, the
    rows from there on are a further stretch, as of another file. Raises `InvalidFile`, with lines, for other times that
    decrease or stand still, and for times that are implausible in their unit.
    """
    measured = _once(measured)
    t = measured.values["time"]
    if t.size < 2:
        return measured
    begins, late = _recordings(t)
    if begins is None:
        raise _disordered(measured, np.diff(t))
    if len(begins) > 1:
        note = f"the clock begins anew in {measured.lines(np.array(begins[1:]))}: {len(begins)} recordings"
        t = np.concatenate(in_succession(np.split(t, begins[1:])))
        measured = measured._replace(values={**measured.values, "time": t}, notes=(*measured.notes, note))
    if late.any():
        measured = measured.where(
            ~late, f"rows that are not later than an earlier one were left out: {measured.lines(late)}"
        )
    t = measured.values["time"]
    _check_unit(measured, float(np.median(np.diff(t))), float(t[-1] - t[0]))
    return measured


def in_succession(times: Sequence[Array]) -> list[Array]:
    """Return the times (n,) [s] of recordings, each counted on from the previous one after a gap."""
    found: list[Array] = []
    for t in times:
        begin = float(found[-1].max()) + _BETWEEN if found else 0.0
        found.append(t - t[0] + begin)
    return found


def _recordings(t: Array) -> tuple[list[int] | None, Mask]:
    """Return the rows in which the clock begins, and the mask (n,) of rows not later than an earlier one since then.

    The rows are None if the times are in no order, i.e. if a recording would have a few rows only.
    """
    begins, late = [0], np.zeros(t.size, bool)
    while True:
        since = t[begins[-1] :]
        behind = np.concatenate([[False], since[1:] <= np.maximum.accumulate(since)[:-1]])
        again = next((first for first, last in _runs(behind) if last - first > _LONGEST), since.size)
        late[begins[-1] : begins[-1] + again] = behind[:again]
        if again == since.size:
            return begins, late
        if again < _LEAST_ROWS:
            return None, late
        begins.append(begins[-1] + again)


def _disordered(measured: Measured, steps: Array) -> InvalidFile:
    """Return the error for times that are in no order, by the steps (n - 1,) [s] between them."""
    back, still = (np.flatnonzero(wrong) + 1 for wrong in (steps < 0, steps == 0))
    if back.size:
        reverse = back.size > steps.size / 2
        what = "the rows run backwards in time" if reverse else f"time goes back in {measured.lines(back)}"
        return measured.mistake("time", f"{what}: a log is in the order of time", int(back[0]))
    what = f"time stands still in {measured.lines(still)}: the stamps are too coarse, or rows are there twice"
    return measured.mistake("time", f"{what}; record finer stamps", int(still[0]))


def is_raw(measured: Measured) -> bool:
    """Return whether the rows are a log in the order of time, with steps short enough to show motion."""
    steps = np.diff(measured.values.get("time", np.zeros(0)))
    return bool(steps.size and (steps > 0).all() and np.median(steps) <= _PLAUSIBLE_STEP[1])


def without_spikes(measured: Measured) -> Measured:
    """Return the log without the rows in which a reading is a spike."""
    columns = {q: a for q, a in measured.values.items() if _kind(q) in (*_PRESSURES, *_LEAST)}
    found = spikes_of(measured.values["time"], columns)
    if not found:
        return measured
    drop = np.any([*found.values()], axis=0)
    return measured.where(~drop, f"rows with spikes were left out: {_described(measured, found)}")


def refuse_turns(measured: Measured) -> None:
    """Raise `InvalidFile` with the lines of angles that differ by more than half a turn from the previous row."""
    t = measured.values["time"]
    steps = np.abs(np.diff(measured.values["theta"], prepend=measured.values["theta"][:1]))
    turned = np.flatnonzero((steps > np.pi) & (np.diff(t, prepend=t[:1]) <= GAP))
    if turned.size:
        what = f"{steps[turned[0]] / DEG:.3g}° from the row before, as in {measured.lines(turned)}"
        sentence = f"{what}: a wrap, or a missed reading; unwrap the angle (numpy.unwrap), or leave the rows out"
        raise measured.mistake("theta", sentence, int(turned[0]))


def _described(measured: Measured, found: Mapping[str, Mask]) -> str:
    """Return the columns and lines of spikes in words, each with the reading of the first."""
    parts = []
    for quantity, rows in found.items():
        column, value = measured.columns[quantity], measured.values[quantity][rows][0]
        shown = f"{(value + column.offset) / column.scale:.4g} {column.unit}"
        first = "the first " if rows.sum() > 1 else ""
        parts.append(f"column {column.name!r} in {measured.lines(rows)} ({first}{shown})")
    return ", ".join(parts)


def stretches(t: Array) -> list[slice]:
    """Return the parts of a log with times t (n,) [s] in which no gap is longer than 1 s."""
    ends = [*(np.flatnonzero(np.diff(t) > GAP) + 1).tolist(), t.size]
    return [slice(first, last) for first, last in zip([0, *ends[:-1]], ends, strict=True)]


def evenly(t: Array) -> bool:
    """Return whether times (n,) [s] are even enough for a filter with a constant step."""
    steps = np.diff(t)
    return bool(steps.std() <= UNEVEN * np.median(steps))


def even_times(t: Array, step: float | None = None) -> Array:
    """Return even times [s] from the first to the last of t (n,), with this step [s] or its median, or a longer one."""
    if step is None:
        step = max(float(np.median(np.diff(t))), float(t[-1] - t[0]) / MOST_ROWS)
    return np.asarray(t[0] + step * np.arange(int((t[-1] - t[0]) / step * (1 + 1e-12)) + 1))


def long_stretches(measured: Measured, least: float) -> Measured:
    """Return the parts of a log without a gap of more than 1 s that last `least` [s] or more.

    If no part is twice as long, those that last half as long as the longest are kept. A note lists the gaps and the
    rows left out.
    """
    t, lines = measured.values["time"], measured.table.lines
    parts = stretches(t)
    if len(parts) == 1:
        return measured
    durations = [float(t[part.stop - 1] - t[part.start]) for part in parts]
    kept = [part for part, lasts in zip(parts, durations, strict=True) if lasts >= min(least, max(durations) / 2)]
    keep = np.zeros(t.size, bool)
    for part in kept:
        keep[part] = True
    note = f"the log has gaps of more than {GAP:g} s before {listed([lines[part.start] for part in parts[1:]])}"
    note += f": {len(kept)} stretches are used" if len(kept) > 1 else ": one stretch is used"
    left = int(t.size - keep.sum())
    note += f"; {left} rows in shorter ones were left out" if left else ""
    return measured.where(keep, note) if left else measured._replace(notes=(*measured.notes, note))


def spikes_of(t: Array, columns: Mapping[str, Array]) -> dict[str, Mask]:
    """Return the mask (n,) of spikes by column with any; those of pressures [Pa] include drop-outs."""
    kinds = {q: _kind(q) for q in columns}
    masks = {
        q: pressure_spikes(t, a) if kinds[q] in _PRESSURES else _jumps(t, a, _LEAST[kinds[q]])
        for q, a in columns.items()
    }
    return {quantity: mask for quantity, mask in masks.items() if mask.any()}


def _kind(quantity: str) -> str:
    """Return the quantity without its number."""
    return quantity.rstrip("0123456789")


def _once(measured: Measured) -> Measured:
    """Leave out rows that repeat the previous row in every quantity, including the time."""
    table = np.stack(list(measured.values.values()))
    twice = np.concatenate([[False], (np.diff(table) == 0).all(axis=0)])
    if not twice.any():
        return measured
    return measured.where(~twice, f"rows that repeat the row before were left out: {measured.lines(twice)}")


def _check_unit(measured: Measured, step: float, duration: float) -> None:
    """Refuse stamps whose steps are plausible only in another unit."""
    low, high = _PLAUSIBLE_STEP
    column = measured.columns["time"]
    if column.certain or measured.table.is_clock(column.place):
        return
    unit, units = column.unit or "s", UNITS["time"]
    raw = step / units[unit]
    if step > high:
        likely = [name for name in ("ms", "us", "ns") if low <= raw * units[name] <= high]
        what = f"samples are {step:g} s apart, too far to see what moves"
    elif duration < _LEAST_DURATION:
        likely = [n for n in ("s", "ms") if n != unit and units[n] > units[unit] and low <= raw * units[n] <= high]
        what = f"the log lasts {duration:.3g} s only"
    else:
        return
    if likely:
        say = f'--columns "time={column.name}:{likely[0]}"'
        raise measured.mistake("time", f"{what}; {likely[0]} for {unit}? If so, say {say}", 0)


def pressure_spikes(t: Array, P: Array) -> Mask:
    """Return the mask (n,) of spikes and drop-outs of a pressure [Pa] at times t [s]."""
    if P.size <= _NEAR:
        return np.zeros(P.size, bool)
    commanded = not np.median(np.abs(np.diff(P, 2))) > 0
    spikes = _jumps(t, P, _LEAST_PRESSURE)
    if commanded:
        held = P[~spikes]
        spikes &= (P < held.min()) | (P > held.max())
    return np.asarray(spikes | _dropouts(t, P, _LONGEST_DROP_COMMANDED if commanded else _LONGEST_DROP))


def _jumps(t: Array, a: Array, least: float) -> Mask:
    found = np.zeros(a.size, bool)
    for count in range(1, _LONGEST + 1):
        back = _there_and_back(a, count)
        if back.size <= _NEAR:
            break
        limit = max(least, _USUAL * float(np.quantile(back, 0.97)))
        starts = (np.flatnonzero(back > limit) + 1).tolist()
        far = found.copy()
        for first in starts:
            far[first : first + count] = True
        for first in starts:
            last = first + count
            around = _around(far, first, last)
            if around is not None:
                curve = np.polynomial.Polynomial.fit(t[around], a[around], 2)
                size = np.abs(a[first:last] - curve(t[first:last])).min()
                found[first:last] |= size > max(least, _AROUND * float(np.ptp(a[around] - curve(t[around]))))
    return found


def _there_and_back(a: Array, count: int) -> Array:
    """Return the smaller of the jumps into and out of every `count` rows from the second on, 0 unless on one side."""
    into, out = a[1:-count] - a[: -count - 1], a[count:-1] - a[count + 1 :]
    return np.where(into * out > 0, np.minimum(np.abs(into), np.abs(out)), 0.0)


def _dropouts(t: Array, P: Array, longest: float) -> Mask:
    """Return the rows of pressures that fall to zero and return, each within a row.

    They are not drop-outs if the pressure is often zero; those above 60 ms must return to the previous level, and are
    none if the pressure is zero at other times.
    """
    found = np.zeros(P.size, bool)
    empty = np.asarray(np.abs(P) <= _EMPTY)
    runs = _runs(empty)
    inner = [(first, last) for first, last in runs if 0 < first and last < P.size]
    sudden = [(first, last) for first, last in inner if min(P[first - 1], P[last]) > _LEAST_DROP]
    brief = [run for run in sudden if t[run[1]] - t[run[0]] < _LONGEST_DROP_COMMANDED]
    back = [
        (first, last)
        for first, last in sudden
        if t[last] - t[first] < longest and _AROUND * abs(P[last] - P[first - 1]) < P[first - 1]
    ]
    for first, last in {*brief, *back} if {*brief, *back} == {*runs} else brief:
        found[first:last] = True
    return found if found.mean() < _RARE else np.zeros(P.size, bool)


def _runs(mask: Mask) -> list[tuple[int, int]]:
    """Return first row, and row after the last, of every run of marked rows."""
    edges = np.diff(np.concatenate([[0], mask.astype(int), [0]]))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def _around(mask: Mask, first: int, last: int) -> NDArray[np.intp] | None:
    """Return the three unmarked rows before and after a run; None if they are not near it."""
    before = [i for i in range(max(first - _NEAR, 0), first) if not mask[i]][-3:]
    after = [i for i in range(last, min(last + _NEAR, mask.size)) if not mask[i]][:3]
    return np.array(before + after) if len(before) == len(after) == 3 else None
