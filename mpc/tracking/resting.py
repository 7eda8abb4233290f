"""Rest mode of n joints and m muscles as functions of arrays, for Python (`mpc.tracking.rest`), compiled steps and C.

One flat array holds its state; a `Memory` has views into it.
"""

from math import ceil, inf, nan, pi, sqrt
from typing import TypeAlias

from allocator.calculus import Array
from allocator.units import BAR, DEG
from mpc.tracking.rest_memory import (
    ASKED,
    BEGAN,
    CHANGE,
    COUNTED,
    ERROR,
    FILLED,
    FREE,
    GREATEST,
    HALF,
    HELD,
    HIGH,
    IN_SUM,
    LEAST,
    LOW,
    QUARTER_LENGTH,
    QUARTERS,
    RESTS,
    RINGS,
    SAMPLES,
    SIDE,
    SINCE,
    SUM,
    SWINGS,
    SWUNG,
    THETA,
    TORQUE,
    USUAL,
    E,
    Memory,
    Rules,
)

SAME = 1e-3 * DEG, 1e-3  # [rad], [N·m/rad]: a preview that varies less is constant
DWELL = 1.5  # [s] of constant preview before a rest, and after a push
START, GROWTH, MEAN = 0.05 * DEG, 0.2 * DEG, 0.3 * DEG  # [rad], [rad/s], [rad] |mean e| to rest at, MEAN if it rings
SWING = 2.0 * DEG  # [rad] peak to peak, the most to rest at
FAR = 1.0 * DEG  # [rad] of e, beyond which the time restarts
RINGING = 0.5 * DEG  # [rad] to both sides within a period, repeatedly
DEAD_ZONE = 0.045 * DEG  # [rad]
STILL = 0.06 * DEG  # [rad] peak to peak over half a period
FIRST, STIFFEST = 1.6, 3.0  # [-] of K: the gain before there is a secant, the greatest
RESOLUTION = 0.015 * DEG  # [rad] to which the effect of a correction is known
OVERSHOOT = 0.15 * DEG  # [rad]
MOST, LEAST_CHANGE = 0.1 * BAR, 1e-5 * BAR  # [Pa] of a correction
SWEEPS = 30  # over the muscles, to share a torque among them
JOLT = 0.045 * DEG  # [rad] by joint: those of an arm move each other
UNUSUAL, PUSH = 2.0, 0.12 * DEG  # [-] of the usual error of a prediction, [rad]
EDGE = 0.5 * DEG  # [rad] by which the regulators' way to their edges may turn a joint
LEAK = 0.1 * BAR  # [Pa] beyond the dead band
NOISE = 0.005 * BAR  # [Pa] of a pressure's mean
QUARTER = 0.1, 0.5  # [s] least and most of a quarter of a period

Row: TypeAlias = Array | tuple[float, ...]


def size(n: int, m: int) -> int:
    """Return the size of the memory of `n` joints and `m` muscles."""
    return 9 + 9 * n + 4 * m + QUARTERS * (3 * n + m) + n * n


def memory_in(numbers: Array, n: int, m: int) -> Memory:
    """Return views into `numbers` (size,) of `n` joints and `m` muscles."""
    a = 9 + 9 * n
    b = a + 4 * m
    c = b + 3 * QUARTERS * n
    d = c + QUARTERS * m
    joint, muscle, turned = numbers[9:a].reshape(n, 9), numbers[a:b].reshape(m, 4), numbers[b:c].reshape(QUARTERS, n, 3)
    return Memory(numbers[:9], joint, muscle, turned, numbers[c:d].reshape(QUARTERS, m), numbers[d:])


def clear(m: Memory) -> None:
    """Forget everything."""
    for i in range(len(m.shared)):
        m.shared[i] = 0.0
    m.shared[QUARTER_LENGTH] = 1.0
    for i in range(len(m.joint)):
        for c in range(TORQUE + 1):
            m.joint[i, c] = 0.0
        m.joint[i, THETA] = nan
    for i in range(len(m.muscle)):
        m.muscle[i, HELD] = m.muscle[i, BEGAN] = 0.0
    for i in range(len(m.stiffness)):
        m.stiffness[i] = nan
    begin(m)


def holds(m: Memory) -> bool:
    """Return whether the commands rest."""
    return bool(m.shared[RESTS] > 0)


def rings(m: Memory) -> bool:
    """Return whether the loop compensates friction that does not exist."""
    return bool(m.shared[RINGS] > 0)


