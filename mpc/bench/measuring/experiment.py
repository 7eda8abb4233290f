"""Experiment that measures a joint's stiffness: tones of both pressures about a rest, sample by sample.

    hold the rest, then swing more and more up to A, which brings the joint to the middle of its loop
    each muscle alone at a low frequency, until the angle swings by about A; from the first one on, A is its swing
    both muscles against each other: low at 1.4 A, and slower at A
    both muscles in three proportions at two frequencies above the resonance that the low tones have shown
    both muscles at a low frequency with a series of amplitudes: the curve K_felt(A)
    with a weight, both muscles at the low frequency and A, without it and with it

Each tone begins with the drive that the one before suggests, and is brought to its amplitude by a search
(`mpc.bench.measuring.driving`). A tone that stays apart from its amplitude ends the experiment: friction jumps. So does
one for which no time is left, except for the third high frequency and the series, which are then left out. The third
high frequency is left out as well if the regulators hardly reach the other two.
"""

from collections.abc import Generator, Iterator
from dataclasses import dataclass
from math import atan, inf, pi, sqrt

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.units import BAR, DEG
from mpc.bench.cycle import Decision, Phase, Tick
from mpc.bench.measuring.driving import CAUTIOUS, QUICK, Driver, Late, Refused, Search, Wave, resting, room
from mpc.bench.measuring.loops import Tone
from mpc.bench.measuring.strengths import APART, USABLE
from mpc.bench.measuring.weighing import Weight
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant

_FADE = 0.25  # periods within a search of a slow tone
_SHAKES = 10  # periods, at most, in which the joint comes to the middle of its loop …
_FIRST, _SHAKEN = 0.4, 0.75  # … from this share of the expected drive to this share of the amplitude
_LOST = 0.25  # [-] off the amplitude: the tone cannot be controlled
_BETWEEN = 0.3, 3.0  # of a drive over the expected one
_CLOSE, _MEASURED = 0.08, 0.09  # [-] of the amplitude: close enough to measure, and as measured
_MORE_ROUNDS = 4  # for a tone that is not usable after all rounds
_BEGIN = 0.8  # [-] of the amplitude, to which the first drive is expected to swing
_OTHER = 0.85  # of the drive, for a muscle that may be the stronger one, and for a slow tone
_ABOVE = 1.6, 2.0  # of the resonance: the upper tones
_CALM = 0.44  # of |K_felt + i h|: least |K_felt + i h - J ω²| of an upper tone, 1.2 times the resonance without losses
_USED = 1.2  # of the slew: beyond it sines become triangles
_SHORT = 0.93  # [-] of the amplitude: less counts as not reached
_PLANNED = 1.0, 1.4, 0.75, 0.5  # [-] of the wanted amplitude, in the order of the trials
_LEAST_COMMAND = 0.05 * BAR  # between the commands of the rest and the supply's ends
_SAMPLES = 16  # per period, at least
_HIGHEST = 8.0  # [Hz]
_LEAST_RESONANCE = 0.3  # of the low tone
_HELD = 0.95  # of a drive: less is sent where cables would be slack, or beyond the supply
_NO_ROOM = "slack cables or the supply leave no room for more; choose a stiffer rest, or a smaller amplitude"
_FLOW_SHARE = 0.8  # of the regulators' flow that a tone takes
ONE, TWO, BOTH = (1.0, 0.0), (0.0, 1.0), (0.5, 0.5)  # shares of the torque
MORE, LESS = (0.6, 0.4), (0.4, 0.6)  # at the upper frequency, at which a muscle alone may be too slow


