"""Faults of a muscle's pressure, found by elimination of the explanations that its course contradicts.

Sound regulators turn the acting commands v into a pressure m,

    m' = dz(v - m)/τ' - q,   τ/s ≤ τ' ≤ s τ,   dz(e) = e minus the dead band, 0 within it,

or more slowly, where it changes as fast as the valves let it, 1/s to s times their flow. The greatest m rises as
quickly and falls as slowly as that allows, the least one the other way round; τ' may vary. s is SPREAD if the lags τ of
rising and of falling pressures were measured, else DATA_SHEET: theirs is that of some volume, and valves that were not
measured let pass the model's slew at least. q is the fall of a gas's pressure by the motion (`Plant.expansion`). The
residual r is the distance of the measured P from that range. Its part beyond MARGIN and the uncertainty due to SWELLING
or UNMEASURED is summed for each sign, and the sums are at least zero (Page's CUSUM, 1954). If a sum exceeds LIMIT,
something has been wrong since it last was zero. All explanations are possible then. Until the pressure has been normal
for `HOLD` seconds, an explanation is eliminated by

    stuck valve        P + ∫q moves: the valve has let gas pass
    leak               r > 0, or P + ∫q rises and the loss varies
    supply drop        r > 0, or the target varies, or the other muscle holds more than this one does
    drifting sensor    r moves quickly, or d̂ does not move by -(∂T/∂P) r
    all but that       d̂ does: the torque of P is missing
    broken cable       P lies outside the range of regulators without q since the onset, with a sum of its own; they
                       begin at the lowest P within SNAP seconds, since a free muscle contracts at once, and their
                       lags are within DATA_SHEET, since its volume is another one
    the first three    d̂ moves against the muscle's torque by more than half of it for MISSED seconds, while a broken
                       cable explains the pressure for REFILLED seconds

The target P + τ' (P' + q), over LATELY seconds, is the pressure to which the regulator fills. It is the command of a
sound muscle, the supply's pressure if that is low, and v - λ P of a leak that loses the share λ/τ of the gas a second.
A supply or a loss is contradicted if no constant lies within all bounds since the onset.

The regression coefficient of d̂ on -(∂T/∂P) r, with a memory of MEMORY seconds, decides these: 1 for a drift and 0 for
the others. Limits above the noise are in standard deviations σ of the sensor. If no explanation remained, as when a
fault ends, the last ones stay.

The functions work on the memory m, whose numbers have fixed places: a list in Python, a part of a flat array in code
compiled by numba (`mpc.observer.compiled`). Sets of explanations are sums of STUCK, LEAK, DROP, DRIFT and CABLE.
"""

from collections.abc import Sequence
from math import copysign, exp, inf, nan
from typing import NamedTuple, TypeAlias

from allocator.calculus import Array
from mpc.observer.health import FaultKind

SPREAD = 1.3  # of a measured lag that counts as sound [-]
DATA_SHEET = 2.2  # of any other
MARGIN = 4.5  # [σ]
SWELLING = 0.07  # relative error of a muscle's change of volume in its model [-]
UNMEASURED = 0.3  # the same of a data sheet, which does not know the volume of tubes and fittings
LIMIT = 15.0  # [σ], summed over samples
HOLD = 2.0  # [s] by which a suspicion outlives its cause
MEMORY = 3.0  # [s] of the regression
SNAP = 0.1  # [s] in which a muscle without its cable contracts
MISSED, REFILLED = 0.025, 0.15  # [s] for which its torque has to be missing, and its pressure to fill again

_MOVED, _QUICK, _HIGHER = 6.0, 10.0, 7.5  # [σ] of a pressure: since the onset, within LATELY, than another
_UNSURE = 2.0  # [σ] of a target of a regulator
_LATELY = 0.2  # [s]
_STEADY = 1.25  # [-] spread of the loss of one leak
_SMOOTH = 0.3  # weight of a new reading in smoothed values
_SEEN = 0.12  # [-] of the joint's usual torque: standard deviation of (∂T/∂P) r from which the regression counts
_NO_DRIFT, _DRIFT = 0.35, 0.65  # regression coefficients at most, and at least
_CLEARLY = 4.0  # [-] of the variance, from which it rules out a drift

STUCK, LEAK, DROP, DRIFT, CABLE = 1, 2, 4, 8, 16
_ANY = STUCK + LEAK + DROP + DRIFT + CABLE
_KINDS = {
    STUCK: FaultKind.STUCK_VALVE, LEAK: FaultKind.LEAK, DROP: FaultKind.SUPPLY_DROP, DRIFT: FaultKind.DRIFTING_SENSOR,
    CABLE: FaultKind.BROKEN_CABLE,
}  # fmt: skip