def side(m: Memory) -> float:
    """Return the edge of the dead band, ±1; 0 before the first rest."""
    return float(m.shared[SIDE])


def pressure(m: Memory, i: int) -> float:
    """Return the held pressure of a muscle [Pa]."""
    return float(m.muscle[i, HELD])


def angle(m: Memory, i: int) -> float:
    """Return the mean angle of a joint that has to be corrected [rad]."""
    mean, _ = due(m, i)
    return float(m.joint[i, THETA] + mean)


def begin(m: Memory) -> None:
    """Begin to wait for a rest."""
    s = m.shared
    s[RESTS] = s[SAMPLES] = s[COUNTED] = s[SWUNG] = 0.0
    for q in range(QUARTERS):
        for i in range(len(m.joint)):
            m.turned[q, i, E] = m.turned[q, i, LOW] = m.turned[q, i, HIGH] = 0.0
        for i in range(len(m.muscle)):
            m.filled[q, i] = 0.0
    begin_quarter(m)


def begin_quarter(m: Memory) -> None:
    """Begin a quarter of a period."""
    m.shared[IN_SUM] = 0.0
    for i in range(len(m.joint)):
        m.joint[i, SUM], m.joint[i, LEAST], m.joint[i, GREATEST] = 0.0, inf, -inf
    for i in range(len(m.muscle)):
        m.muscle[i, FILLED] = 0.0


def follow(m: Memory, k: Rules, theta: Array, stiffness: Array, entries: int) -> None:
    """Store a moved reference: the first `theta` [rad] and the first `entries` of K [N·m/rad]."""
    softest, rows = stiffness[0], int(sqrt(entries) + 0.5)
    for i in range(rows):
        softest = min(softest, stiffness[i * (rows + 1)])
    for i in range(entries):
        m.stiffness[i] = stiffness[i]
    for i in range(len(m.joint)):
        m.joint[i, THETA] = theta[i]
    m.shared[RINGS] = 0.0
    quarter = pi / 2 * sqrt(k.inertia / softest) / k.dt
    m.shared[QUARTER_LENGTH] = float(int(min(max(quarter, k.shortest), k.longest) + 0.5))


def constant(m: Memory, k: Rules, theta: Array, stiffness: Array) -> bool:
    """Return whether the flat previews (M n,) and (M k k,) stay at the stored reference; store the new one if not."""
    n = len(m.joint)
    samples = len(theta) // n
    entries = len(stiffness) // samples
    for s in range(samples):
        same = True
        for i in range(n):
            same = same and abs(theta[s * n + i] - m.joint[i, THETA]) <= SAME[0]
        for i in range(entries):
            same = same and abs(stiffness[s * entries + i] - m.stiffness[i]) <= SAME[1]
        if not same:
            follow(m, k, theta, stiffness, entries)
            return False
    return True


def decided(m: Memory, k: Rules, seen: Array, expected: Array) -> bool:
    """Process the state `seen` (2n + m,) at a constant reference, with predicted angles `expected` (n, …) [rad]; return
    whether a correction of the mean errors of `due` is needed.
    """
    if pushed(m, k, seen, expected):
        begin(m)
        return False
    if m.shared[RESTS] == 0:
        watch(m, seen, expected)
    m.shared[SAMPLES] += 1
    if not quarter_ended(m, seen):
        return False
    if holds(m):
        return to_correct(m, k)
    if m.shared[COUNTED] == QUARTERS:
        check(m, k)
    return False


def watch(m: Memory, theta: Array, expected: Array) -> None:
    """Update the usual error of the angles `theta` [rad] against those `expected` [rad], due to encoder steps and model
    errors.
    """
    kept = 1 - 1 / (QUARTERS * m.shared[QUARTER_LENGTH])
    for i in range(len(m.joint)):
        off = abs(theta[i] - expected[i])
        m.joint[i, USUAL] *= kept
        if off > m.joint[i, USUAL]:
            m.joint[i, USUAL] = off


def pushed(m: Memory, k: Rules, theta: Array, expected: Array) -> bool:
    """Return whether the angles `theta` [rad] disturb a rest, given those `expected` [rad]."""
    if m.shared[RESTS] == 0:
        return False
    ringing = rings(m)
    for i in range(len(m.joint)):
        mean, width = swing(m, i, QUARTERS)
        away = abs(theta[i] - m.joint[i, THETA] - mean)
        least = k.jolt * (2 if ringing else 1)  # a ringing joint lacks the predicted friction
        jolt = max(least, UNUSUAL * m.joint[i, USUAL])
        if abs(theta[i] - expected[i]) > jolt or away > PUSH + width + m.joint[i, FREE]:
            return True
    return False


