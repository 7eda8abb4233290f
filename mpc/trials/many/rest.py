"""The rest mode of `mpc.tracking.rest` is made of flat numbers here, function by function under the same names."""

from math import ceil, pi, sqrt

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import inlined
from mpc.tracking.rest import (
    DEAD_ZONE,
    EDGE,
    FAR,
    FIRST,
    GROWTH,
    JOLT,
    LEAK,
    MEAN,
    OVERSHOOT,
    PUSH,
    RESOLUTION,
    RINGING,
    SAME,
    START,
    STIFFEST,
    STILL,
    SWING,
)  # fmt: skip
from mpc.trials.many.records import Resting

QUARTERS, HALF, SWINGS = 4, 2, 6
E, P1, LOW, HIGH = 0, 1, 3, 4  # columns of the quarters
# numbers that are remembered
(
    SINCE, TORQUE, ERROR, FREE, SIDE, RINGS, QUARTER, RESTS, SAMPLES, COUNTED, SWUNG, IN_SUM, LEAST, MOST,
) = range(14)  # fmt: skip
# numbers that are known
INERTIA, DT, SETTLING, DWELL, SHORTEST, LONGEST, DEAD_BAND, HIGHEST = range(8)


@inlined
def begin(m: Resting) -> None:
    """Begin to wait for a rest."""
    s = m.rest
    s[RESTS] = s[SAMPLES] = s[COUNTED] = s[SWUNG] = s[IN_SUM] = 0.0
    m.quarters[:], m.total[:] = 0.0, 0.0
    s[LEAST], s[MOST] = np.inf, -np.inf


@inlined
def constant(m: Resting, theta: Array, K: Array) -> bool:
    """Return whether the preview stands still where it stood."""
    still = True
    for k in range(theta.size):
        still = still and abs(theta[k] - m.reference[0]) <= SAME[0] and abs(K[k] - m.reference[1]) <= SAME[1]
    if still:
        return True
    m.reference[0], m.reference[1] = theta[0], K[0]
    quarter = pi / 2 * sqrt(m.known[INERTIA] / K[0]) / m.known[DT]
    m.rest[QUARTER] = int(min(max(quarter, m.known[SHORTEST]), m.known[LONGEST]) + 0.5)
    m.rest[RINGS] = 0.0
    return False


@inlined
def swing(m: Resting, quarters: int) -> tuple[float, float]:
    """Return the mean of e, and how far it goes from peak to peak, over the last `quarters` [rad]."""
    total, least, most = 0.0, np.inf, -np.inf
    for i in range(QUARTERS - quarters, QUARTERS):
        total += m.quarters[i, E]
        least, most = min(least, m.quarters[i, LOW]), max(most, m.quarters[i, HIGH])
    return total / quarters, most - least


@inlined
def pushed(m: Resting, theta: float, expected: float) -> bool:
    """Return whether a rest is disturbed at the angle `theta` [rad] where `expected` [rad] was predicted."""
    s = m.rest
    if s[RESTS] == 0.0:
        return False
    mean, width = swing(m, QUARTERS)
    away = abs(theta - m.reference[0] - mean)
    jolt = JOLT * (2 if s[RINGS] > 0 else 1)
    return abs(theta - expected) > jolt or away > PUSH + width + s[FREE]


@inlined
def quarter_ended(m: Resting, x: Array) -> bool:
    """Return whether a quarter of a period ends with the sample that sees `x` (4,)."""
    s, e = m.rest, x[0] - m.reference[0]
    m.total[0] += e
    m.total[1] += x[2]
    m.total[2] += x[3]
    s[IN_SUM] += 1
    s[LEAST], s[MOST] = min(s[LEAST], e), max(s[MOST], e)
    if s[IN_SUM] < s[QUARTER]:
        return False
    for i in range(QUARTERS - 1):
        m.quarters[i] = m.quarters[i + 1]
    for j in range(3):
        m.quarters[QUARTERS - 1, j] = m.total[j] / s[IN_SUM]
    m.quarters[QUARTERS - 1, LOW], m.quarters[QUARTERS - 1, HIGH] = s[LEAST], s[MOST]
    s[COUNTED] = min(s[COUNTED] + 1, QUARTERS)
    m.total[:], s[IN_SUM] = 0.0, 0.0
    s[LEAST], s[MOST] = np.inf, -np.inf
    return True


@inlined
def pressure(m: Resting, quarters: int, i: int) -> float:
    """Return the mean of a pressure over the last `quarters` [Pa]."""
    total = 0.0
    for j in range(QUARTERS - quarters, QUARTERS):
        total += m.quarters[j, P1 + i]
    return total / quarters


@inlined
def check(m: Resting) -> None:
    """Rest where the swing allows it."""
    s, (mean, width) = m.rest, swing(m, QUARTERS)
    most, least = -np.inf, np.inf
    for i in range(QUARTERS):
        most, least = max(most, m.quarters[i, HIGH]), min(least, m.quarters[i, LOW])
    s[SWUNG] = s[SWUNG] + 1 if min(most, -least) > RINGING else 0.0
    if s[SWUNG] >= SWINGS:
        s[RINGS] = 1.0
    last = m.quarters[QUARTERS - 1]
    if s[RINGS] == 0.0 and max(last[HIGH], -last[LOW]) > FAR:
        s[SAMPLES] = 0.0
    bound = MEAN if s[RINGS] > 0 else min(START + GROWTH * m.known[DT] * (s[SAMPLES] - m.known[DWELL]), FAR)
    if (s[RINGS] > 0 or s[SAMPLES] >= m.known[DWELL]) and abs(mean) <= bound and width <= SWING:
        over = QUARTERS if s[RINGS] > 0 else HALF
        s[RESTS] = 1.0
        m.p[0], m.p[1] = pressure(m, over, 0), pressure(m, over, 1)
        margin = m.known[DEAD_BAND] / 2 + LEAK
        s[SIDE] = 1.0 if max(m.p[0], m.p[1]) + margin < m.known[HIGHEST] else -1.0
        s[SINCE] = s[TORQUE] = s[ERROR] = 0.0
        s[FREE], m.began[0], m.began[1] = EDGE, last[P1], last[P1 + 1]


@inlined
def correction(m: Resting) -> tuple[bool, float, bool]:
    """Return whether to correct, and the mean error [rad] that is left over and whether the joint swings."""
    s, margin = m.rest, m.known[DEAD_BAND] / 2 + LEAK
    if max(abs(pressure(m, HALF, 0) - m.p[0]), abs(pressure(m, HALF, 1) - m.p[1])) > margin:
        begin(m)
        return False, 0.0, False
    swings = swing(m, HALF)[1] >= STILL
    waited = s[SINCE] - ceil(m.known[SETTLING] / s[QUARTER])
    s[SINCE] += 1
    if waited > 0:
        s[FREE] = 0.0
    mean = swing(m, QUARTERS if swings else 1)[0]
    zone = DEAD_ZONE * (2 if s[RINGS] > 0 else 1)
    return waited >= (QUARTERS - 1 if swings else 0) and abs(mean) > zone, mean, swings


@inlined
def gain(m: Resting, mean: float, K: float) -> float:
    """Return g [N·m/rad] of a joint that does not move."""
    s, g = m.rest, FIRST * K
    if s[TORQUE] != 0.0:
        moved = (mean - s[ERROR]) * np.sign(s[TORQUE])
        g = min(max(abs(s[TORQUE]) / (max(moved, 0.0) + RESOLUTION) / 2, K), STIFFEST * K)
    return min(g, K * (1 + OVERSHOOT / abs(mean)))
