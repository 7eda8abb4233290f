"""Sweep: the experiment that identifies a joint, by random steps of both pressures and equilibria under weights.

First, without a weight, both pressures step at random, for lags and hysteresis by `fit_motion`. The setpoints of
`plan_joint_experiment` follow, each approached from above and from below and held until the angle rests, first without
and then with the weight, for the muscles by `fit_joint`. The pressures are held while the weight is hung. The
experiment writes:

    joint_log.csv    a row for each visit: means of the second at rest, torque of the weight, direction of the approach
    motion_log.csv   a row for each sample of the random steps: the angle, and the commands as P1 and P2

The loop does not wait for the answer of the person who hangs the weight (`Asking`).
"""

import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from pathlib import Path
from threading import Thread
from typing import NamedTuple

import numpy as np

from allocator import AntagonistJoint, checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.identification.joint.planning.plan import APPROACH, JointPlan, Setpoint
from allocator.units import BAR, DEG
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.rows import Pressures
from mpc.bench.safety import Reason, Stopped

STEPS = (APPROACH, 0.3 * BAR, 0.15 * BAR)  # distances of the approach to a setpoint, by preference
_STILL = 0.3 * DEG  # over a second, as in `read_joint_log`
_WINDOW = 1.0  # [s] of means in an equilibrium
_MIDDLE = 0.8  # [-] of the joint's range for random steps
_LOWEST = 1.5 * BAR  # of random steps: below, cables are slack
_TRIES = 10_000
JOINT_HEADER = "theta [rad],P1 [Pa],P2 [Pa],torque [Nm],direction"
MOTION_HEADER = "time [s],theta [rad],P1 [Pa],P2 [Pa],P1_measured [Pa],P2_measured [Pa]"


@dataclass(frozen=True)
class Pace:
    """Durations and rates of a sweep."""

    rate: float = 1 * BAR  # of the change to a setpoint [Pa/s]
    approach: float = 1.0  # at the pressures before a setpoint [s]
    hold: float = 2.5  # at a setpoint, at least [s]
    longest: float = 10.0  # until its angle rests [s]
    motion: float = 90.0  # random steps in all [s]
    every: float = 1.0  # between two random steps [s]

    def __post_init__(self) -> None:
        for name in ("rate", "hold", "longest", "every"):
            checks.positive(name, getattr(self, name), "Pa/s" if name == "rate" else "s")
        for name in ("approach", "motion"):
            checks.not_negative(name, getattr(self, name), "s")
        if self.hold < _WINDOW:
            raise InvalidInput(
                f"hold = {self.hold:g} s has to be {_WINDOW:g} s or more: the means are over the last one"
            )


class Visit(NamedTuple):
    """Setpoint, and the pressures from which it is approached."""

    torque: float  # of the weight [N·m]
    P: Pressures  # [Pa]
    come_from: Pressures  # [Pa]
    direction: int  # +1 if θ rises into it, -1 if it falls


class Equilibrium(NamedTuple):
    """Means measured in a visit; SI units."""

    theta: float
    P1: float
    P2: float
    torque: float
    direction: int


def within(joint: AntagonistJoint, share: float = _MIDDLE) -> AntagonistJoint:
    """Return `joint` with a `share` of its range, to keep a roughly known joint away from its stops."""
    left, right = joint.angle_range
    middle, half = (left + right) / 2, share * (right - left) / 2
    return replace(joint, angle_limits=(middle - half, middle + half))


def visits_of(plan: JointPlan, joint: AntagonistJoint, weights: bool = True) -> list[Visit]:
    """Return two visits for each setpoint of a plan, falling and rising; without `weights` only those that need none.

    The approach stays within the supply's range, and within the roughly known `joint`'s range of angles.
    """
    return [
        Visit(s.torque, (s.P1, s.P2), _approach(joint, s, direction), direction)
        for s in plan.setpoints
        for direction in (-1, 1)
        if weights or not s.torque
    ]


