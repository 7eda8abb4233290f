"""The template estimates a sample in which nothing is out of the ordinary.

`mpc.observer.compiled.module` puts the formulas of a plant in the place of the lines below that begin with `FORMULAS`:
`rate_slopes` (x, v, d) ↦ x' and its Jacobian by (x, d), columns first, and `pulls` x ↦ what `mpc.observer.diagnosis`
asks of the muscles, functions of scalars that return tuples; `torque` (x, memory) ↦ T_f and `moved` (x, memory, motion)
↦ memory of friction in contact at x, which fill arrays. Their numbers are among what is known.

What is ordinary: every reading is believed at once, and so was the last one of each sensor; a sensor may repeat itself
as long as that is no reason to doubt it. All else is for the readable observer. The arrays k, known, and s, the state,
are those of `mpc.observer.compiled.layout`.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.model.compensation import JITTER
from mpc.observer import pressure_diagnosis, torque_diagnosis
from mpc.observer.compiled.layout import (
    ANGLE,
    BELIEF,
    COMMANDS,
    COVARIANCE,
    DEAD_BAND,
    DT,
    FELT,
    FLOOR,
    FOUND,
    GAIN,
    INNER,
    LAST,
    LENGTH,
    LOST,
    MEASURED,
    MEMORY,
    NEAR,
    ONE,
    OUTER,
    POSSIBLE,
    PRODUCT,
    Q_REST,
    QUICK,
    READ,
    REPEATING,
    REPEATS,
    SAID,
    SAMPLES,
    SEEN,
    SIGMA,
    SIZE,
    SLOW,
    STEP,
    SUBSTEPS,
    THETA_FLOOR,
    THETA_NOISE,
    TIME,
    TOLERANCE,
    TORQUE,
    TOTAL,
    TWO,
    USUAL,
    VARIANCES,
    WITHOUT,
    XI,
    H,
    K,
    Q,
    S,
)
from mpc.observer.diagnosis import Joint, follow, less_lost
from mpc.observer.gating import DOUBT, NEAR_A_TURN, ROUGH, SIGMAS, TURN
from mpc.observer.pressure_diagnosis import Sound
from mpc.tracking.compiled.jit import compiled, inlined, merged

FORMULAS: Any = None
rate_slopes = pulls = torque = moved = FORMULAS

NODES, SHARES = (0.0, 1 / 2, 1 / 2, 1.0), (1 / 6, 1 / 3, 1 / 3, 1 / 6)  # of the classical Runge–Kutta method


@compiled
def estimate(k: Array, s: Array, asked: Array) -> int:
    """Estimate from what is `asked`: 1, or 2 if the joint's health has to be looked at; 0 if the sample was not
    ordinary, and the state has not changed.
    """
    answer = 0
    if filtered(k, s, asked[0], asked[2], asked[3], asked[4], asked[5]):
        answer = diagnosed(k, s)
    if answer == 0:
        length = int(k[LENGTH])
        for i in range(length):
            s[i] = s[length + i]
    else:
        s[SAMPLES] += 1
    return answer


# --- the filter: `mpc.observer.kalman` and `mpc.observer.filter` ------------------------------------------------------


@inlined
def filtered(k: Array, s: Array, theta: float, P1: float, P2: float, u1: float, u2: float) -> bool:
    """Estimate from the readings and the commands (u1, u2) sent last; return whether that was ordinary.

    If not, only the second half of the state is as before.
    """
    past, commands, last = int(k[LENGTH]), int(k[COMMANDS]), int(k[ONE]) - 2
    for i in range(past):
        s[past + i] = s[i]
    if not (k[OUTER + 2] <= u1 <= k[OUTER + 7] and k[OUTER + 3] <= u2 <= k[OUTER + 8]):
        return False
    for i in range(commands, last):
        s[i] = s[i + 2]
    s[last], s[last + 1] = u1, u2
    s[READ], s[READ + 1], s[READ + 2] = theta, P1, P2
    learn_step(k, s, abs(theta - s[past + READ]))
    follow_friction(k, s)
    predicted(k, s, past + XI, Q, XI)
    if not (sound(s, XI) and believed(k, s) and not_frozen(k, s)):
        return False
    for sensor in range(3):
        correct(s, XI, sensor)
    return sound(s, XI)


@inlined
def learn_step(k: Array, s: Array, change: float) -> None:
    """Learn the step of an encoder, see `KalmanObserver`."""
    if 0 < change < s[STEP]:
        rough = max(k[THETA_NOISE], change / np.sqrt(12.0))
        s[STEP], s[VARIANCES], s[FLOOR] = change, rough * rough, max(k[THETA_FLOOR], ROUGH * rough)


@inlined
def believed(k: Array, s: Array) -> bool:
    """Return whether all readings are near to what is expected, and no angle has to be unwrapped."""
    near = abs(s[XI] - s[READ]) <= TURN / 2 - NEAR_A_TURN
    for i in range(3):
        read, place = s[READ + i], MEASURED[i]
        variance = s[XI + COVARIANCE + (SIZE + 1) * place] + s[VARIANCES + i]
        near = near and k[POSSIBLE + i] <= read <= k[POSSIBLE + 3 + i]
        near = near and abs(read - s[XI + place]) <= max(SIGMAS * np.sqrt(variance), s[FLOOR + i])
    return bool(near)


@inlined
def not_frozen(k: Array, s: Array) -> bool:
    """Follow what is thought without sensors that repeat themselves; return whether none of them is frozen."""
    past = int(k[LENGTH])
    for i in range(3):
        if s[READ + i] != s[past + READ + i]:
            s[REPEATING + i] = s[REPEATS + i] = 0.0
            continue
        s[REPEATING + i] += k[DT]
        belief = WITHOUT + BELIEF * i
        predicted(k, s, past + (belief if s[REPEATS + i] > 0 else XI), Q_REST, belief)
        place = belief + MEASURED[i]
        variance = s[belief + COVARIANCE + (SIZE + 1) * MEASURED[i]] + s[VARIANCES + i]
        if s[REPEATING + i] > k[TOLERANCE] and (s[READ + i] - s[place]) ** 2 > DOUBT**2 * variance:
            return False
        for sensor in range(3):
            if s[READ + sensor] != s[past + READ + sensor]:
                correct(s, belief, sensor)
        s[REPEATS + i] = 1.0
    return True


@inlined
def follow_friction(k: Array, s: Array) -> None:
    """Let the friction that is known follow the angle: see `FrictionState.follow`."""
    past, first, last = int(k[LENGTH]), MEMORY, int(k[COMMANDS])
    nearest(k, s, XI)
    s[FELT] = s[XI] - s[ANGLE]
    if abs(s[FELT]) > JITTER:
        s[ANGLE] = s[XI]
    else:
        s[FELT] = 0.0
    moved(s[NEAR : NEAR + 4], s[past + first : past + last], s[FELT : FELT + 1], k, s[first:last])


@inlined
def within(k: Array, i: int, value: float) -> float:
    """Return the nearest ξ_i that is possible."""
    return float(min(max(value, k[OUTER + i]), k[OUTER + SIZE + i]))


@inlined
def nearest(k: Array, s: Array, belief: int) -> None:
    """Fill in the nearest state (4,) for which the muscles' laws are made."""
    for i in range(4):
        s[NEAR + i] = min(max(within(k, i, s[belief + i]), k[INNER + i]), k[INNER + 4 + i])


