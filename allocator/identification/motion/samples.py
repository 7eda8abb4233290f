"""Logs of a moving joint: reading, rows in time, and tests of excitation.

Columns by name and unit as for `read_samples` (`phi [deg]`, `P1_bar`, …), in any order; others are listed in the notes:

    time [s, ms, us, ns, min]   increasing; s without a unit; also clock times (12:03:04.567, ISO 8601)
    theta [deg, rad]            as the encoder shows it
    pressure1, pressure2 [bar, mbar, kPa, MPa, Pa, psi], gauge, commanded or measured
    measured1, measured2        measured pressures beside commands; both or neither

A gap of more than a second ends a stretch. Several stretches, of one or several files, are one log: the joint has the
same parameters in all of them, and begins each without memory.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.text import FilePath, short
from allocator.identification.columns import read_columns
from allocator.identification.end_stops import Stop, stops
from allocator.identification.outliers import some
from allocator.identification.recording import (
    GAP,
    MOST_ROWS,
    UNEVEN,
    even_times,
    evenly,
    in_succession,
    in_time,
    long_stretches,
    refuse_turns,
    spikes_of,
    stretches,
    without_spikes,
)
from allocator.units import BAR, DEG

TAUT_FROM = 1.5 * BAR  # both pressures, above which muscles of this kind are taut
_LEAST_ROWS = 200
_LEAST_TIME = 10.0  # [s]
_LONGEST_STEP = 0.2  # [s] between rows
_LEAST_STRETCH = 4.0  # [s] shorter ones hardly last beyond `_FORGOTTEN`
_FORGOTTEN = 2.0  # [s] for a joint to reach the angle of the first commands
_LEAST_SWING = 2 * DEG  # from the least to the greatest angle
_LEAST_MOVE = 0.1 * BAR  # of a pressure
_LEAST_TURNS = 3
_SPEED_OVER = 0.3  # [s] over which a speed is measured
_SAME_SPEED = 0.9  # squared cosine between v and sign(v); 1 on ramps, 0.81 on a sine, less with steps
_MEDIAN_OVER = 0.25  # [s]
_WANTED = (("time",), ("theta",), ("pressure1",), ("pressure2",))
_MEASURED = ("measured1", "measured2")


@dataclass(frozen=True)
class MotionLog:
    """Rows of a moving joint without load, in the order of time; arrays (n,)."""

    t: Array  # [s], increasing
    theta: Array  # encoder reading [rad]
    P1: Array  # agonist, commanded or measured, gauge [Pa]
    P2: Array  # antagonist [Pa]
    measured: tuple[Array, Array] | None = None  # measured pressures [Pa], if P1 and P2 are commands
    every: int = 1  # one of so many rows is used
    notes: tuple[str, ...] = ()  # sentences about data not read or left out

    @classmethod
    def checked(cls, t: ArrayLike, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, *, medians: bool = True) -> Self:
        """Return a checked log from array-like data, with `medians` of noisy pressures, and rows at even times.

        Rows with a spike or a drop-out of a pressure are left out; a note lists them.

        Raises `InvalidInput` for an invalid log, or one with too little motion, with a suggested measurement.
        """
        named = {
            "t": checks.real("t", t, "s"),
            "theta": checks.angle("theta", theta),
            "P1": checks.pressure("P1", P1),
            "P2": checks.pressure("P2", P2),
        }
        if any(values.ndim != 1 for values in named.values()):
            raise InvalidInput("t, theta, P1 and P2 have to be rows of numbers, one of each for every sample")
        rows = [np.array(a, float) for a in checks.broadcast(**named)]
        log = cls(rows[0], rows[1], rows[2], rows[3])
        log._check_time()
        log = log._without_spikes()
        log._check_turns()
        log._check_excitation()
        log = log._even()
        log = log._without_noise() if medians else log
        return log.thinned(-(-log.n // MOST_ROWS))

    def thinned(self, every: int) -> Self:
        """Return every n-th row."""
        return replace(self._rows(slice(None, None, every)), every=every)

    def _rows(self, which: slice | Mask) -> Self:
        return replace(self, **{name: getattr(self, name)[which].copy() for name in ("t", "theta", "P1", "P2")})

    @property
    def n(self) -> int:
        """Return the number of rows."""
        return self.t.size

    @cached_property
    def parts(self) -> tuple[slice, ...]:
        """The rows of each stretch without a gap."""
        return tuple(stretches(self.t))

    @cached_property
    def step(self) -> float:
        """Return the median time between rows [s]."""
        return float(np.median(np.diff(self.t)))

    @cached_property
    def ends(self) -> tuple[Stop, ...]:
        """The end stops at which rows rest."""
        return tuple(stops(self.theta, self.P1, self.P2))

    @cached_property
    def settled(self) -> Mask:
        """Return the rows (n,) after the first two seconds of their stretch, or after its first half if that is less.

        The others depend on the unknown state at the beginning. Rows at a stop, which the motion does not know, are
        not among them.
        """
        since = [self.t[part] - self.t[part.start] for part in self.parts]
        later = np.concatenate([t >= min(_FORGOTTEN, t[-1] / 2) for t in since])
        return np.asarray(later & ~np.any([np.zeros(self.n, bool), *(end.there for end in self.ends)], axis=0))

    @cached_property
    def swing(self) -> float:
        """Return the greatest angle less the least [rad]."""
        return float(np.ptp(self.theta))

    @cached_property
    def middle(self) -> float:
        """Return the angle between the greatest and the least [rad]."""
        return float(self.theta.max() + self.theta.min()) / 2

    @property
    def greatest_pressure(self) -> float:
        """Return the greatest pressure [Pa]."""
        return float(max(self.P1.max(), self.P2.max()))

    def fastest(self, duration: float) -> float:
        """Return the fastest change [Pa/s] of a pressure over `duration` [s], or over a row if that is longer."""
        rows = max(round(duration / self.step), 1)
        rises = [
            np.abs(P[part][rows:] - P[part][:-rows]).max(initial=0.0) for part in self.parts for P in (self.P1, self.P2)
        ]
        return float(max(rises)) / (rows * self.step)

    @property
    def varies_sum(self) -> bool:
        """Return whether P1 + P2 varies enough to identify its effects."""
        return self.relative_spread > 0.05

    @property
    def swept(self) -> bool:
        """Return whether a pressure changes continuously, not in steps."""
        return bool(np.median(np.abs(np.diff(self.P1))) > 0 or np.median(np.abs(np.diff(self.P2))) > 0)

    @property
    def relative_spread(self) -> float:
        """Return the standard deviation of P1 + P2 over its mean [-]."""
        total = self.P1 + self.P2
        return float(total.std() / total.mean())

    @property
    def varies_speed(self) -> bool:
        """Return whether the speed of the angle varies enough to distinguish delays from hysteresis.

        A delay τ moves the angle by -τ v, hysteresis by a share of -sign(v), which are indistinguishable on ramps of
        one speed.
        """
        window = max(1, round(_SPEED_OVER / self.step))
        v = self.theta[window:] - self.theta[:-window]
        return float(np.abs(v).sum() ** 2) < _SAME_SPEED * v.size * float((v**2).sum())

    def _even(self) -> Self:
        """Return the log with rows at even times: angles interpolated linearly, pressures of the previous row.

        Inertia and damping are a filter with a constant step. A row that is late by less than `UNEVEN` steps, e.g. by
        rounding of its stamp, counts as punctual; otherwise its commands would come a step later.
        """
        if all(evenly(self.t[part]) for part in self.parts):
            return self
        step = max(self.step, sum(float(np.ptp(self.t[part])) for part in self.parts) / MOST_ROWS)
        t = np.concatenate([even_times(self.t[part], step) for part in self.parts])
        before = np.searchsorted(self.t, t + UNEVEN * step, side="right") - 1
        return replace(self, t=t, theta=np.interp(t, self.t, self.theta), P1=self.P1[before], P2=self.P2[before])

    def _without_noise(self) -> Self:
        """Return the log with medians of the pressures if sensors add noise to them.

        A play follows the peaks of noise, which makes hysteresis appear wider; a median preserves steps and ramps.
        """
        from scipy.ndimage import median_filter

        width = 2 * round(_MEDIAN_OVER / 2 / self.step) + 1
        P1, P2 = (
            np.concatenate([median_filter(P[part], width, mode="nearest") for part in self.parts])
            if np.median(np.abs(np.diff(P, 2))) > 0
            else P
            for P in (self.P1, self.P2)
        )
        return replace(self, P1=P1, P2=P2)

    def _check_time(self) -> None:
        if self.n < 2 or not (np.diff(self.t) > 0).all():
            i = int(np.argmax(np.diff(self.t) <= 0)) + 1 if self.n > 1 else 0
            raise InvalidInput(f"t[{i}] is not later than the row before it: a log is in the order of time [s]")
        if self.step > _LONGEST_STEP:
            raise InvalidInput(
                f"rows are {self.step:g} s apart, too far to see how the joint moves: record at 20 Hz; ms for s?"
            )
        if min(part.stop - part.start for part in self.parts) < 2:
            raise InvalidInput(f"a row stands alone between two gaps of more than {GAP:g} s: leave it out")

    def _without_spikes(self) -> Self:
        found = spikes_of(self.t, {"theta": self.theta, "pressure1": self.P1, "pressure2": self.P2})
        if not found:
            return self
        wrong = [f"{name.replace('pressure', 'P')}[{i}]" for name, mask in found.items() for i in np.flatnonzero(mask)]
        note = f"rows with spikes were left out: {some(wrong)}"
        return replace(self._rows(~np.any([*found.values()], axis=0)), notes=(*self.notes, note))

    def _check_turns(self) -> None:
        """Refuse impossible angles: a revolution within a row."""
        turned = (np.abs(np.diff(self.theta)) > np.pi) & (np.diff(self.t) <= GAP)
        if turned.any():
            i = int(np.argmax(turned)) + 1
            raise InvalidInput(
                f"theta[{i}] is {abs(self.theta[i] - self.theta[i - 1]) / DEG:.3g}° from the row before it: a wrap "
                "or a missed reading; unwrap the angle (numpy.unwrap), or leave the row out"
            )

    def _check_excitation(self) -> None:
        """Refuse a log that cannot distinguish lags from hysteresis, and suggest an experiment."""
        duration = sum(float(np.ptp(self.t[part])) for part in self.parts)
        if self.n < _LEAST_ROWS or duration < _LEAST_TIME:
            raise InvalidInput(
                f"{self.n} rows over {duration:.3g} s are too few: record a minute or more of random steps of both "
                "pressures"
            )
        if self.swing < _LEAST_SWING:
            raise InvalidInput(
                f"theta stays within {self.swing / DEG:.2g}°: the log shows no motion; step the pressures against "
                "each other through the range that the joint is used in"
            )
        if self.ends and (free := int(self.settled.sum())) < _LEAST_ROWS:
            raise InvalidInput(
                f"only {free} rows are off the end stops, {', '.join(f'{end.angle / DEG:.3g}°' for end in self.ends)}: "
                "a joint at a stop shows nothing of its motion; step the pressures less far"
            )
        for name, P in (("P1", self.P1), ("P2", self.P2)):
            if np.ptp(P) < _LEAST_MOVE:
                raise InvalidInput(
                    f"{name} stays within {np.ptp(P) / BAR:.2g} bar, so that the log says nothing of its muscle: step "
                    "both pressures, not always together"
                )
        if (turns := self.turns) < _LEAST_TURNS:
            raise InvalidInput(
                f"theta turns round {turns} times by more than a tenth of its range: lag and hysteresis cannot be told "
                f"apart; move to and fro at least {_LEAST_TURNS} times, with steps of different heights"
            )

    @property
    def turns(self) -> int:
        """Return the number of reversals of the angle by more than a tenth of its range."""
        least, turns, way, end = self.swing / 10, 0, 0, float(self.theta[0])
        for theta in self.theta.tolist():
            if way * (theta - end) >= 0 and way:
                end = theta
            elif abs(theta - end) > least:
                turns, way, end = turns + (way != 0), 1 if theta > end else -1, theta
        return turns


def read_motion_log(
    path: FilePath | Sequence[FilePath],
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
) -> MotionLog:
    """Read the log of a moving joint; `columns` as for `read_joint_log`: ``{"theta": "phi:deg"}``.

    Several files are one log in the order given, each of one stretch or more. `skip_rows` lines are skipped at the
    beginning of a file. Rows with a missing reading, a spike, or a drop-out of a pressure are left out. `topics` maps
    quantities to numbers of a ROS bag or an MCAP file:
    ``"theta=/joint_states.position[0] pressure1=/valves.data[0]:bar …"``. `MotionLog.notes` lists the unused rows.

    Raises `InvalidFile`, with line and column if applicable, also for too little motion in all files together, and
    `InvalidInput` if only some files have measured pressures in addition to commands.
    """
    paths = short(path)
    logs = {name: _read(one, columns, skip_rows, topics) for name, one in paths.items()}
    log = joined(logs)
    try:
        MotionLog.checked(log.t, log.theta, log.P1, log.P2)
    except InvalidInput as error:
        raise InvalidFile(some([str(one) for one in paths.values()]), "; ".join((str(error), *log.notes))) from None
    return log


def _read(path: FilePath, columns: Mapping[str, str] | None, skip_rows: int, topics: str | None) -> MotionLog:
    measured = read_columns(path, _WANTED, _MEASURED, columns, skip_rows=skip_rows, topics=topics)
    measured = without_spikes(in_time(measured))
    measured = long_stretches(measured, _LEAST_STRETCH)
    refuse_turns(measured)
    t, theta, P1, P2 = (measured.values[quantity] for (quantity,) in _WANTED)
    there = [measured.values[name] for name in _MEASURED if name in measured.values]
    if len(there) == 1:
        raise InvalidFile(path, f"only one of {' and '.join(_MEASURED)} is there: give both, or neither")
    return MotionLog(t, theta, P1, P2, (there[0], there[1]) if there else None, notes=measured.notes)


def joined(logs: Mapping[str, MotionLog]) -> MotionLog:
    """Return the logs of one joint, by the names of their files, as one.

    Raises `InvalidInput` if only some of them have measured pressures in addition to commands.
    """
    if len(logs) == 1:
        return next(iter(logs.values()))
    every = list(logs.values())
    if len({log.measured is None for log in every}) > 1:
        raise InvalidInput("some of the logs have measured1 and measured2, others not: give all of them, or none")
    t = np.concatenate(in_succession([log.t for log in every]))
    theta, P1, P2 = (np.concatenate([getattr(log, name) for log in every]) for name in ("theta", "P1", "P2"))
    pairs = [log.measured for log in every if log.measured is not None]
    measured = (np.concatenate([one for one, _ in pairs]), np.concatenate([two for _, two in pairs])) if pairs else None
    notes = tuple(f"{name}: {note}" for name, log in logs.items() for note in log.notes)
    return MotionLog(t, theta, P1, P2, measured, notes=notes)