def _approach(joint: AntagonistJoint, s: Setpoint, direction: int) -> Pressures:
    """Return pressures from which the angle falls (-1) or rises (1) into a setpoint."""
    low, high = joint.pressure_limits
    for step in (s.approach(joint), *STEPS):
        P1 = s.P1 - direction * step
        come_from = (P1, s.P2) if low <= P1 <= high else (s.P1, min(max(s.P2 + direction * step, low), high))
        if np.isfinite(joint.equilibrium(*come_from, s.torque)):
            break
    return come_from


def random_steps(joint: AntagonistJoint, n: int, seed: int = 0) -> list[Pressures]:
    """Return n pairs of pressures [Pa] at random whose equilibria are well within the range of a roughly known joint.

    Raises `InvalidInput` if there are hardly any.
    """
    rng = np.random.default_rng(seed)
    high = joint.pressure_limits[1]
    low = min(_LOWEST, high / 3)
    narrow = within(joint)
    made: list[Pressures] = []
    for _ in range(_TRIES):
        if len(made) == n:
            return made
        P1, P2 = rng.uniform(low, high - (high - low) / 10, 2).tolist()
        if np.isfinite(narrow.equilibrium(P1, P2)):
            made.append((P1, P2))
    raise InvalidInput("hardly any pressures hold this joint within its range: check its muscles and its geometry")


class Sweep:
    """`CommandSource` of the experiment.

    Parameters
    ----------
    visits, steps
        The program: `visits_of` a plan, `random_steps` of a joint.
    dt
        Sample time [s].
    hang
        Called at every sample after a change of the weight; returns whether the weight of this torque [N·m] hangs.
    directory
        Directory of `joint_log.csv` and `motion_log.csv`; the first is written after every visit.
    about
        Comments at the head of both.
    """

    def __init__(
        self,
        visits: list[Visit],
        steps: list[Pressures],
        dt: float,
        hang: Callable[[float], bool],
        directory: Path,
        pace: Pace | None = None,
        about: Sequence[str] = (),
    ) -> None:
        if not visits and not steps:
            raise InvalidInput("there is nothing to sweep: neither setpoints nor random steps")
        self.visits, self.steps, self.dt, self.hang, self.directory = visits, steps, dt, hang, directory
        self.pace = Pace() if pace is None else pace
        self._head = "".join(f"# {line}\n" for line in about)
        self.first: Pressures = steps[0] if steps else visits[0].come_from
        self.equilibria: list[Equilibrium] = []
        self.restless = 0  # visits whose angle did not come to rest
        self.written: list[Path] = []
        self._u = self.first
        self._torque = 0.0
        self._decisions = self._all()

    @property
    def duration(self) -> float:
        """Approximate duration [s], without the time for hanging weights."""
        p = self.pace
        return len(self.visits) * (p.approach + p.hold + 2 * STEPS[0] / p.rate) + len(self.steps) * p.every

    def decide(self, tick: Tick) -> Decision | None:
        """Return the commands of this sample, None at the end."""
        self._tick = tick
        return next(self._decisions, None)

    # --- what is done, sample by sample -----------------------------------------------------------------------------

    def _all(self) -> Iterator[Decision]:
        if self.steps:
            yield from self._motion()
        for visit in self.visits:
            if visit.torque != self._torque:
                yield from self._hanging(visit.torque)
            yield from self._visit(visit)

    def _motion(self) -> Iterator[Decision]:
        """Step at random, and write the motion."""
        rows: list[list[float]] = []
        for u in self.steps:
            for decision in self._hold(u, self.pace.every):
                reading = self._tick.reading
                if rows:
                    rows[-1][2:4] = self._tick.sent  # the slew limit may have changed the commands
                rows.append([reading.t, reading.theta, *u, *reading.P])
                yield decision
        known = np.array([row for row in rows if isfinite(row[1])])
        if known.size:
            known[:, 0] -= known[0, 0]
        self._write("motion_log.csv", _csv(MOTION_HEADER, known))

    def _hanging(self, torque: float) -> Iterator[Decision]:
        """Hold until the weight hangs, and then until the joint has come to rest."""
        while not self.hang(torque):
            yield self._decision(self._u)
        self._torque = torque
        yield from self._hold(self._u, self.pace.hold)

    def _visit(self, visit: Visit) -> Iterator[Decision]:
        """Approach a setpoint, hold it until the angle rests, and note the means of the last second."""
        yield from self._move(visit.come_from)
        yield from self._hold(visit.come_from, self.pace.approach)
        yield from self._move(visit.P)
        seen: list[tuple[float, float, float]] = []
        window = round(_WINDOW / self.dt)
        for k in range(round(self.pace.longest / self.dt)):
            seen.append(self._measured())
            last = np.array(seen[-window:])
            if k * self.dt >= self.pace.hold and np.ptp(last[:, 0]) <= _STILL:
                self._note(visit, last)
                return
            yield self._decision(visit.P)
        self.restless += 1

    def _note(self, visit: Visit, last: Array) -> None:
        theta, P1, P2 = np.nanmean(last, axis=0).tolist()
        self.equilibria.append(Equilibrium(theta, P1, P2, visit.torque, visit.direction))
        self._write("joint_log.csv", _csv(JOINT_HEADER, np.array(self.equilibria)))

    def _write(self, name: str, text: str) -> None:
        path = self.directory / name
        write_text(path, self._head + text)
        if path not in self.written:
            self.written.append(path)

    def _measured(self) -> tuple[float, float, float]:
        """Return the present angle and pressures; commands in place of unmeasured pressures."""
        _, theta, (P1, P2) = self._tick.reading
        return theta, P1 if isfinite(P1) else self._u[0], P2 if isfinite(P2) else self._u[1]

    def _move(self, to: Pressures) -> Iterator[Decision]:
        """Move both pressures linearly to `to`."""
        begin = self._u
        way = max(abs(b - a) for a, b in zip(begin, to, strict=True))
        n = max(1, round(way / self.pace.rate / self.dt))
        for k in range(1, n + 1):
            one, two = (a + k / n * (b - a) for a, b in zip(begin, to, strict=True))
            yield self._decision((one, two))

    def _hold(self, u: Pressures, duration: float) -> Iterator[Decision]:
        for _ in range(round(duration / self.dt)):
            yield self._decision(u)

    def _decision(self, u: Pressures) -> Decision:
        self._u = u
        return Decision(u, Phase.RUN, {"torque": self._torque})


