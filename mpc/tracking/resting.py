"""Rest mode as functions of numbers, one text for Python (`mpc.tracking.rest`) and compiled steps.

The numbers m that are remembered lie in one list or flat array, each in its place.
"""

from math import ceil, inf, pi, sqrt
from typing import NamedTuple, TypeAlias

from allocator.calculus import Array
from allocator.units import BAR, DEG

SAME = 1e-3 * DEG, 1e-3  # [rad], [N·m/rad]: a preview that varies less is constant
DWELL = 1.5  # [s] of constant preview before a rest, and after a push
START, GROWTH, MEAN = 0.05 * DEG, 0.2 * DEG, 0.3 * DEG  # [rad], [rad/s], [rad] |mean e| to rest at, MEAN if it rings
SWING = 2.0 * DEG  # [rad] peak to peak, the most to rest at
FAR = 1.0 * DEG  # [rad] of e, from where on the time counts anew
RINGING = 0.5 * DEG  # [rad] to both sides within a period, again and again
DEAD_ZONE = 0.045 * DEG  # [rad]
STILL = 0.06 * DEG  # [rad] peak to peak over half a period
FIRST, STIFFEST = 1.6, 3.0  # [-] of K: the gain before there is a secant, the greatest
RESOLUTION = 0.015 * DEG  # [rad] to which the effect of a correction is known
OVERSHOOT = 0.15 * DEG  # [rad]
MOST = 0.1 * BAR  # [Pa] of a correction
JOLT, PUSH = 0.045 * DEG, 0.12 * DEG  # [rad]
EDGE = 0.5 * DEG  # [rad] by which the regulators' way to their edges may turn the joint
LEAK = 0.1 * BAR  # [Pa] beyond the dead band
NOISE = 0.005 * BAR  # [Pa] of a pressure's mean
QUARTER = 0.1, 0.5  # [s] least and most of a quarter of a period

QUARTERS, HALF = 4, 2
SWINGS = QUARTERS + HALF  # a load that throws the joint off is in QUARTERS of them
E, P1, LOW, HIGH, COLUMNS = 0, 1, 3, 4, 5  # of a quarter: means of e, P1, P2, least and greatest e

(
    THETA, K,  # the reference while it stands still [rad], [N·m/rad]
    QUARTER_LENGTH,  # of the joint's free period [samples]
    RINGS, RESTS,  # whether it rings, whether it rests
    HELD, _,  # pressures that are held [Pa]
    BEGAN, _,  # pressures when the rest began, or as they were corrected [Pa]
    SIDE,  # edge of the dead band
    SINCE,  # quarters since the last correction
    TORQUE, ERROR,  # of that [N·m], and the mean error that it was for [rad]
    FREE,  # how far it would turn a joint without friction [rad]
    SAMPLES,  # of constant preview
    COUNTED, SWUNG,  # quarters, and over how many of them e has swung to both sides
    IN_SUM,  # samples in the quarter that runs
    SUM, _, _,  # of e, P1, P2 there
    LEAST, GREATEST,  # e there [rad]
    PAST,  # and following: the last quarters
) = range(24)  # fmt: skip
SIZE = PAST + QUARTERS * COLUMNS

Numbers: TypeAlias = list[float] | Array


class Rules(NamedTuple):
    """Known numbers of a joint and its regulators."""

    inertia: float  # [kg·m²]
    dt: float  # [s]
    settling: float  # [samples] until a correction has acted
    dwell: float  # [samples]
    shortest: float  # quarter [samples]
    longest: float
    dead_band: float  # [Pa]
    highest: float  # pressure [Pa]


def begin(m: Numbers) -> None:
    """Begin to wait for a rest."""
    m[RESTS] = m[SAMPLES] = m[COUNTED] = m[SWUNG] = 0.0
    for i in range(QUARTERS * COLUMNS):
        m[PAST + i] = 0.0
    begin_quarter(m)