def quarter_ended(m: Memory, seen: Array) -> bool:
    """Return whether a quarter of a period ends with the sample of the state `seen` (2n + m,)."""
    n, s, last = len(m.joint), m.shared, QUARTERS - 1
    s[IN_SUM] += 1
    for i in range(n):
        e = seen[i] - m.joint[i, THETA]
        m.joint[i, SUM] += e
        m.joint[i, LEAST], m.joint[i, GREATEST] = min(m.joint[i, LEAST], e), max(m.joint[i, GREATEST], e)
    for i in range(len(m.muscle)):
        m.muscle[i, FILLED] += seen[2 * n + i]
    if s[IN_SUM] < s[QUARTER_LENGTH]:
        return False
    for i in range(n):
        for q in range(last):
            for c in range(3):
                m.turned[q, i, c] = m.turned[q + 1, i, c]
        m.turned[last, i, E] = m.joint[i, SUM] / s[IN_SUM]
        m.turned[last, i, LOW], m.turned[last, i, HIGH] = m.joint[i, LEAST], m.joint[i, GREATEST]
    for i in range(len(m.muscle)):
        for q in range(last):
            m.filled[q, i] = m.filled[q + 1, i]
        m.filled[last, i] = m.muscle[i, FILLED] / s[IN_SUM]
    s[COUNTED] = min(s[COUNTED] + 1, QUARTERS)
    begin_quarter(m)
    return True


def mean_pressure(m: Memory, i: int, quarters: int) -> float:
    """Return the mean pressure of a muscle over the last `quarters` [Pa]."""
    total = 0.0
    for q in range(QUARTERS - quarters, QUARTERS):
        total += m.filled[q, i]
    return total / quarters


def swing(m: Memory, i: int, quarters: int) -> tuple[float, float]:
    """Return the mean and the peak-to-peak swing of a joint's e over the last `quarters` [rad]."""
    total, least, most = 0.0, inf, -inf
    for q in range(QUARTERS - quarters, QUARTERS):
        total += m.turned[q, i, E]
        least, most = min(least, m.turned[q, i, LOW]), max(most, m.turned[q, i, HIGH])
    return total / quarters, most - least


def check(m: Memory, k: Rules) -> None:
    """Enter a rest if the swings of all joints allow it."""
    s, last, swung, far = m.shared, QUARTERS - 1, False, False
    for i in range(len(m.joint)):
        right, left = -inf, -inf
        for q in range(QUARTERS):
            right, left = max(right, m.turned[q, i, HIGH]), max(left, -m.turned[q, i, LOW])
        swung = swung or min(right, left) > RINGING
        far = far or max(m.turned[last, i, HIGH], -m.turned[last, i, LOW]) > FAR
    s[SWUNG] = s[SWUNG] + 1 if swung else 0.0
    if s[SWUNG] >= SWINGS:
        s[RINGS] = 1.0
    ringing = rings(m)
    if far and not ringing:
        s[SAMPLES] = 0.0
    bound = MEAN if ringing else min(START + GROWTH * k.dt * (s[SAMPLES] - k.dwell), FAR)
    still = ringing or s[SAMPLES] >= k.dwell
    for i in range(len(m.joint)):
        mean, width = swing(m, i, QUARTERS)
        still = still and abs(mean) <= bound and width <= SWING
    if still:
        rest(m, k, QUARTERS if ringing else HALF)


def rest(m: Memory, k: Rules, quarters: int) -> None:
    """Enter a rest at the mean pressures of the last `quarters`."""
    margin, highest = k.dead_band / 2 + LEAK, -inf
    for i in range(len(m.muscle)):
        m.muscle[i, HELD], m.muscle[i, BEGAN] = mean_pressure(m, i, quarters), m.filled[QUARTERS - 1, i]
        highest = max(highest, m.muscle[i, HELD])
    m.shared[RESTS], m.shared[SIDE], m.shared[SINCE] = 1.0, 1.0 if highest + margin < k.highest else -1.0, 0.0
    for i in range(len(m.joint)):
        m.joint[i, ASKED], m.joint[i, ERROR], m.joint[i, FREE] = 0.0, 0.0, EDGE


# --- corrections ------------------------------------------------------------------------------------------------------