def _csv(header: str, rows: Array) -> str:
    lines = (",".join(f"{value:.9g}" for value in row) for row in rows.tolist())
    return "\n".join([header, *lines]) + "\n"


REQUEST = "hang the weight so that it pulls θ {1} with {0:.3g} N·m, and press Enter; the pressures are held"


class Asking:
    """Request for a weight by `ask`, called with its torque [N·m]; a thread waits for the Enter key."""

    def __init__(self, ask: Callable[[float], None]) -> None:
        self._ask = ask
        self._wanted: float | None = None
        self._line: str | None = None

    def __call__(self, torque: float) -> bool:
        """Return whether Enter was pressed since this torque [N·m] was asked for.

        Raises `Stopped` where input or output of the terminal end.
        """
        if self._wanted != torque:
            self._wanted, self._line = torque, None
            try:
                self._ask(torque)
            except OSError:
                raise Stopped(
                    Reason.TERMINATED, "the request to hang a weight cannot be answered: the terminal is closed"
                ) from None
            Thread(target=self._read, daemon=True).start()
        if self._line == "":
            raise Stopped(
                Reason.REQUESTED, "the request to hang a weight cannot be answered: standard input is at its end"
            )
        return self._line is not None

    def _read(self) -> None:
        try:
            self._line = sys.stdin.readline()
        except (OSError, ValueError):  # closed, or not text
            self._line = ""
