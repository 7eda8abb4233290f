"""Experiment that measures a joint's stiffness: tones of both pressures about a rest, sample by sample.

    hold the rest
    each muscle alone at a low frequency, until the angle swings by A       (their amplitudes brought together)
    both muscles against each other: low at 1.4 A, and slower at A
    both muscles in three proportions at two frequencies well above the resonance that the low tones have shown
    both muscles at a low frequency with a series of amplitudes: the curve K_felt(A)
    with a weight, both muscles at the low frequency and A, without it and with it

The amplitude of a command follows a_{k+1} = a_k (A/measured)^0.6, in steps of 1.4 at most, since friction jumps. A
drive is cut as soon as the angle leaves 1.5 times the wanted amplitude.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass, field
from math import atan, isfinite, pi, sqrt

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.guard import Pressures
from mpc.bench.measuring.loops import Tone, tone_of
from mpc.bench.measuring.weighing import Weight
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant

_EXPONENT, _STEP = 0.6, 1.4  # of the search for an amplitude
_QUICK = 1.6  # [Hz]
_CLOSE = 0.06  # [-] of the amplitude: close enough
_ENOUGH = 1.5  # times the wanted amplitude: the drive is cut
_CUT = 0.5
_BEGIN = 0.9  # [-] of the expected drive
_SUDDEN = 4.0  # of the steps across the dead band
_ABOVE = 1.6, 2.0  # of the resonance: the upper tones
_LEAST_ABOVE, _ENOUGH_ABOVE, _LOWEST_ABOVE = 1.3, 1.5, 1.2
_USED = 1.2  # of the slew: beyond it sines become triangles
_SHORT = 0.93  # [-] of the amplitude: less counts as not reached
_PLANNED = 1.0, 1.4, 0.75, 2.0, 0.5  # [-] of the wanted amplitude, in the order of the trials
_SAMPLES = 16  # per period, at least
_HIGHEST = 8.0  # [Hz]
_FLOW_SHARE = 0.8  # of the regulators' flow that a tone takes
_MARGIN = 0.15 * BAR  # from a pressure at which a cable is slack, and from the supply's ends
ONE, TWO, BOTH = (1.0, 0.0), (0.0, 1.0), (0.5, 0.5)  # shares of the torque
MORE, LESS = (0.6, 0.4), (0.4, 0.6)  # at the upper frequency, at which a muscle alone may be too slow


@dataclass(frozen=True)
class Tones:
    """Amplitudes, frequencies and durations of the experiment."""

    amplitude: float = 1.5 * DEG  # A [rad] of the tones that are compared
    low: float = 1.2  # [Hz]
    series: tuple[float, ...] = (4 * DEG, 8 * DEG)  # of K_felt(A) [rad]; empty: not measured
    slowest: float = 0.5  # to detect a dependence on the rate [Hz]
    slow: float = 1.0  # of the series [Hz]
    settle: float = 1.5  # at rest [s]
    rounds: int = 8  # of the search for an amplitude, at most

    def __post_init__(self) -> None:
        for name, unit in (("amplitude", "rad"), ("low", "Hz"), ("slow", "Hz"), ("slowest", "Hz"), ("settle", "s")):
            checks.positive(name, getattr(self, name), unit)
        checks.count("rounds", self.rounds, least=1)
        if any(not 0 < a < 1 for a in (self.amplitude, *self.series)):
            raise InvalidInput(f"amplitudes = {self.amplitude}, {self.series} rad have to lie between 0 and 1 rad")


class Refused(Exception):  # a finding, reported in the result
    """Refusal of a measurement about this rest; the message has the reason."""


@dataclass
class Findings:
    """All findings of the experiment."""

    tones: list[Tone] = field(default_factory=list)
    curve: list[Tone] = field(default_factory=list)
    quantum: float = 0.0  # of the encoder [rad]
    balance: tuple[Tone, Tone] | None = None  # without and with the weight
    refusal: str = ""
    duration: float = 0.0  # [s]
    furthest: float = 0.0  # greatest |θ - rest| over the wanted amplitude [-]


class Experiment:
    """`CommandSource` of the measurement about one rest."""

    def __init__(
        self,
        plant: Plant,
        known: Compensation,
        theta: float,
        K: float,
        dt: float,
        tones: Tones,
        weight: Weight | None = None,
    ) -> None:
        self.plant, self.known, self.dt, self.tones, self.weight = plant, known, dt, tones, weight
        x = plant.at_rest(theta, K)
        self.first: Pressures = (float(x[2]), float(x[3]))
        self.findings = Findings()
        self._rest = theta
        self._asked = self._amplitude = tones.amplitude
        self._gains = self._torque_gains(theta)
        self._tick: Tick | None = None
        self._angles: list[float] = []  # of all samples [rad]
        self._decisions = self._all()

    def decide(self, tick: Tick) -> Decision | None:
        """Return the commands of this sample, None at the end."""
        self._tick = tick
        self.findings.duration += self.dt * (1 + tick.missed)
        return next(self._decisions, None)

    # --- the sequence -----------------------------------------------------------------------------------------------

    def _all(self) -> Iterator[Decision]:
        try:
            yield from self._sequence()
        except Refused as refusal:
            self.findings.refusal = str(refusal)
        yield from self._hold(0.3)

    def _sequence(self) -> Iterator[Decision]:
        tones, found = self.tones, self.findings.tones
        A = self._amplitude = self._planned()
        stiff = self._expected(A)
        rest = yield from self._seen(self._hold(tones.settle))
        yield from self._shaken(A, stiff)
        self._find_rest(rest)
        for share in (ONE, TWO):
            tone = yield from self._brought(tones.low, share, A, stiff)
            found.append(tone)
            stiff = self._stiffness(tone, stiff)
        found.append((yield from self._brought(tones.low, BOTH, 1.4 * A, stiff, close=0.15)))
        found.append((yield from self._brought(tones.slowest, BOTH, A, stiff)))
        upper, further = self._upper(stiff)
        lowest = _LOWEST_ABOVE * self._resonance(stiff)
        tone, upper = yield from self._reached(upper, lowest, MORE, A, stiff)
        found += [tone, (yield from self._brought(upper, LESS, A, stiff))]
        tone, _ = yield from self._reached(max(further, 1.08 * upper), 1.08 * upper, BOTH, A, stiff)
        found += [tone] if tone.swing > _SHORT * A else []
        for amplitude in tones.series:
            tone = yield from self._brought(tones.slow, BOTH, amplitude, stiff, close=0.15)
            self.findings.curve.append(tone)
            stiff = self._stiffness(tone, stiff)
        if self.weight is not None:
            yield from self._weighed(self.weight, A, stiff)

    def _weighed(self, weight: Weight, A: float, stiff: complex) -> Iterator[Decision]:
        """Swing slowly without the weight, request it with the pressures held, and swing with it."""
        A = max(A, *self.tones.series)  # the widest, which erases most of the friction's memory
        before = yield from self._brought(self.tones.slow, BOTH, A, stiff, close=0.15)
        while not weight.hang(weight.torque):
            yield Decision(self.first, Phase.RUN)
        room = self._room
        raised = [p + float(np.clip(weight.torque / 2 / g, -r / 2, r / 2))
                  for p, g, r in zip(self.first, self._gains, room, strict=True)]  # fmt: skip
        self.first = (
            raised[0],
            raised[1],
        )  # which about carries it: friction is unchanged
        yield from self._hold(2 * self.tones.settle)
        self.findings.balance = before, (yield from self._brought(self.tones.slow, BOTH, A, stiff, close=0.15))

    def _shaken(self, A: float, stiff: complex) -> Iterator[Decision]:
        """Shake the joint a little to bring it to the middle of its hysteresis."""
        f = self.tones.low
        drive, _ = self._drive(f, BOTH, A, stiff)
        for k in range(round(2 / f / self.dt)):
            u = np.array(self.first) + drive * np.sin(2 * pi * f * k * self.dt)
            self._row()
            yield Decision((float(u[0]), float(u[1])), Phase.RUN)

    def _find_rest(self, rest: Array) -> None:
        if not np.isfinite(rest).all():
            raise Refused("the device measures no pressures, of which the muscles' torques are computed")
        self._rest = self._centre()
        self._gains = self._torque_gains(self._rest)
        left, right = self.plant.joint.angle_range
        most = 2 * max(self.tones.amplitude, *self.tones.series, 0.0)
        if self._rest - most < left or self._rest + most > right:
            raise Refused(
                f"about {self._rest / DEG:.3g}° a swing of ±{most / 2 / DEG:.3g}° comes too near to the end of the "
                f"joint's range, {left / DEG:.3g} … {right / DEG:.3g}°"
            )

    def _centre(self) -> float:
        """Return the middle [rad] of the angles during the last slow period."""
        last = self._angles[-round(1 / self.tones.low / self.dt) :]
        seen = [angle for angle in last if isfinite(angle)]
        if not seen:
            raise Refused("the device gave no readings of the angle")
        return (max(seen) + min(seen)) / 2

    def _stiffness(self, tone: Tone, expected: complex) -> complex:
        """Return K_felt + i h [N·m/rad] of a tone, with strengths of 1, as a ratio to the `expected` one."""
        loop = tone.loop(self.known.reading_age)
        found = complex(sum(loop.secants) + self.plant.inertia * loop.acceleration, sum(loop.losses))
        likely = (
            0.2 < abs(found) / abs(expected) < 10 and found.real > 0.2 * expected.real
        )  # not below an encoder's step
        return found if likely else expected

    def _expected(self, amplitude: float) -> complex:
        """Return the model's K_felt(A) [N·m/rad] before any measurement, with the gas of held commands."""
        P1, P2 = self.first
        loop = self.known.friction.loop
        K = self.plant.joint.stiffness(self._rest, P1, P2, amplitude=amplitude, loop=loop)
        return complex(float(K) + self.plant.gravity_torque * float(np.cos(self._rest)))

    def _planned(self) -> float:
        """Return the wanted amplitude, or one near it that the regulators can follow better."""
        margins = []
        for share in _PLANNED:
            self._amplitude = share * self.tones.amplitude
            stiffness = 1.1 * self._expected(self._amplitude)
            margins.append(self._margin(_ENOUGH_ABOVE * self._resonance(stiffness), max(MORE), stiffness))
            if margins[-1] >= 1:
                break
        self._amplitude = _PLANNED[int(np.argmax(margins))] * self.tones.amplitude
        return self._amplitude

    def _resonance(self, stiffness: complex) -> float:
        return sqrt(max(stiffness.real, 0.0) / self.plant.inertia) / 2 / pi

    def _upper(self, stiffness: complex) -> tuple[float, float]:
        """Return the two upper frequencies [Hz]: well above the resonance, as far as valves and samples permit."""
        resonance = self._resonance(stiffness)
        most = min(_HIGHEST, 1 / (_SAMPLES * self.dt))
        upper = min(max(_ABOVE[0] * resonance, 3 * self.tones.low), most / 1.2)
        while upper > _LEAST_ABOVE * resonance and not self._follows(upper, max(MORE), stiffness):
            upper *= 0.97
        if not self._follows(upper, max(MORE), stiffness):
            raise Refused(
                f"the regulators cannot move the joint by ±{self._amplitude / DEG:.2g}° above its resonance of "
                f"{resonance:.2g} Hz (flow, slack cables, or the sample time {self.dt:g} s); take a smaller amplitude"
            )
        further = min(_ABOVE[1] / _ABOVE[0] * upper, most)
        while further > 1.1 * upper and not self._follows(further, BOTH[0], stiffness):
            further *= 0.97
        return upper, further

    def _follows(self, frequency: float, share: float, stiffness: complex) -> bool:
        """Return whether the pressures of a tone respect flow, slew, supply and taut cables."""
        return self._margin(frequency, share, stiffness) >= 1

    def _margin(self, frequency: float, share: float, stiffness: complex) -> float:
        """Return the factor by which the pressures of a tone may grow."""
        omega = 2 * pi * frequency
        torque = self._amplitude * abs(stiffness - self.plant.inertia * omega**2) * share
        pressures = np.array([torque / abs(g) for g in self._gains])
        commands = pressures * np.abs(1 + 1j * omega * np.array(self.plant.lags))
        taken = pressures.max() * omega / (_FLOW_SHARE * self.known.flow), commands.max() * omega / self.plant.slew
        return float(1 / max(*taken, (commands / np.array(self._room)).max()))

    def _reached(
        self, f: float, lowest: float, shares: tuple[float, float], A: float, stiff: complex
    ) -> Generator[Decision, None, tuple[Tone, float]]:
        """Return a tone that swings by A, and its frequency [Hz], lower than `f` if the regulators are too slow."""
        tone = yield from self._brought(f, shares, A, stiff)
        while tone.swing < _SHORT * A and f > lowest:
            f = max(0.9 * f, lowest)
            tone = yield from self._brought(f, shares, A, stiff)
        return tone, f

    # --- one tone ---------------------------------------------------------------------------------------------------

    def _brought(
        self, f: float, shares: tuple[float, float], A: float, stiff: complex, close: float = _CLOSE
    ) -> Generator[Decision, None, Tone]:
        """Drive a tone until the angle swings by A, and return it."""
        net, dead = self._drive(f, shares, A, stiff)
        quick = f > _QUICK
        step, measured = (2, max(8, round(2 * f))) if quick else (1, 2 if f < self.tones.low else 3)
        self._asked, scale, phase = A, _BEGIN, 0.0
        tone, periods = None, step
        for k in range(self.tones.rounds):
            rows, phase, cut = yield from self._played(f, net * scale, dead, periods, phase, ramp=k == 0)
            seen = rows[-round(1 / f / self.dt) :, 1] if periods == step else rows[:, 1]
            swing = float(np.ptp(seen)) / 2
            if periods != step:
                tone = self._tone(rows, f)
                swing = tone.swing
            ratio = A / swing if swing > 0 else _STEP**2
            near = abs(ratio - 1) <= close and not cut
            if near and periods != step:
                break
            stuck = ratio > 1 / _SHORT and self._saturated(rows, f, net * scale)
            if stuck and periods != step:
                break
            scale *= 1 / _STEP if cut else min(max(ratio**_EXPONENT, 1 / _STEP), _STEP)
            periods = measured if near or stuck or k >= self.tones.rounds - 2 else step
        yield from self._hold(0.1)
        assert tone is not None
        return tone

    def _saturated(self, rows: Array, f: float, drive: Array) -> bool:
        """Return whether slew or flow are exhausted, so that a greater drive has no effect."""
        omega = 2 * pi * f
        fastest = float(np.nanmax(np.ptp(rows[-round(1 / f / self.dt) :, 2:], axis=0))) / 2 * omega
        return float(np.abs(drive).max()) * omega > _USED * self.plant.slew or fastest > self.known.flow

    def _drive(self, f: float, shares: tuple[float, float], A: float, stiff: complex) -> tuple[Array, Array]:
        """Return the amplitudes of both commands [Pa] for a swing A, and the additional ones for the dead band.

        Their signs let both torques turn the joint in the same direction.
        """
        omega, lags = 2 * pi * f, self.plant.lags
        torque = A * abs(stiff - self.plant.inertia * omega**2)
        net = [s * torque / g * abs(1 + 1j * omega * tau) for s, g, tau in zip(shares, self._gains, lags, strict=True)]
        dead = [np.sign(g) * self.known.dead_band / 2 * (s > 0) for s, g in zip(shares, self._gains, strict=True)]
        return np.array(net), np.array(dead)

    def _played(
        self, f: float, drive: Array, dead: Array, periods: int, phase: float, *, ramp: bool
    ) -> Generator[Decision, None, tuple[Array, float, bool]]:
        """Play whole periods; return the rows (t, θ, P1, P2), the phase at the end, and whether the drive was cut.

        Half of the dead band is added in the direction of a pressure's motion, so that the pressure moves as a sine.
        """
        drive = drive * min(1.0, *(np.array(self._room) / np.maximum(np.abs(drive + dead), 1e-9)))
        behind = [atan(2 * pi * f * tau) for tau in self.plant.lags]
        n, cut, rows, centre = round(periods / f / self.dt), False, [], self._centre()
        per = (2 if f > _QUICK else 1) / f / self.dt
        for k in range(n):
            phase += 2 * pi * f * self.dt
            share = min(1.0, (k + 1) / per) if ramp else 1.0
            share *= _CUT if cut else 1.0
            across = dead * np.tanh(_SUDDEN * np.cos(phase - np.array(behind)))
            u = np.array(self.first) + share * (drive * np.sin(phase) + across)
            rows.append(self._row())
            furthest = abs(rows[-1][1] - centre) / self._asked
            if isfinite(furthest):
                self.findings.furthest = max(self.findings.furthest, furthest)
                cut = cut or furthest > _ENOUGH
            yield Decision((float(u[0]), float(u[1])), Phase.RUN)
        return np.array(rows), phase, cut

    def _tone(self, rows: Array, f: float) -> Tone:
        """Return the tone of the rows."""
        rows = rows[np.isfinite(rows).all(axis=1)]
        if len(rows) < 8:
            raise Refused("the device gave too few readings of angle and pressures")
        agonist, antagonist = self.plant.joint.sides(self._rest)
        T = np.column_stack([agonist.torque(rows[:, 2]), antagonist.torque(rows[:, 3])])
        return tone_of(rows[:, 0], rows[:, 1], rows[:, 2:], T, f)

    # --- sample by sample -------------------------------------------------------------------------------------------

    def _torque_gains(self, theta: float) -> tuple[float, float]:
        one, two = self.plant.joint.sides(theta)
        return float(one.torque_gain(self.first[0])), float(two.torque_gain(self.first[1]))

    @property
    def _room(self) -> tuple[float, float]:
        """Amplitudes of commands [Pa] that keep cables taut and pressures within the supply."""
        found = []
        for P, side in zip(self.first, self.plant.joint.sides(self._rest), strict=True):
            low, high = self.plant.pressure_limits
            slack = float(side.muscle.pressure(0.0, side.contraction))
            found.append(max(min(P - max(slack, low), high - P) - _MARGIN, 0.05 * BAR))
        return found[0], found[1]

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

    def _row(self) -> tuple[float, float, float, float]:
        assert self._tick is not None
        reading = self._tick.reading
        self._angles.append(reading.theta)
        return reading.t, reading.theta, reading.P1, reading.P2
