"""Driving of tones: sines of both commands about a rest that fade into one another.

A joint with friction that stops between two tones stays at an edge of its loop, from which the next tone would throw it
by twice its amplitude. Each tone therefore fades in while the one before fades out. A drive is halved as soon as the
angle is 1.4 times the wanted amplitude away from the middle of the last period.

The drive of a joint with friction is about affine in its swing, F = F_c + c A, and F_c may be large: near A it is a
power of the swing with the exponent c A/F. The search for the drive of a swing is therefore a secant method of
logarithms, in bounded steps. Its exponent is kept from tone to tone.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from math import isfinite, log, pi, sin
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.measuring.loops import Tone, tone_of
from mpc.bench.rows import Pressures
from mpc.model.plant import Plant

_JUMPING, CAUTIOUS, _PROPORTIONAL = 0.15, 0.4, 1.0  # exponents of a drive by its swing: least, first, greatest
_STEP, _FARTHER = 1.3, 1.5  # greatest steps: of a swing below _STARTED, else
_STARTED = 0.3  # of the wanted amplitude
_ENOUGH = 1.4  # times the wanted amplitude: the drive is cut …
_CUT, _FALL, _SOON = 0.5, 0.25, 0.15  # … to this share, within these periods and this time [s]
_SUDDEN = 4.0  # of the steps across the dead band
_MARGIN = 0.15 * BAR  # from a pressure at which a cable is slack, and from the supply's ends
_LEAST_ROOM = 0.05 * BAR
_LEAST_ROWS = 8  # of a tone
_FOLLOWED = 0.1  # [-] of a slow drive: pressures with a lesser amplitude do not follow their commands
QUICK = 1.6  # [Hz], above slow tones


class Refused(Exception):  # a finding, reported in the result
    """Refusal of a measurement about this rest; the message has the reason."""


class Late(Refused):
    """Refusal of a tone for which no time is left."""


@dataclass
class Findings:
    """All findings of the experiment."""

    tones: list[Tone] = field(default_factory=list)
    curve: list[Tone] = field(default_factory=list)
    balance: tuple[Tone, Tone] | None = None  # without and with the weight
    left_out: tuple[float, ...] = ()  # amplitudes of the series, for lack of time [rad]
    refusal: str = ""
    duration: float = 0.0  # [s]
    furthest: float = 0.0  # greatest |θ - rest| over the wanted amplitude [-]


class Wave(NamedTuple):
    """Sines of both commands about the rest, with half of the dead band in the direction of a pressure's motion."""

    frequency: float  # [Hz]
    drive: Array  # amplitudes of both commands [Pa] (2,)
    dead: Array  # (2,) [Pa]
    behind: Array  # phases by which the pressures lag (2,)

    def times(self, scale: float) -> "Wave":
        """Return the wave with `scale` times its amplitudes."""
        return self._replace(drive=scale * self.drive)

    def at(self, phase: float) -> Array:
        """Return the commands (2,) [Pa] relative to the rest."""
        return np.asarray(self.drive * sin(phase) + self.dead * np.tanh(_SUDDEN * np.cos(phase - self.behind)))


class Search:
    """Search for the scale of a drive whose swing is A, as a power of the swing: `exponent` is 1 without friction.

    The exponent is that between the last two swings, or once those of the last two on either side of A: friction
    remembers earlier drives, but between neighbouring ones noise decides.
    """

    def __init__(self, A: float, scale: float, exponent: float = CAUTIOUS) -> None:
        self.A, self.scale, self.exponent = A, scale, exponent
        self._tried: tuple[float, float] | None = None  # swing, scale
        self._across: tuple[float, float] | None = None  # the same, on the other side of A

    def learn(self, swing: float, cut: bool) -> None:
        """Set the next scale by the swing at the present one."""
        swing, last = max(swing, 1e-9, _ENOUGH * self.A * cut), self._tried
        if last is not None:
            crossed = (last[0] < self.A) != (swing < self.A)
            other = last if crossed else self._across or last
            self._across = last if crossed else None
            rise, more = log(swing / other[0]), log(self.scale / other[1])
            if rise * more > 0:
                self.exponent = min(max(more / rise, _JUMPING), _PROPORTIONAL)
        self._tried = swing, self.scale
        most = _STEP if swing < _STARTED * self.A else _FARTHER
        guess = self.scale * (self.A / swing) ** self.exponent if swing <= _ENOUGH * self.A else 0.0
        self.scale = min(max(guess, self.scale / _STEP), self.scale * most)