@dataclass(frozen=True)
class Tones:
    """Amplitudes, frequencies and durations of the experiment."""

    amplitude: float = 3 * DEG  # A [rad] of the tones that are compared
    low: float = 1.2  # [Hz]
    series: tuple[float, ...] = (8 * DEG,)  # of K_felt(A) [rad]; empty: not measured
    slowest: float = 0.5  # to detect a dependence on the rate [Hz]
    slow: float = 1.0  # of the series [Hz]
    settle: float = 1.0  # at rest [s]
    rounds: int = 8  # of the search for an amplitude, at most
    longest: float = 60.0  # of the experiment without a weight [s]

    def __post_init__(self) -> None:
        for unit, names in {
            "rad": ("amplitude",),
            "Hz": ("low", "slow", "slowest"),
            "s": ("settle", "longest"),
        }.items():
            for name in names:
                checks.positive(name, getattr(self, name), unit)
        checks.count("rounds", self.rounds, least=1)
        object.__setattr__(self, "series", tuple(np.ravel(checks.real("series", self.series, "rad")).tolist()))
        if any(not 0 < a < 1 for a in (self.amplitude, *self.series)):
            raise InvalidInput(f"amplitudes = {self.amplitude}, {self.series} rad have to lie between 0 and 1 rad")


class Experiment(Driver):
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
        super().__init__(plant, dt, resting(plant, theta, K), theta, tones.amplitude)
        self.known, self.tones, self.weight = known, tones, weight
        self._highest = min(_HIGHEST, 1 / (_SAMPLES * checks.positive("dt", dt, "s")))
        if max(tones.low, tones.slow, tones.slowest) > self._highest:
            raise InvalidInput(
                f"dt = {dt:g} s and tones of {tones.low:g}, {tones.slow:g} and {tones.slowest:g} Hz: expected at least "
                f"{_SAMPLES} samples per period, and at most {_HIGHEST:g} Hz"
            )
        self._amplitude = tones.amplitude
        self._gains = self._torque_gains(theta)
        P1, P2 = self.first
        self._backbone = float(plant.joint.stiffness(theta, P1, P2)) + float(plant.gravity.stiffness(theta))
        self._scales = {False: 1.0, True: 0.8}  # drive over the expected one: of slow and of quick tones
        self._exponents = {False: CAUTIOUS, True: CAUTIOUS}  # of the drive by the swing, in the last search
        self._until = tones.longest  # [s], the end
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
        yield from self._ended()

    def _sequence(self) -> Iterator[Decision]:
        tones, found = self.tones, self.findings.tones
        A = self._amplitude = self._planned()
        self._met = self._expected(A), A
        if (resonance := self._resonance(self._met[0])) < _LEAST_RESONANCE * tones.low:
            raise Refused(
                f"with the inertia of {self.plant.inertia:g} kg·m² the joint resonates at {resonance:.2g} Hz, far "
                f"below the slow tone of {tones.low:g} Hz: check the unit of the inertia"
            )
        self._check_supply()
        rest = yield from self._seen(self._hold(tones.settle))
        if not np.isfinite(rest).all(axis=1).any():
            raise Refused("the device measures no pressures, of which the muscles' torques are computed")
        self._rest = self._centre()  # of the joint, which friction may hold elsewhere than the model
        self._gains = self._torque_gains(self._rest)
        yield from self._shaken(A)
        self._rest = self._centre()  # which friction has let go
        self._gains = self._torque_gains(self._rest)
        self._check_range()
        found.append((yield from self._brought(tones.low, ONE, A, close=0.15)))
        A = self._amplitude = found[0].swing
        self._scales[False] *= _OTHER
        found.append((yield from self._brought(tones.low, TWO, A)))
        found.append((yield from self._brought(tones.low, BOTH, 1.4 * A, close=0.15)))
        self._scales[False] *= _OTHER
        found.append((yield from self._brought(tones.slowest, BOTH, A)))
        upper, further = self._upper(self._stiff(A))
        lowest = self._lowest(self._stiff(A))
        more, reached = yield from self._reached(upper, lowest, MORE, A)
        less, reached = yield from self._reached(reached, lowest, LESS, A)
        found += [more, less]
        yield from self._optional(A, further if reached == upper and min(more.swing, less.swing) > _SHORT * A else 0.0)
        if self.weight is not None:
            self._until = inf
            yield from self._weighed(self.weight, A)

    def _optional(self, A: float, further: float) -> Iterator[Decision]:
        """Play the tones that lack of time may leave out: one at a `further` frequency (0: none), and the series."""
        tones, curve = self.tones, self.findings.curve
        try:
            if further:
                tone = yield from self._brought(further, BOTH, A)
                self.findings.tones += [tone] if tone.swing > _SHORT * A else []
            for amplitude in tones.series:
                curve.append((yield from self._brought(tones.slow, BOTH, amplitude, close=0.15)))
        except Late:
            self.findings.left_out = tones.series[len(curve) :]

    def _weighed(self, weight: Weight, A: float) -> Iterator[Decision]:
        """Swing slowly without the weight, request it with the pressures held, and swing with it."""
        A = max(A, *self.tones.series)  # the widest, which erases most of the friction's memory
        before = yield from self._brought(self.tones.slow, BOTH, A, close=0.15)
        yield from self._ended()
        while not weight.hang(weight.torque):
            yield Decision(self.first, Phase.RUN)
        most = room(self.plant, self._rest, self.first)
        raised = [p + float(np.clip(weight.torque / 2 / g, -r / 2, r / 2))
                  for p, g, r in zip(self.first, self._gains, most, strict=True)]  # fmt: skip
        self.first = raised[0], raised[1]  # which about carries it: friction is unchanged
        yield from self._hold(2 * self.tones.settle)
        self.findings.balance = before, (yield from self._brought(self.tones.slow, BOTH, A, close=0.15))

    def _shaken(self, A: float) -> Iterator[Decision]:
        """Swing the joint more and more, up to A, which brings it to the middle of its hysteresis."""
        wave, search = self._drive(self.tones.low, BOTH, A), Search(A, _FIRST)
        self._asked = A
        for _ in range(_SHAKES):
            rows, cut = yield from self._played(wave.times(search.scale), 1, fade=1, sliding=True)
            share = float(np.ptp(rows[:, 1])) / 2 / A
            if share > _SHAKEN and not cut:
                break
            search.learn(share * A, cut)
        rows, _ = yield from self._played(self._wave, 1, fade=1, sliding=True)
        if not cut:
            self._learn(self._tone(rows, wave.frequency))
            self._correct(BOTH)

    def _correct(self, shares: tuple[float, float]) -> None:
        """Remember the drive of a tone relative to the expected one, for the next tone."""
        wave, A = self._wave, self._met[1] if self._wave.frequency <= QUICK else self._asked
        expected = np.abs(self._drive(wave.frequency, shares, A).drive).max()
        self._scales[wave.frequency > QUICK] = float(np.clip(np.abs(wave.drive).max() / expected, *_BETWEEN))

    def _check_supply(self) -> None:
        low, high = self.plant.pressure_limits
        for k, P in enumerate(self.first):
            if min(P - low, high - P) < max(self.known.dead_band, _LEAST_COMMAND):
                other = "softer" if high - P < P - low else "stiffer"
                raise Refused(
                    f"at this rest muscle {k + 1} has {P / BAR:.3g} bar, which the supply of {low / BAR:.3g} … "
                    f"{high / BAR:.3g} bar leaves no room to vary; choose a {other} rest"
                )

    def _check_range(self) -> None:
        left, right = self.plant.joint.angle_range
        most = 2 * max(self.tones.amplitude, *self.tones.series, 0.0)
        if self._rest - most < left or self._rest + most > right:
            raise Refused(
                f"about {self._rest / DEG:.3g}° a swing of ±{most / 2 / DEG:.3g}° comes too near to the end of the "
                f"joint's range, {left / DEG:.3g} … {right / DEG:.3g}°"
            )

    def _learn(self, tone: Tone) -> None:
        """Take K_felt + i h [N·m/rad] of a tone, with strengths of 1, if it is likely."""
        loop = tone.loop(self.known.reading_age)
        found = complex(sum(loop.secants) + self.plant.inertia * loop.acceleration, sum(loop.losses))
        expected = self._stiff(tone.swing)
        if 0.2 < abs(found) / abs(expected) < 10 and found.real > 0.2 * expected.real:  # not below an encoder's step
            self._met = found, tone.swing

    def _stiff(self, A: float) -> complex:
        """Return the expected K_felt + i h [N·m/rad] at A: friction softens less than by 1/A."""
        stiff, met = self._met
        K = min(self._backbone, stiff.real)
        return K + (stiff - K) * sqrt(min(met / A, 1.0))

    def _expected(self, amplitude: float) -> complex:
        """Return the model's K_felt(A) [N·m/rad] before any measurement, with the gas of held commands."""
        P1, P2 = self.first
        loop = self.known.friction.loop
        K = self.plant.joint.stiffness(self._rest, P1, P2, amplitude=amplitude, loop=loop)
        return complex(float(K) + float(self.plant.gravity.stiffness(self._rest)))

    def _planned(self) -> float:
        """Return the wanted amplitude, or one near it that the regulators can follow better."""
        margins = []
        for share in _PLANNED:
            self._amplitude = share * self.tones.amplitude
            stiffness = 1.1 * self._expected(self._amplitude)
            margins.append(self._margin(self._lowest(stiffness), max(MORE), stiffness))
            if margins[-1] >= 1:
                break
        self._amplitude = _PLANNED[int(np.argmax(margins))] * self.tones.amplitude
        return self._amplitude

    def _resonance(self, stiffness: complex) -> float:
        return sqrt(max(stiffness.real, 0.0) / self.plant.inertia) / 2 / pi

    def _lowest(self, stiffness: complex) -> float:
        """Return the least frequency [Hz], from the resonance on, at which the swing is not sensitive to the drive."""
        calm = (_CALM * abs(stiffness)) ** 2 - stiffness.imag**2
        return self._resonance(stiffness + sqrt(max(calm, 0.0)))

    def _upper(self, stiffness: complex) -> tuple[float, float]:
        """Return the two upper frequencies [Hz]: above the resonance, as far as valves and samples permit."""
        resonance, lowest = self._resonance(stiffness), self._lowest(stiffness)
        upper = min(max(_ABOVE[0] * resonance, 3 * self.tones.low), self._highest / 1.2)
        while upper > lowest and not self._follows(upper, max(MORE), stiffness):
            upper = max(0.97 * upper, lowest)
        if upper < lowest or not self._follows(upper, max(MORE), stiffness):
            raise Refused(
                f"the regulators cannot move the joint by ±{self._amplitude / DEG:.2g}° above its resonance of "
                f"{resonance:.2g} Hz (flow, slack cables, or the sample time {self.dt:g} s); take a smaller amplitude"
            )
        further = min(_ABOVE[1] / _ABOVE[0] * upper, self._highest)
        while further > 1.1 * upper and not self._follows(further, BOTH[0], stiffness):
            further *= 0.97
        return upper, max(further, 1.08 * upper)

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
        return float(1 / max(*taken, (commands / np.array(room(self.plant, self._rest, self.first))).max()))

    def _reached(
        self, f: float, lowest: float, shares: tuple[float, float], A: float
    ) -> Generator[Decision, None, tuple[Tone, float]]:
        """Return a tone that swings by A, and its frequency [Hz], lower than `f` if the regulators are too slow."""
        tone = yield from self._brought(f, shares, A)
        while tone.swing < (1 - _MEASURED) * A and f > lowest:
            f = max(0.9 * f, lowest)
            tone = yield from self._brought(f, shares, A)
        return tone, f

    # --- one tone ---------------------------------------------------------------------------------------------------

    def _brought(
        self, f: float, shares: tuple[float, float], A: float, close: float = _CLOSE
    ) -> Generator[Decision, None, Tone]:
        """Drive a tone until the angle swings by A, and return it. Raises `Refused` if it stays apart from A."""
        expected, quick = self._drive(f, shares, A), f > QUICK
        step, measured = (2, max(8, round(2 * f))) if quick else (1, 2 if f < self.tones.low else 3)
        self._asked, tone = A, None
        search = Search(A, self._scales[quick] * _BEGIN ** self._exponents[quick], self._exponents[quick])
        periods, fade = step, 3.0 if quick else 1.0 if f >= self.tones.low else 0.5
        for k in range(self.tones.rounds + _MORE_ROUNDS):
            played = periods + (k == 0) * fade
            needed = played + (periods == step) * measured + 1  # periods, with the fading out
            if self.findings.duration + needed / f > self._until:
                raise Late(f"{self._until:.0f} s were too short to bring the amplitudes together: {APART}")
            rows, cut = yield from self._played(expected.times(search.scale), played, fade)
            fade = 1.0 if quick else _FADE
            searching = periods == step
            tone = None if searching else self._tone(rows, f)
            swing = float(np.ptp(rows[-round(step / f / self.dt) :, 1])) / 2 if tone is None else tone.swing
            near = abs(A / max(swing, 1e-9) - 1) <= (close if searching else max(close, _MEASURED)) and not cut
            exhausted = A > swing / _SHORT and self._saturated(rows, self._wave)
            usable = near or exhausted or (k >= self.tones.rounds - 1 and abs(swing / A - 1) < USABLE and not cut)
            if usable and not searching:
                break
            search.learn(swing, cut)
            periods = measured if near or exhausted or k >= self.tones.rounds - 2 else step
        if tone is not None:
            self._check_followed(tone)
        if tone is None or cut or (abs(swing / A - 1) > _LOST and not exhausted):
            raise self._apart(swing, expected.times(search.scale))
        self._exponents[quick] = search.exponent
        if not quick:
            self._learn(tone)
        self._correct(shares)
        return tone

    def _apart(self, swing: float, wanted: Wave) -> Refused:
        """Return the refusal of a tone that swings by `swing` [rad], whose drive was to become the `wanted` one."""
        A, f = self._asked, wanted.frequency
        held = swing < A and np.abs(self._within(wanted).drive).max() < _HELD * np.abs(wanted.drive).max()
        return Refused(
            f"the amplitudes did not come together (±{swing / DEG:.3g}° instead of ±{A / DEG:.3g}° at {f:.2g} Hz): "
            f"{_NO_ROOM if held else APART}"
        )

    def _saturated(self, rows: Array, wave: Wave) -> bool:
        """Return whether slew or flow are exhausted, so that a greater drive has no effect."""
        omega = 2 * pi * wave.frequency
        fastest = float(np.nanmax(np.ptp(rows[-round(1 / wave.frequency / self.dt) :, 2:], axis=0))) / 2 * omega
        return float(np.abs(wave.drive).max()) * omega > _USED * self.plant.slew or fastest > self.known.flow

    def _drive(self, f: float, shares: tuple[float, float], A: float) -> Wave:
        """Return the commands for a swing A: amplitudes, and the additional ones for the dead band.

        Their signs let both torques turn the joint in the same direction.
        """
        omega, lags = 2 * pi * f, self.plant.lags
        torque = A * abs(self._stiff(A) - self.plant.inertia * omega**2)
        net = [s * torque / g * abs(1 + 1j * omega * tau) for s, g, tau in zip(shares, self._gains, lags, strict=True)]
        dead = [np.sign(g) * self.known.dead_band / 2 * (s > 0) for s, g in zip(shares, self._gains, strict=True)]
        behind = [atan(omega * tau) for tau in lags]
        return Wave(f, np.array(net), np.array(dead), np.array(behind))