@inlined
def acting(k: Array, P: float, u: float) -> float:
    """Return the command [Pa] that moves a regulator without dead band as `u` moves this one at the pressure `P`."""
    e, rest = u - P, k[DEAD_BAND] / 2
    return float(P + e - min(max(e, -rest), rest))


@inlined
def predicted(k: Array, s: Array, belief: int, noise: int, target: int) -> None:
    """Put at `target` what is expected of a `belief` a sample later, with the covariance at `noise`: see `Filter`."""
    commands = int(k[COMMANDS])
    nearest(k, s, belief)
    torque(s[NEAR : NEAR + 4], s[MEMORY:commands], k, s[FELT : FELT + 1])
    d = within(k, 4, s[belief + 4])
    v1 = acting(k, within(k, 2, s[belief + 2]), s[commands])
    v2 = acting(k, within(k, 3, s[belief + 3]), s[commands + 1])
    advance(k, s, v1, v2, d - s[FELT])
    for i in range(4):
        x = s[S + 6 * i + 5]
        for j in range(4):
            x += s[S + 6 * i + j] * (within(k, j, s[belief + j]) - s[NEAR + j])
        s[target + i] = x
    s[target + 4] = d
    propagate(k, s, belief + COVARIANCE, noise, target + COVARIANCE)