def resting(plant: Plant, theta: float, K: float) -> Pressures:
    """Return the pressures [Pa] of the model's rest at `theta` [rad] with the isobaric stiffness `K` [N·m/rad].

    Raises `InvalidInput` if the joint has no such rest.
    """
    x = plant.at_rest(theta, K)
    held = plant.allocate(theta, K, plant.torque_for(theta, 0.0, 0.0))
    if not held.success:
        raise InvalidInput(f"no rest at {theta / DEG:.4g}° and {K:.4g} N·m/rad: {held.message}")
    return float(x[2]), float(x[3])


def room(plant: Plant, theta: float, rest: Pressures) -> tuple[float, float]:
    """Return the amplitudes [Pa] about a rest that keep cables taut and pressures within the supply."""
    low, high = plant.pressure_limits
    found = []
    for P, side in zip(rest, plant.joint.sides(theta), strict=True):
        slack = float(side.muscle.pressure(0.0, side.contraction))
        found.append(max(min(P - max(slack, low), high - P) - _MARGIN, _LEAST_ROOM))
    return found[0], found[1]


class Driver:
    """Commands of tones about the rest of a plant, sample by sample."""

    def __init__(self, plant: Plant, dt: float, first: Pressures, theta: float, amplitude: float) -> None:
        self.plant, self.dt, self.first = plant, dt, first
        self.findings = Findings()
        self._rest = theta  # [rad]
        self._asked, self._fading = amplitude, amplitude  # wanted amplitudes of the wave and of the one before [rad]
        self._wave, self._phases = Wave(1.0, *3 * (np.zeros(2),)), (0.0, 0.0)  # of the wave and of the one before
        self._tick: Tick | None = None
        self._angles: list[float] = []  # of all samples [rad]

    def _centre(self) -> float:
        """Return the middle [rad] of the angles during the last period; NaN without readings."""
        last = self._angles[-round(1 / self._wave.frequency / self.dt) :]
        seen = [angle for angle in last if isfinite(angle)]
        return (max(seen) + min(seen)) / 2 if seen else float("nan")

    def _played(
        self, wave: Wave, periods: float, fade: float, sliding: bool = False
    ) -> Generator[Decision, None, tuple[Array, bool]]:
        """Play periods of a wave as `_driven` does; return the complete rows (t, θ, P1, P2), and whether it was cut."""
        rows, cut = yield from self._driven(wave, periods, fade, sliding)
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) < _LEAST_ROWS:
            raise Refused("the device gave too few readings of angle and pressures")
        return rows, cut

    def _driven(
        self, wave: Wave, periods: float, fade: float, sliding: bool = False
    ) -> Generator[Decision, None, tuple[Array, bool]]:
        """Play periods of a wave; return all rows, and whether the drive was cut.

        The wave fades in over `fade` periods, while the one before fades out. Excursions are relative to the greater of
        their wanted amplitudes until then. They are from the middle of the period before, or while the joint is
        `sliding` from that of the present one.
        """
        before, self._wave, centre = self._wave, self._within(wave), self._centre()
        wave, old = self._wave, self._phases[0]
        self._phases = old if before.frequency == wave.frequency else 0.0, old
        less, rows, cut = 1.0, [], False
        fall = (1 - _CUT) * self.dt / min(_FALL / wave.frequency, _SOON)
        for k in range(round(periods / wave.frequency / self.dt)):
            share = min(1.0, (k + 1) * wave.frequency * self.dt / fade)
            u = np.array(self.first) + less * self._mixed(before, share)
            rows.append(self._row())
            wanted = max(self._asked, self._fading) if share < 1 else self._asked
            excursion = abs(rows[-1][1] - (self._centre() if sliding else centre)) / wanted
            if isfinite(excursion):
                self.findings.furthest = max(self.findings.furthest, excursion)
                cut = cut or excursion > _ENOUGH
            if cut:
                less = max(less - fall, _CUT)
            yield Decision((float(u[0]), float(u[1])), Phase.RUN)
        self._wave, self._fading = wave.times(less), self._asked
        return np.array(rows), cut

    def _mixed(self, before: Wave, share: float) -> Array:
        """Return the next commands (2,) of the wave and the fading one, relative to the rest [Pa]."""
        now, old = (
            phase + 2 * pi * wave.frequency * self.dt
            for phase, wave in zip(self._phases, (self._wave, before), strict=True)
        )
        self._phases = now, old
        return share * self._wave.at(now) + (1 - share) * before.at(old)

    def _within(self, wave: Wave) -> Wave:
        """Return the wave with commands within the supply, and pressures, which lag, within their room."""
        (low, high), first, drive = self.plant.pressure_limits, np.array(self.first), np.maximum(abs(wave.drive), 1e-9)
        commands = (np.minimum(first - low, high - first) - np.abs(wave.dead)) / drive
        pressures = np.array(room(self.plant, self._rest, self.first)) / (drive * np.cos(wave.behind))
        return wave.times(float(np.clip(min(*commands, *pressures), 0.0, 1.0)))

    def _tone(self, rows: Array, f: float) -> Tone:
        """Return the tone of the rows, with torques at their mean angle."""
        agonist, antagonist = self.plant.joint.sides(float(rows[:, 1].mean()))
        T = np.column_stack([agonist.torque(rows[:, 2]), antagonist.torque(rows[:, 3])])
        tone = tone_of(rows[:, 0], rows[:, 1], rows[:, 2:], T, f)
        if np.ptp(rows[:, 1]) == 0:
            raise Refused(
                f"the angle stays at {rows[0, 1] / DEG:.3g}° while the pressures oscillate: friction holds "
                "the joint, or check the encoder"
            )
        return tone

    def _check_followed(self, tone: Tone) -> None:
        """Refuse a slow tone in which a measured pressure does not follow its command."""
        drive = self._wave.drive
        reached = np.abs(tone.harmonics[0, 1:]) / np.abs(self._torque_gains(self._rest))
        if tone.frequency <= QUICK and (reached < _FOLLOWED * drive).any():
            k = int(np.argmin(reached - _FOLLOWED * drive))
            raise Refused(
                f"the pressure of muscle {k + 1} does not follow its command (±{reached[k] / BAR:.2g} of "
                f"±{drive[k] / BAR:.2g} bar at {tone.frequency:.2g} Hz): check sensors, their units, valves and supply"
            )

    def _torque_gains(self, theta: float) -> tuple[float, float]:
        one, two = self.plant.joint.sides(theta)
        return float(one.torque_gain(self.first[0])), float(two.torque_gain(self.first[1]))

    def _ended(self) -> Iterator[Decision]:
        """Fade out, which leaves the joint in the middle of its loop."""
        still = self._wave.times(0.0)._replace(dead=np.zeros(2))
        yield from self._driven(still, 1, fade=1)

    def _hold(self, duration: float) -> Iterator[Decision]:
        for _ in range(round(duration / self.dt)):
            yield Decision(self.first, Phase.RUN)

    def _seen(self, decisions: Iterator[Decision]) -> Generator[Decision, None, Array]:
        """Return the rows (t, θ, P1, P2) during some decisions."""
        rows = []
        for decision in decisions:
            rows.append(self._row())
            yield decision
        return np.array(rows)

    def _row(self) -> tuple[float, ...]:
        assert self._tick is not None
        reading = self._tick.reading
        self._angles.append(reading.theta)
        return reading.t, reading.theta, *reading.P
