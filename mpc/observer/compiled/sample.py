"""The template estimates a sample in which nothing is out of the ordinary.

`mpc.observer.compiled.module` puts the formulas of a plant in the place of the lines below that begin with `FORMULAS`:
`rate_slopes` (x, v, d) ↦ x' and its Jacobian by (x, d), columns first, and `muscles` x ↦ what `mpc.observer.diagnosis`
asks of the muscles, and the isobaric stiffness: functions of scalars that return tuples. Their numbers are among what
is known.

What is ordinary: every reading is believed at once, and so was the last one of each sensor; a sensor may repeat itself
as long as that is no reason to doubt it. All else is for the readable observer. The arrays k, known, and s, the state,
are those of `mpc.observer.compiled.layout`.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled, inlined
from mpc.model.compiled_friction import ABSENT, SLIP, Pressed, followed
from mpc.model.integration import NODES, SHARES
from mpc.observer import pressure_diagnosis, torque_diagnosis
from mpc.observer.compiled.layout import (
    ACTING,
    ANGLE,
    AT,
    BELIEF,
    COMMANDS,
    COVARIANCE,
    DEAD_BAND,
    DT,
    FLOOR,
    FOUND,
    FRICTION,
    GAIN,
    INNER,
    INSIDE,
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

FORMULAS: Any = None
rate_slopes = muscles = FORMULAS


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
    change = abs(theta - s[past + READ])
    if 0 < change < s[STEP]:  # of an encoder
        rough = max(k[THETA_NOISE], change / np.sqrt(12.0))
        s[STEP], s[VARIANCES], s[FLOOR] = change, rough * rough, max(k[THETA_FLOOR], ROUGH * rough)
    follow_friction(k, s)
    predicted(k, s, past + XI, Q, XI)
    if not (sound(s, XI) and believed(k, s) and not_frozen(k, s)):
        return False
    for sensor in range(3):
        correct(s, XI, sensor)
    return sound(s, XI)


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
    past, first, last, friction = int(k[LENGTH]), MEMORY, int(k[COMMANDS]), k[int(k[FRICTION]) :]
    nearest(k, s, XI)
    s[ANGLE] = followed(friction, s[XI], pressing(k, s), s[ANGLE], s[past + first : past + last], s[first:last])


@inlined
def pressing(k: Array, s: Array) -> Pressed:
    """Return what presses on that which rubs in the nearest state."""
    o = muscles(s[NEAR], s[NEAR + 1], s[NEAR + 2], s[NEAR + 3], k)
    return Pressed(o[0] - o[1], s[NEAR + 2] + s[NEAR + 3], o[6])


@inlined
def rubbing(k: Array, s: Array) -> float:
    """Return the friction torque [N·m] in the nearest state."""
    friction, total = k[int(k[FRICTION]) :], 0.0
    if friction[0] == ABSENT:
        return 0.0
    pressed = pressing(k, s)
    if friction[0] != SLIP:
        return float((friction[1] * pressed.pulled + friction[2]) * s[MEMORY])
    for i in range(int(k[COMMANDS]) - MEMORY):
        total += friction[4 + i] * s[MEMORY + i]
    return float(total * pressed.stiffness if friction[2] != 0.0 else total)


@inlined
def nearest(k: Array, s: Array, belief: int) -> None:
    """Fill in the nearest ξ (5,) that is possible, and the nearest state (4,) for which the muscles' laws are made."""
    for i in range(SIZE):
        s[INSIDE + i] = min(max(s[belief + i], k[OUTER + i]), k[OUTER + SIZE + i])
    for i in range(4):
        s[NEAR + i] = min(max(s[INSIDE + i], k[INNER + i]), k[INNER + 4 + i])


@inlined
def predicted(k: Array, s: Array, belief: int, noise: int, target: int) -> None:
    """Put at `target` what is expected of a `belief` a sample later, with the covariance at `noise`: see `Filter`."""
    commands, rest = int(k[COMMANDS]), k[DEAD_BAND] / 2
    nearest(k, s, belief)
    for i in range(2):
        e = s[commands + i] - s[INSIDE + 2 + i]
        s[ACTING + i] = s[INSIDE + 2 + i] + e - min(max(e, -rest), rest)
    advance(k, s, s[INSIDE + 4] - rubbing(k, s))
    for i in range(4):
        x = s[S + 6 * i + 5]
        for j in range(4):
            x += s[S + 6 * i + j] * (s[INSIDE + j] - s[NEAR + j])
        s[target + i] = x
    s[target + 4] = s[INSIDE + 4]
    propagate(k, s, belief + COVARIANCE, noise, target + COVARIANCE)


@inlined
def advance(k: Array, s: Array, d: float) -> None:
    """Leave in S (5, 6) the Jacobian by ξ of a sample from what is nearest, and beside it the state at its end.

    From one of Runge and Kutta's slopes to the next, K (4, 6) at S + a K, which b times adds to the total.
    """
    for i in range(5):
        for j in range(5):
            s[S + 6 * i + j] = 1.0 if i == j else 0.0
    for i in range(4):
        s[S + 6 * i + 5] = s[NEAR + i]
    for n in range(4 * int(k[SUBSTEPS])):
        a, b = k[H] * NODES[n % 4], k[H] * SHARES[n % 4]
        if n % 4 == 0:
            for i in range(24):
                s[K + i] = s[TOTAL + i] = 0.0
        for i in range(24):
            s[AT + i] = s[S + i] + a * s[K + i]
        o = rate_slopes(s[AT + 5], s[AT + 11], s[AT + 17], s[AT + 23], s[ACTING], s[ACTING + 1], d, k)
        for j in range(5):
            s0, s1, s2, s3 = s[AT + j], s[AT + 6 + j], s[AT + 12 + j], s[AT + 18 + j]
            s[K + j] = o[4] * s0 + o[8] * s1 + o[12] * s2 + o[16] * s3
            s[K + 6 + j] = o[5] * s0 + o[9] * s1 + o[13] * s2 + o[17] * s3
            s[K + 12 + j] = o[6] * s0 + o[10] * s1 + o[14] * s2 + o[18] * s3
            s[K + 18 + j] = o[7] * s0 + o[11] * s1 + o[15] * s2 + o[19] * s3
        for i in range(4):
            s[K + 6 * i + 4] += o[20 + i]
            s[K + 6 * i + 5] = o[i]
        for i in range(24):
            s[TOTAL + i] += b * s[K + i]
        if n % 4 == 3:
            for i in range(24):
                s[S + i] += s[TOTAL + i]


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
    o = muscles(s[XI], s[XI + 1], s[XI + 2], s[XI + 3], k)
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