(
    P,  # smoothed [Pa]
    R,  # r, smoothed [Pa]
    COMMAND,  # v, smoothed [Pa]
    READ,  # the last reading [Pa]
    FALLEN,  # integral of q [Pa]
    FILLED,  # the reading without the motion's share, P + FALLEN, smoothed [Pa]
    LOW, HIGH,  # sums of r [Pa]
    TOP, BOTTOM,  # greatest and least pressure that a sound regulator leads to [Pa]
    TOP_STILL, BOTTOM_STILL,  # the same without q
    CARRIED,  # share of q in the pressure at the onset, as it fades [Pa]
    STILL,  # sum of the residuals outside the range of these [Pa]
    UNSURE,  # of m, because of the error SWELLING of q [Pa]
    MEAN_X, MEAN_Y, VARIANCE, COVARIANCE,  # of (∂T/∂P) r and d̂ [N·m]
    SUSPECTED,  # remaining explanations; 0: nothing is suspected
    SINCE,  # onset of the suspected fault [s]
    OPEN,  # whether the elimination is under way, possibly with all explanations POSSIBLE
    POSSIBLE,
    ONSET, BEGUN, LEAST,  # FILLED and the time [s] then, the least FILLED since [Pa]
    TURNED,  # FALLEN then [Pa]
    LEAST_SUPPLY, MOST_SUPPLY,  # bounds of the supply since then, if it is low [Pa]
    LEAST_LOSS, MOST_LOSS,  # and of the loss of a leak, in the pressure [-]
    ABOVE,  # time for which the other muscle has held more [s]
    MISSING,  # time for which the torque has been missing [s]
    ILL,  # last time of a sum beyond LIMIT [s]
    COUNT,  # of the samples put into PAST
    PAST,  # and following: (P, FILLED, r, v) of the samples within LATELY
) = range(36)  # fmt: skip

Numbers: TypeAlias = list[float] | Array
Values: TypeAlias = Sequence[float] | Array


class Sound(NamedTuple):
    """Constants of one muscle and its sensor."""

    quick: float  # share of a rising step that the quick regulator follows in a sample [-]
    slow: float
    quick_down: float  # of a falling one
    slow_down: float
    quick_free: float  # the same of a muscle that a broken cable leaves free
    slow_free: float
    most_quick: float  # greatest change in a sample [Pa]
    most_slow: float
    swelling: float  # relative error of a change of volume [-]
    rest: float  # half of the dead band [Pa]
    dt: float  # [s]
    sigma: float  # [Pa]
    seen: float  # [N²·m²]

    @classmethod
    def of(
        cls, up: float, down: float, flow: float, dt: float, dead_band: float, sigma: float, usual_torque: float,
        measured: bool = True, slew: float = inf,
    ) -> "Sound":  # fmt: skip
        """Return the constants for the lags `up` and `down` [s] of rising and falling pressures, the fastest change
        `flow` [Pa/s], `dead_band` and deviation `sigma` [Pa].

        Lags that were not `measured` are those of a data sheet, as is the least flow of the valves, `slew` [Pa/s].
        """
        spread, swelling, flows = SPREAD, SWELLING, (flow, flow)
        if not measured:
            spread, swelling, flows = DATA_SHEET, UNMEASURED, (min(flow, slew), flow)
        free = min(up, down) / DATA_SHEET, max(up, down) * DATA_SHEET
        lags = up / spread, up * spread, down / spread, down * spread, *free
        quick, slow, quick_down, slow_down, quick_free, slow_free = (1 - exp(-dt / lag) for lag in lags)
        return cls(
            quick, slow, quick_down, slow_down, quick_free, slow_free, spread * flows[1] * dt, flows[0] * dt / spread,
            swelling, dead_band / 2, dt, sigma, (_SEEN * usual_torque) ** 2,
        )  # fmt: skip


def places(dt: float) -> int:
    """Return the size of the memory at the sample time `dt` [s]."""
    return PAST + 4 * max(round(_LATELY / dt), 1)


class PressureDiagnosis:
    """Diagnosis of a muscle with the constants of `Sound.of`."""

    def __init__(self, sound: Sound) -> None:
        self.sound = sound
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self.numbers: list[float] = [0.0] * places(self.sound.dt)
        self.numbers[P] = nan

    @property
    def suspected(self) -> frozenset[FaultKind]:
        """Remaining explanations, if a fault is suspected."""
        left = int(self.numbers[SUSPECTED])
        return frozenset(kind for bit, kind in _KINDS.items() if left & bit)

    @property
    def since(self) -> float:
        """Onset of the suspected fault [s]."""
        return self.numbers[SINCE]

    @property
    def low(self) -> float:
        """Sum of residuals below [Pa]."""
        return self.numbers[LOW]


