"""What may be wrong with a muscle's pressure is found here: its course strikes out explanations, until the right ones
are left.

A sound regulator makes of the commands v that act a pressure between those of a quick and of a slow one,

    m' = dz(v - m)/τ' - q,   τ' = τ/SPREAD and SPREAD τ,   dz(e) = e less the dead band, 0 within it,

q being what the motion takes from the pressure of a gas (`Plant.expansion`), and the residual r is how far the measured
P lies outside. Sums of it beyond MARGIN, one a sign, that end at zero (Page's CUSUM, 1954), say that something is wrong
when one passes LIMIT, and since when: since it last was zero. All explanations are possible then. One is struck out,
until the pressure has been well for `HOLD` seconds, by

    stuck valve        P moves
    leak               P rises, or r > 0
    supply drop        P still falls after SETTLED, or r > 0, or the other muscle holds more than this one does
    drifting sensor    r moves quickly, or d̂ does not move by -(∂T/∂P) r
    all but that       d̂ does: the torque that P would make is not there

The last two are told by the regression coefficient of d̂ on -(∂T/∂P) r with a memory of MEMORY seconds, 1 for a drift
and 0 for the others. What is more than noise is counted in standard deviations σ of the sensor. If nothing were left,
as when a fault ends, the last explanations stay.
"""

from collections import deque
from math import exp

from mpc.observer.health import FaultKind

SPREAD = 1.3  # of the lag that counts as sound [-]
MARGIN = 4.5  # [σ]
LIMIT = 15.0  # [σ], summed over samples
HOLD = 2.0  # [s] for which a suspicion outlives what gave rise to it
SETTLED = 0.6  # [s] after which a muscle has fallen to what the supply gives
MEMORY = 3.0  # [s] of the regression

_MOVED, _QUICK, _FALLS, _HIGHER = 6.0, 10.0, 4.0, 7.5  # [σ] of a pressure: since the onset, within LATELY, than another
_LATELY = 0.2  # [s]
_SMOOTH = 0.3  # weight of a new reading in what is compared
_SEEN = 0.12  # of the joint's usual torque: standard deviation of (∂T/∂P) r from which the regression counts
_NO_DRIFT, _DRIFT = 0.35, 0.65  # regression coefficients at most, and at least

_ANY = frozenset({FaultKind.STUCK_VALVE, FaultKind.LEAK, FaultKind.SUPPLY_DROP, FaultKind.DRIFTING_SENSOR})
_DRIFTING = frozenset({FaultKind.DRIFTING_SENSOR})


class PressureDiagnosis:
    """The diagnosis is of one muscle with the time constant `lag` [s], the `dead_band` and the sensor's deviation
    `sigma` [Pa].
    """

    def __init__(self, lag: float, dt: float, dead_band: float, sigma: float, usual_torque: float) -> None:
        self._gains = 1 - exp(-dt * SPREAD / lag), 1 - exp(-dt / (SPREAD * lag))
        self._rest, self.dt, self.sigma = dead_band / 2, dt, sigma
        self._seen = (_SEEN * usual_torque) ** 2
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.P = float("nan")  # smoothed [Pa]
        self.low = self.high = 0.0  # sums of r [Pa]
        self.since = 0.0  # [s] onset of what is suspected
        self.suspected: frozenset[FaultKind] = frozenset()
        self._models = [0.0, 0.0]  # m of the quick and of the slow regulator [Pa]
        self._last = self._r = 0.0  # the last reading, and r smoothed
        self._means, self._variance, self._covariance = [0.0, 0.0], 0.0, 0.0
        self._past: deque[tuple[float, float]] = deque(maxlen=max(round(_LATELY / self.dt), 1))  # (P, r)
        self._open = False  # whether explanations are being struck out
        self._ill = 0.0  # [s] when it last was

    def follow(
        self, t: float, P: float, v: float, gain: float, d: float, other: "PressureDiagnosis", q: float = 0.0
    ) -> None:
        """Follow the sensor, which says `P` [Pa] at `t` [s], NaN if not believed, while the command `v` [Pa] acts.

        `gain` is ∂T/∂P [N·m/Pa], `d` the observer's disturbance torque [N·m], `q` the pressure's fall by the motion
        [Pa/s]. A repeated reading says nothing.
        """
        if self.P != self.P:  # NaN: the first one
            self.P, self._models = P, [P, P]
        quick, slow = self._models = [
            m + g * self._dead(v - m) - self.dt * q for m, g in zip(self._models, self._gains, strict=True)
        ]
        if P != P or P == self._last:
            return
        self._last = P
        r = P - min(max(P, min(quick, slow)), max(quick, slow))
        self.P += _SMOOTH * (P - self.P)
        self._r += _SMOOTH * (r - self._r)
        self._regress(gain * self._r, d)
        most, margin = 2 * LIMIT * self.sigma, MARGIN * self.sigma
        self.low = min(max(self.low - r - margin, 0.0), most)
        self.high = min(max(self.high + r - margin, 0.0), most)
        self._check(t, v, other)
        self._past.append((self.P, self._r))

    def _dead(self, e: float) -> float:
        return e - min(max(e, -self._rest), self._rest)

    def _regress(self, x: float, y: float) -> None:
        weight = self.dt / MEMORY
        dx, dy = x - self._means[0], y - self._means[1]
        self._means = [self._means[0] + weight * dx, self._means[1] + weight * dy]
        self._variance = (1 - weight) * (self._variance + weight * dx * dx)
        self._covariance = (1 - weight) * (self._covariance + weight * dx * dy)

    def _check(self, t: float, v: float, other: "PressureDiagnosis") -> None:
        wrong = self.low > 0 or self.high > 0
        if wrong and not self._open:
            self._open, self._possible, self._onset, self._begun = True, _ANY, self.P, t
            self._least, self._above = self.P, 0.0
        if not self._open:
            return
        self._ill = t if wrong else self._ill
        if t - self._ill > (HOLD if self.suspected else 0.0):
            self._open, self.suspected = False, frozenset()
            return
        self._possible = self._possible - self._struck_out(t, v, other) or self._possible
        if self.suspected:
            self.suspected = self._possible
        elif max(self.low, self.high) > LIMIT * self.sigma:
            self.suspected, self.since = self._possible, self._begun

    def _struck_out(self, t: float, v: float, other: "PressureDiagnosis") -> set[FaultKind]:
        sigma, (P_lately, r_lately) = self.sigma, self._past[0] if self._past else (self.P, self._r)
        self._least = min(self._least, self.P)
        falls_on = self.low > 0 and v > self.P and self.P < P_lately - _FALLS * sigma and t - self._begun > SETTLED
        self._above += self.dt * (self.low > 0 == other.low and other.P > self.P + _HIGHER * sigma)
        too_high = self.high > LIMIT / 2 * sigma
        answers = -self._covariance / self._variance if self._variance > self._seen else 0.5
        out = set(_ANY - _DRIFTING) if answers > _DRIFT else set()
        if abs(self.P - self._onset) > _MOVED * sigma:
            out.add(FaultKind.STUCK_VALVE)
        if too_high or self.P > self._least + _MOVED * sigma:
            out.add(FaultKind.LEAK)
        if too_high or falls_on or self._above > _LATELY:
            out.add(FaultKind.SUPPLY_DROP)
        if answers < _NO_DRIFT or abs(self._r - r_lately) > _QUICK * sigma:
            out.add(FaultKind.DRIFTING_SENSOR)
        return out


__all__ = ["HOLD", "LIMIT", "MARGIN", "MEMORY", "SETTLED", "SPREAD", "PressureDiagnosis"]