@inlined
def advance(k: Array, s: Array, v1: float, v2: float, d: float) -> None:
    """Leave in S (5, 6) the Jacobian by ξ of a sample from what is nearest, and beside it the state at its end."""
    for i in range(5):
        for j in range(5):
            s[S + 6 * i + j] = 1.0 if i == j else 0.0
    for i in range(4):
        s[S + 6 * i + 5] = s[NEAR + i]
    for _ in range(int(k[SUBSTEPS])):
        for i in range(24):
            s[K + i] = s[TOTAL + i] = 0.0
        for n in range(4):
            stage(k, s, v1, v2, d, k[H] * NODES[n], k[H] * SHARES[n])
        for i in range(24):
            s[S + i] += s[TOTAL + i]


@merged
def stage(k: Array, s: Array, v1: float, v2: float, d: float, a: float, b: float) -> None:
    """Go from one of Runge and Kutta's slopes, K (4, 6), to the next, at S + a K; the total grows by b times that."""
    x0, x1 = s[S + 5] + a * s[K + 5], s[S + 11] + a * s[K + 11]
    x2, x3 = s[S + 17] + a * s[K + 17], s[S + 23] + a * s[K + 23]
    o = rate_slopes(x0, x1, x2, x3, v1, v2, d, k)
    for j in range(5):
        s0, s1 = s[S + j] + a * s[K + j], s[S + 6 + j] + a * s[K + 6 + j]
        s2, s3 = s[S + 12 + j] + a * s[K + 12 + j], s[S + 18 + j] + a * s[K + 18 + j]
        s[K + j] = o[4] * s0 + o[8] * s1 + o[12] * s2 + o[16] * s3
        s[K + 6 + j] = o[5] * s0 + o[9] * s1 + o[13] * s2 + o[17] * s3
        s[K + 12 + j] = o[6] * s0 + o[10] * s1 + o[14] * s2 + o[18] * s3
        s[K + 18 + j] = o[7] * s0 + o[11] * s1 + o[15] * s2 + o[19] * s3
    for i in range(4):
        s[K + 6 * i + 4] += o[20 + i]
        s[K + 6 * i + 5] = o[i]
    for i in range(24):
        s[TOTAL + i] += b * s[K + i]


@inlined
def propagate(k: Array, s: Array, P: int, noise: int, target: int) -> None:
    """Put A P Aᵀ + Q at `target`, A being in S."""
    for i in range(SIZE):
        for j in range(SIZE):
            total = 0.0
            for m in range(SIZE):
                total += s[S + 6 * i + m] * s[P + SIZE * m + j]
            s[PRODUCT + SIZE * i + j] = total
    for i in range(SIZE):
        for j in range(SIZE):
            total = k[noise + SIZE * i + j]
            for m in range(SIZE):
                total += s[PRODUCT + SIZE * i + m] * s[S + 6 * j + m]
            s[target + SIZE * i + j] = total