def follow(
    m: Numbers, other: Numbers, k: Sound, t: float, read: float, v: float, gain: float, d: float, q: float,
    missing: bool,
) -> None:  # fmt: skip
    """Update the memory by the reading `read` [Pa] at `t` [s], NaN if not believed, while the command `v` [Pa] acts.

    `gain` is ∂T/∂P [N·m/Pa], `d` the observer's disturbance torque [N·m], `q` the fall of the pressure by the motion
    [Pa/s], and `other` the memory of the other muscle. The muscle's torque is `missing` if `d` opposes it, see
    `mpc.observer.torque_diagnosis.missing`. Repeated readings have no effect.
    """
    if m[P] != m[P]:  # NaN: the first one
        m[P] = m[TOP] = m[BOTTOM] = m[TOP_STILL] = m[BOTTOM_STILL] = m[FILLED] = read
        m[COMMAND] = v
    m[FALLEN] += k.dt * q
    e = v - m[TOP], v - m[BOTTOM], v - m[TOP_STILL], v - m[BOTTOM_STILL]
    m[TOP] += filled(e[0], k.rest, k.quick, k.slow_down, k.most_quick, k.most_slow) - k.dt * q
    m[BOTTOM] += filled(e[1], k.rest, k.slow, k.quick_down, k.most_slow, k.most_quick) - k.dt * q
    slowest = min(k.slow, k.slow_down)
    m[UNSURE] += k.dt * k.swelling * abs(q) - slowest * m[UNSURE]
    m[TOP_STILL] += filled(e[2], k.rest, k.quick_free, k.slow_free, inf, k.most_slow)
    m[BOTTOM_STILL] += filled(e[3], k.rest, k.slow_free, k.quick_free, k.most_slow, inf)
    m[CARRIED] -= slowest * m[CARRIED] + (k.dt * q if m[OPEN] == 0 else 0.0)
    m[MISSING] = m[MISSING] + k.dt if missing else 0.0
    if read != read or read == m[READ]:
        return
    m[READ] = read
    if m[OPEN] > 0 and t - m[BEGUN] < SNAP:
        contract(m, read)
    r, still, carried = outside(read, m[BOTTOM], m[TOP]), outside(read, m[BOTTOM_STILL], m[TOP_STILL]), m[CARRIED]
    still -= min(max(still, min(carried, 0.0)), max(carried, 0.0))
    m[P] += _SMOOTH * (read - m[P])
    m[FILLED] += _SMOOTH * (read + m[FALLEN] - m[FILLED])
    m[R] += _SMOOTH * (r - m[R])
    m[COMMAND] += _SMOOTH * (v - m[COMMAND])
    regress(m, k.dt / MEMORY, gain * m[R], d)
    most, margin = 2 * LIMIT * k.sigma, MARGIN * k.sigma + m[UNSURE]
    m[LOW] = min(max(m[LOW] - r - margin, 0.0), most)
    m[HIGH] = min(max(m[HIGH] + r - margin, 0.0), most)
    m[STILL] = min(max(m[STILL] + abs(still) - margin, 0.0), most)
    check(m, other, k, t, read, v)
    size = (len(m) - PAST) // 4
    place = PAST + 4 * (int(m[COUNT]) % size)
    m[place], m[place + 1], m[place + 2], m[place + 3] = m[P], m[FILLED], m[R], m[COMMAND]
    m[COUNT] = (
        m[COUNT] + 1 if m[COUNT] + 1 < 2 * size else float(size)
    )  # only its place and whether PAST is full matter


def contract(m: Numbers, read: float) -> None:
    """Let the regulators of a free muscle begin at the reading if it is lower."""
    m[TOP_STILL], m[BOTTOM_STILL] = min(m[TOP_STILL], read), min(m[BOTTOM_STILL], read)


def filled(e: float, rest: float, up: float, down: float, most_up: float, most_down: float) -> float:
    """Return the change in a sample of a pressure `e` [Pa] below its command, whose dead band is ±`rest` [Pa].

    It follows the shares `up` and `down` of rising and falling steps, by `most_up` and -`most_down` [Pa] at most.
    """
    beyond = e - min(max(e, -rest), rest)
    return min(max((up if e > 0 else down) * beyond, -most_down), most_up)


def outside(P: float, least: float, most: float) -> float:
    """Return the distance of `P` from the range between `least` and `most`."""
    return P - min(max(P, least), most)


def regress(m: Numbers, weight: float, x: float, y: float) -> None:
    """Update means, variance and covariance by `x` and `y` [N·m]."""
    dx, dy = x - m[MEAN_X], y - m[MEAN_Y]
    m[MEAN_X] += weight * dx
    m[MEAN_Y] += weight * dy
    m[VARIANCE] = (1 - weight) * (m[VARIANCE] + weight * dx * dx)
    m[COVARIANCE] = (1 - weight) * (m[COVARIANCE] + weight * dx * dy)