def to_correct(m: Memory, k: Rules) -> bool:
    """Return whether a remaining error has to be corrected; end the rest if a pressure leaks."""
    margin, s = k.dead_band / 2 + LEAK, m.shared
    for i in range(len(m.muscle)):
        if abs(mean_pressure(m, i, HALF) - m.muscle[i, HELD]) > margin:
            begin(m)
            return False
    waited = s[SINCE] - ceil(k.settling / s[QUARTER_LENGTH])
    s[SINCE] += 1
    correct = False
    for i in range(len(m.joint)):
        if waited > 0:
            m.joint[i, FREE] = 0.0
        mean, swings = due(m, i)
        correct = correct or (waited >= (QUARTERS - 1 if swings else 0) and abs(mean) > zone(m))
    return correct


def zone(m: Memory) -> float:
    """Return the mean error [rad] up to which there is no correction, since each makes a joint ring again."""
    return DEAD_ZONE * (2 if rings(m) else 1)


def due(m: Memory, i: int) -> tuple[float, bool]:
    """Return the mean error of a joint to correct [rad], and whether it swings."""
    _, width = swing(m, i, HALF)
    swings = width >= STILL
    mean, _ = swing(m, i, QUARTERS if swings else 1)
    return mean, swings


def turn(m: Memory, stiffness: Row, slopes: Row) -> None:
    """Correct the mean errors of joints with the flat `stiffness` (n n,) [N·m/rad] and slopes ∂T/∂P (n m,) [N·m/Pa]."""
    n, s = len(m.joint), m.shared
    for i in range(n):
        if not stiffness[i * n + i] > 0:
            return
    for i in range(n):
        mean, swings = due(m, i)
        own = stiffness[i * n + i]
        g = own if swings or s[RINGS] > 0 else gain(m, i, mean, own)
        m.joint[i, ASKED] = -mean * g if abs(mean) > zone(m) else 0.0
        m.joint[i, ERROR], m.joint[i, FREE] = mean, abs(m.joint[i, ASKED]) / own
    for i in range(n):
        m.joint[i, TORQUE] = m.joint[i, ASKED]
        for j in range(n):
            if j != i:
                m.joint[i, TORQUE] += stiffness[i * n + j] * m.joint[j, ASKED] / stiffness[j * n + j]
    share(m, slopes)
    raise_held(m)
    s[SINCE] = 0.0


def share(m: Memory, slopes: Row) -> None:
    """Share the torques among pressure changes on the held side, by least squares over one muscle after the other."""
    n, M, edge = len(m.joint), len(m.muscle), m.shared[SIDE]
    for j in range(M):
        m.muscle[j, CHANGE] = 0.0
    for _ in range(SWEEPS):
        for j in range(M):
            along, square = 0.0, 0.0
            for i in range(n):
                along += slopes[i * M + j] * m.joint[i, TORQUE]
                square += slopes[i * M + j] ** 2
            before = m.muscle[j, CHANGE]
            if square > 0:
                m.muscle[j, CHANGE] = max(before + edge * along / square, 0.0)
            for i in range(n):
                m.joint[i, TORQUE] -= slopes[i * M + j] * edge * (m.muscle[j, CHANGE] - before)


def raise_held(m: Memory) -> None:
    """Move the held pressures by their changes, all scaled by the same factor if one is too large."""
    edge, largest = m.shared[SIDE], 0.0
    for j in range(len(m.muscle)):
        largest = max(largest, m.muscle[j, CHANGE])
    for j in range(len(m.muscle)):
        change = m.muscle[j, CHANGE] * min(1.0, MOST / max(largest, LEAST_CHANGE))
        if change > LEAST_CHANGE:
            play = min(edge * mean_pressure(m, j, HALF), edge * m.muscle[j, BEGAN]) - NOISE
            m.muscle[j, HELD] = m.muscle[j, BEGAN] = edge * (max(edge * m.muscle[j, HELD], play) + change)


def gain(m: Memory, i: int, mean: float, own: float) -> float:
    """Return the gain g [N·m/rad] for a joint at standstill with the mean error `mean` [rad]."""
    g, asked = FIRST * own, m.joint[i, ASKED]
    if asked != 0:
        moved = (mean - m.joint[i, ERROR]) * (1.0 if asked > 0 else -1.0)
        g = min(max(abs(asked) / (max(moved, 0.0) + RESOLUTION) / 2, own), STIFFEST * own)
    return min(g, own * (1 + OVERSHOOT / max(abs(mean), RESOLUTION)))