def begin_quarter(m: Numbers) -> None:
    """Begin a quarter of a period."""
    m[IN_SUM] = m[SUM] = m[SUM + 1] = m[SUM + 2] = 0.0
    m[LEAST], m[GREATEST] = inf, -inf


def follow(m: Numbers, k: Rules, theta: float, stiffness: float) -> None:
    """Follow a reference that has moved to `theta` [rad] and `stiffness` [N·m/rad]."""
    m[THETA], m[K], m[RINGS] = theta, stiffness, 0.0
    quarter = pi / 2 * sqrt(k.inertia / stiffness) / k.dt
    m[QUARTER_LENGTH] = float(int(min(max(quarter, k.shortest), k.longest) + 0.5))


def constant(m: Numbers, k: Rules, theta: Array, stiffness: Array) -> bool:
    """Return whether the previews stand still where they stood; follow them if not."""
    for i in range(len(theta)):
        if not (abs(theta[i] - m[THETA]) <= SAME[0] and abs(stiffness[i] - m[K]) <= SAME[1]):
            follow(m, k, theta[0], stiffness[0])
            return False
    return True


def decided(m: Numbers, k: Rules, seen: Array, expected: float) -> bool:
    """Look at the state `seen` (4,) at a constant reference, where the angle `expected` [rad] was predicted; return
    whether a correction is due, of the mean error `due` says.
    """
    if pushed(m, seen[0], expected):
        begin(m)
        return False
    m[SAMPLES] += 1
    if not quarter_ended(m, seen):
        return False
    if m[RESTS] > 0:
        return to_correct(m, k)
    if m[COUNTED] == QUARTERS:
        check(m, k)
    return False


def pushed(m: Numbers, theta: float, expected: float) -> bool:
    """Return whether a rest is disturbed at the angle `theta` [rad] where `expected` [rad] was predicted."""
    if m[RESTS] == 0:
        return False
    mean, width = swing(m, QUARTERS)
    away = abs(theta - m[THETA] - mean)
    jolt = JOLT * (2 if m[RINGS] > 0 else 1)  # the prediction includes friction that a ringing joint lacks
    return abs(theta - expected) > jolt or away > PUSH + width + m[FREE]


def quarter_ended(m: Numbers, seen: Array) -> bool:
    """Return whether a quarter of a period ends with the sample that has `seen` (4,)."""
    e, last = seen[0] - m[THETA], PAST + (QUARTERS - 1) * COLUMNS
    m[SUM], m[SUM + 1], m[SUM + 2], m[IN_SUM] = m[SUM] + e, m[SUM + 1] + seen[2], m[SUM + 2] + seen[3], m[IN_SUM] + 1
    m[LEAST], m[GREATEST] = min(m[LEAST], e), max(m[GREATEST], e)
    if m[IN_SUM] < m[QUARTER_LENGTH]:
        return False
    for i in range(PAST, last):
        m[i] = m[i + COLUMNS]
    for i in range(3):
        m[last + i] = m[SUM + i] / m[IN_SUM]
    m[last + LOW], m[last + HIGH] = m[LEAST], m[GREATEST]
    m[COUNTED] = min(m[COUNTED] + 1, QUARTERS)
    begin_quarter(m)
    return True


def mean_of(m: Numbers, column: int, quarters: int) -> float:
    """Return the mean of a column over the last `quarters`."""
    total = 0.0
    for i in range(QUARTERS - quarters, QUARTERS):
        total += m[PAST + COLUMNS * i + column]
    return total / quarters


def swing(m: Numbers, quarters: int) -> tuple[float, float]:
    """Return the mean of e, and how far it goes from peak to peak, over the last `quarters` [rad]."""
    least, most = inf, -inf
    for i in range(QUARTERS - quarters, QUARTERS):
        least, most = min(least, m[PAST + COLUMNS * i + LOW]), max(most, m[PAST + COLUMNS * i + HIGH])
    return mean_of(m, E, quarters), most - least


