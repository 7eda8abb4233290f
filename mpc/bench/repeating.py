"""Learning of a motion on a device, with a safe stop between the repetitions.

The first repetition is not recorded: it gives all others the same initial memory of the joint's hysteresis. Nothing is
learned while a loop runs.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.bench.cycle import Phase
from mpc.bench.logs import Record
from mpc.bench.rows import Sheet
from mpc.bench.safety import Reason
from mpc.repetition.learner import Course, Learner, Repetition
from mpc.trials.motions.corrections import Correction
from mpc.trials.motions.reference import Reference


class Repeated(NamedTuple):
    """Records of the first, the best and the last repetition; a loop that ended early is the last one.

    Without a recorded repetition the best one is the last.
    """

    first: Record | None
    best: Record
    last: Record


def once(drive: Callable[[Reference], Record], reference: Reference, begun: Correction | None) -> Repeated:
    """Drive once along a reference, or along the correction `begun`, whose record has the desired angles."""
    record = drive(reference if begun is None else begun.reference)
    return Repeated(None, record if begun is None else compared(record, Course.of(reference, record.dt)), record)


def repeat(
    drive: Callable[[Reference], Record],
    learner: Learner,
    *,
    age: float = 0.0,
    progress: Callable[[Repetition], None] = lambda done: None,
) -> Repeated:
    """Repeat the motion of `learner` on a device until learning ends, or until a loop does not finish.

    `drive` runs one loop along a reference and returns its record. `age` [s] is the age of the angle's readings.
    `progress` is called after each recorded repetition.
    """
    last, first, best = drive(learner.reference), None, None
    while finished(last) and not learner.done:
        last = drive(learner.reference)
        if not finished(last):
            break
        found = learner.learn(read(last, learner.course, age))
        wanted = compared(last, learner.course)
        first = wanted if first is None else first
        best = wanted if best is None or found is learner.best else best
        progress(found)
    return Repeated(first, best or last, last)


def finished(record: Record) -> bool:
    """Return whether a loop reached the end of its reference."""
    return record.ending.reason is Reason.FINISHED


def read(record: Record, course: Course, age: float) -> Array:
    """Return the angles (M,) or (M, n) [rad] at the samples of the reference, from readings that are `age` [s] old."""
    t, late, at = record.where("t", "late", "read_at", phases=(Phase.RUN,))
    began = t[0] - late[0]
    when = np.where(np.isfinite(at), at, t) - began
    return _at(course.wanted.t[: course.count] - course.wanted.t[0], when - age, record.values("theta", (Phase.RUN,)))


def _at(t: Array, times: Array, theta: Array) -> Array:
    """Return angles (M, …) at the times `t` (M,) [s] from those (N, …) at other `times` (N,), NaN where not read."""
    columns = theta.reshape(len(times), -1).T
    seen = [np.isfinite(column) for column in columns]
    found = [np.interp(t, times[here], column[here]) for here, column in zip(seen, columns, strict=True)]
    return np.stack(found, axis=-1).reshape(-1, *theta.shape[1:])


def compared(record: Record, course: Course) -> Record:
    """Return the record with the desired angles in place of the corrected reference."""
    columns = dict(record.columns)
    here = np.isin(columns["phase"], (Phase.SETTLE, Phase.RUN))
    running = columns["phase"] == Phase.RUN
    due = columns["t"] - columns["late"]
    began = due[running][0] if running.any() else np.inf
    wanted = _at(due[here] - began, course.wanted.t - course.wanted.t[0], course.wanted.theta)
    for name, column in zip(Sheet.of(record.plant).fields["theta_ref"], wanted.reshape(len(wanted), -1).T, strict=True):
        columns[name] = columns[name].copy()
        columns[name][here] = column
    return replace(record, columns=columns)