def check(m: Numbers, other: Numbers, k: Sound, t: float, read: float, v: float) -> None:
    """Begin, continue or end the elimination of explanations."""
    wrong = m[LOW] > 0 or m[HIGH] > 0
    if wrong and m[OPEN] == 0:
        m[OPEN], m[POSSIBLE], m[ONSET], m[BEGUN] = 1.0, float(_ANY), m[FILLED], t
        m[LEAST], m[TURNED], m[ABOVE], m[STILL] = m[FILLED], m[FALLEN], 0.0, 0.0
        contract(m, read)
        m[LEAST_SUPPLY] = m[LEAST_LOSS] = -inf
        m[MOST_SUPPLY] = m[MOST_LOSS] = inf
    if m[OPEN] == 0:
        return
    if wrong:
        m[ILL] = t
    if t - m[ILL] > (HOLD if m[SUSPECTED] > 0 else 0.0):
        m[OPEN] = m[SUSPECTED] = 0.0
        return
    left = int(m[POSSIBLE]) & ~struck_out(m, other, k, t, v)
    if left != 0:
        m[POSSIBLE] = float(left)
    if m[SUSPECTED] > 0:
        m[SUSPECTED] = m[POSSIBLE]
    elif max(m[LOW], m[HIGH]) > LIMIT * k.sigma:
        m[SUSPECTED], m[SINCE] = m[POSSIBLE], m[BEGUN]


def bound(m: Numbers, k: Sound, first: int, size: int) -> None:
    """Bound a low supply, and the loss of a leak, by the target of the regulator since the sample at `first`.

    The target is the supply if the pressure is below that of its command, and v - loss * P by a leak.
    """
    P_mean, v, rise = (m[P] + m[first]) / 2, (m[COMMAND] + m[first + 3]) / 2, (m[FILLED] - m[first + 1]) / size
    quick, slow = (k.quick, k.slow) if rise > 0 else (k.quick_down, k.slow_down)
    one, other = P_mean + rise / quick, P_mean + rise / slow
    if abs(rise) > k.most_slow:  # as fast as it can: the target may be anywhere beyond
        other = copysign(inf, rise)
    unsure = k.rest + _UNSURE * k.sigma + m[UNSURE]
    least, most = min(one, other) - unsure, max(one, other) + unsure
    m[LEAST_SUPPLY] = max(m[LEAST_SUPPLY], least)
    if max(m[R], m[first + 2]) < -MARGIN * k.sigma:
        m[MOST_SUPPLY] = min(m[MOST_SUPPLY], most)
    if P_mean > LIMIT * k.sigma:
        m[LEAST_LOSS], m[MOST_LOSS] = max(m[LEAST_LOSS], (v - most) / P_mean), min(m[MOST_LOSS], (v - least) / P_mean)


def struck_out(m: Numbers, other: Numbers, k: Sound, t: float, v: float) -> int:
    """Return the contradicted explanations, by the rules in the module's docstring."""
    sigma, size, count = k.sigma, (len(m) - PAST) // 4, int(m[COUNT])
    first = PAST + 4 * (count % size if count >= size else 0)  # the oldest of the past
    r_lately = m[first + 2] if count > 0 else m[R]
    if count >= size and t - m[BEGUN] > _LATELY:
        bound(m, k, first, size)
    m[LEAST] = min(m[LEAST], m[FILLED])
    moved = _MOVED * sigma + k.swelling * abs(m[FALLEN] - m[TURNED])
    if m[LOW] > 0 and other[LOW] == 0 and other[P] > m[P] + _HIGHER * sigma:
        m[ABOVE] += k.dt
    too_high = m[HIGH] > LIMIT / 2 * sigma
    answers = -m[COVARIANCE] / m[VARIANCE] if m[VARIANCE] > k.seen else 0.5
    out = _ANY - DRIFT - CABLE if answers > _DRIFT else 0
    if abs(m[FILLED] - m[ONSET]) > moved:
        out |= STUCK
    if too_high or (m[FILLED] > m[LEAST] + moved and m[LEAST_LOSS] > _STEADY * m[MOST_LOSS]):
        out |= LEAK
    if too_high or m[LEAST_SUPPLY] > m[MOST_SUPPLY] or m[ABOVE] > _LATELY:
        out |= DROP
    if (answers < _NO_DRIFT and m[VARIANCE] > _CLEARLY * k.seen) or abs(m[R] - r_lately) > _QUICK * sigma:
        out |= DRIFT
    if m[STILL] > 0:
        out |= CABLE
    if m[MISSING] > MISSED and t - m[BEGUN] > REFILLED and int(m[POSSIBLE]) & ~out & CABLE:
        out |= STUCK + LEAK + DROP
    return out