@inlined
def correct(s: Array, belief: int, sensor: int) -> None:
    """Correct a belief by one reading: (1 - K C) P (1 - K C)ᵀ + K R Kᵀ, K = P Cᵀ/(C P Cᵀ + R).

    One after the other they correct it as all at once do, because their noise is not correlated.
    """
    P, place, R = belief + COVARIANCE, MEASURED[sensor], s[VARIANCES + sensor]
    row = P + SIZE * place
    variance = s[row + place] + R
    gap = s[READ + sensor] - s[belief + place]
    for i in range(SIZE):
        s[GAIN + i] = s[P + SIZE * i + place] / variance
        s[belief + i] += s[GAIN + i] * gap
    for i in range(SIZE):
        for j in range(SIZE):
            less = s[P + SIZE * i + j] - s[GAIN + i] * s[row + j]
            s[PRODUCT + SIZE * i + j] = R / variance * s[row + j] if i == place else less
    for i in range(SIZE):
        column = s[PRODUCT + SIZE * i + place]
        for j in range(SIZE):
            less = R / variance * column if j == place else s[PRODUCT + SIZE * i + j] - column * s[GAIN + j]
            s[P + SIZE * i + j] = less + s[GAIN + i] * R * s[GAIN + j]


@inlined
def sound(s: Array, belief: int) -> bool:
    """Return whether all of a belief is finite, and no variance negative."""
    good = True
    for i in range(BELIEF):
        good = good and np.isfinite(s[belief + i])
    for i in range(SIZE):
        good = good and s[belief + COVARIANCE + (SIZE + 1) * i] > 0
    return good


# --- the diagnosis: `mpc.observer.diagnosis` --------------------------------------------------------------------------


@inlined
def diagnosed(k: Array, s: Array) -> int:
    """Follow what may be broken: 1, or 2 if something new is suspected, or no longer; 0 if the numbers are out of
    range.
    """
    commands, first, second, third, end = int(k[COMMANDS]), int(k[ONE]), int(k[TWO]), int(k[TORQUE]), int(k[LENGTH])
    o = pulls(s[XI], s[XI + 1], s[XI + 2], s[XI + 3], k)
    for i in range(6):
        if not np.isfinite(o[i]):
            return 0
    rest, dt, sigma, seen = k[DEAD_BAND] / 2, k[DT], k[SIGMA], k[SEEN]
    one, two = Sound(k[QUICK], k[SLOW], rest, dt, sigma, seen), Sound(k[QUICK + 1], k[SLOW + 1], rest, dt, sigma, seen)
    t, read, v = s[TIME], (s[READ + 1], s[READ + 2]), (s[commands], s[commands + 1])
    parts = s[first:second], s[second:third], s[third:end]
    follow(*parts, Joint(one, two, k[USUAL]), t, read, v, s[XI + 4], o, s[READ] != s[LAST])
    for i in range(3):
        if s[LOST + i] > 0:
            s[SAID + i] = s[READ + i]
            s[LOST + i], little = less_lost(s[LOST + i], dt, k[TOLERANCE])
            if little:
                s[FOUND + i] = 0.0
    s[TIME], s[LAST] = t + dt, s[READ]
    return 2 if suspicious(k, s) else 1


@inlined
def suspicious(k: Array, s: Array) -> bool:
    """Return whether anything that the joint's health is made of is another one than a sample ago."""
    past, suspected, torques, changed = int(k[LENGTH]), pressure_diagnosis.SUSPECTED, int(k[TORQUE]), False
    for i in (int(k[ONE]) + suspected, int(k[TWO]) + suspected, torques + torque_diagnosis.BROKEN, FOUND, FOUND + 1,
              FOUND + 2):  # fmt: skip
        changed = changed or s[i] != s[past + i]
    now, before = s[torques + torque_diagnosis.LOADED], s[past + torques + torque_diagnosis.LOADED]
    return changed or (now != before and (now == now or before == before))


__all__ = ["estimate", "filtered"]