def check(m: Numbers, k: Rules) -> None:
    """Rest where the swing allows it."""
    (mean, width), last = swing(m, QUARTERS), PAST + (QUARTERS - 1) * COLUMNS
    right, left = -inf, -inf
    for i in range(QUARTERS):
        right, left = max(right, m[PAST + COLUMNS * i + HIGH]), max(left, -m[PAST + COLUMNS * i + LOW])
    m[SWUNG] = m[SWUNG] + 1 if min(right, left) > RINGING else 0.0
    if m[SWUNG] >= SWINGS:
        m[RINGS] = 1.0
    rings = m[RINGS] > 0
    if not rings and max(m[last + HIGH], -m[last + LOW]) > FAR:
        m[SAMPLES] = 0.0
    bound = MEAN if rings else min(START + GROWTH * k.dt * (m[SAMPLES] - k.dwell), FAR)
    if (rings or m[SAMPLES] >= k.dwell) and abs(mean) <= bound and width <= SWING:
        rest(m, k, QUARTERS if rings else HALF)


def rest(m: Numbers, k: Rules, quarters: int) -> None:
    """Rest at the mean pressures of the last `quarters`."""
    last, margin = PAST + (QUARTERS - 1) * COLUMNS, k.dead_band / 2 + LEAK
    for i in range(2):
        m[HELD + i], m[BEGAN + i] = mean_of(m, P1 + i, quarters), m[last + P1 + i]
    m[RESTS], m[SIDE] = 1.0, 1.0 if max(m[HELD], m[HELD + 1]) + margin < k.highest else -1.0
    m[SINCE], m[TORQUE], m[ERROR], m[FREE] = 0.0, 0.0, 0.0, EDGE


# --- corrections ------------------------------------------------------------------------------------------------------


def to_correct(m: Numbers, k: Rules) -> bool:
    """Return whether a correction of the error left over is due; end the rest if a pressure leaks."""
    margin = k.dead_band / 2 + LEAK
    for i in range(2):
        if abs(mean_of(m, P1 + i, HALF) - m[HELD + i]) > margin:
            begin(m)
            return False
    mean, swings = due(m)
    waited = m[SINCE] - ceil(k.settling / m[QUARTER_LENGTH])
    m[SINCE] += 1
    if waited > 0:
        m[FREE] = 0.0
    zone = DEAD_ZONE * (2 if m[RINGS] > 0 else 1)  # every correction makes it ring again
    return waited >= (QUARTERS - 1 if swings else 0) and abs(mean) > zone


def due(m: Numbers) -> tuple[float, bool]:
    """Return the mean error to correct [rad], and whether the joint swings."""
    swings = swing(m, HALF)[1] >= STILL
    return mean_of(m, E, QUARTERS if swings else 1), swings


def turn(m: Numbers, stiffness: float, slope1: float, slope2: float) -> None:
    """Correct the mean error of a joint with this `stiffness` [N·m/rad] and slopes ∂T/∂P [N·m/Pa]."""
    if not stiffness > 0:
        return
    mean, swings = due(m)
    torque = -mean * (stiffness if swings or m[RINGS] > 0 else gain(m, mean, stiffness))
    side, slopes = m[SIDE], (slope1, slope2)
    for i in range(2):
        change = min(side * torque / slopes[i], MOST)
        if change > 0:
            play = min(side * mean_of(m, P1 + i, HALF), side * m[BEGAN + i]) - NOISE
            m[HELD + i] = m[BEGAN + i] = side * (max(side * m[HELD + i], play) + change)
    m[SINCE], m[TORQUE], m[ERROR], m[FREE] = 0.0, torque, mean, abs(torque) / stiffness


def gain(m: Numbers, mean: float, stiffness: float) -> float:
    """Return g [N·m/rad] of a joint that does not move."""
    g = FIRST * stiffness
    if m[TORQUE] != 0:
        moved = (mean - m[ERROR]) * (1.0 if m[TORQUE] > 0 else -1.0)
        g = min(max(abs(m[TORQUE]) / (max(moved, 0.0) + RESOLUTION) / 2, stiffness), STIFFEST * stiffness)
    return min(g, stiffness * (1 + OVERSHOOT / abs(mean)))
