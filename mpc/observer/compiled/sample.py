"""Template of the estimate of an ordinary sample.

`mpc.observer.compiled.module` replaces the lines below that begin with `FORMULAS` by the formulas of a plant:
`rate_slopes` (x, v, d) ↦ x' and its Jacobian by (x, d), columns first, and `muscles` x ↦ the muscles' values for
`mpc.observer.diagnosis` and the isobaric stiffness: functions of scalars that return tuples. Their numbers are the
piece c.

In an ordinary sample every reading is believed at once, as was the last one of each sensor; a sensor may repeat itself
as long as it is not doubted for that. The readable observer estimates all other samples.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.addresses import floats, opener
from mpc.codegen.jit import compiled, inlined
from mpc.model.compiled_friction import ABSENT, followed, rubbing_in, strength
from mpc.model.friction.contact import Pressed
from mpc.model.integration import NODES, SHARES
from mpc.observer import pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.compiled.layout import MEASURED, SIZE, Belief, Places, Sample
from mpc.observer.diagnosis import Known, follow, large_since, less_lost, steps
from mpc.observer.filter import SETTLED
from mpc.observer.gating import DOUBT, NEAR_A_TURN, ROUGH, SIGMAS, TURN
from mpc.observer.pressure_diagnosis import Sound

FORMULAS: Any = None
rate_slopes = muscles = FORMULAS
sample_at = opener(Sample)


@compiled
def estimate(sample: int, theta: float, P1: float, P2: float, u1: float, u2: float) -> int:
    """Estimate from readings and the last command sent, in the `Sample` at this address.

    Return 1, or 2 if the joint's health has to be updated; return 0 and leave the state unchanged if the sample is not
    ordinary.
    """
    answer, o = 0, sample_at(sample)
    if filtered(o, theta, P1, P2, u1, u2):
        answer = diagnosed(o)
    if answer == 0:
        copy_state(o.past_places, o.places)
    else:
        o.now.samples += 1
    return answer


@inlined
def copy_state(one: Places, other: Places) -> None:
    """Copy one state to the other."""
    state, tail, to_state, to_tail = floats(one.state), floats(one.tail), floats(other.state), floats(other.tail)
    for i in range(state.size):
        to_state[i] = state[i]
    for i in range(tail.size):
        to_tail[i] = tail[i]


# --- the filter: `mpc.observer.kalman` and `mpc.observer.filter` ------------------------------------------------------


@inlined
def filtered(o: Sample, theta: float, P1: float, P2: float, u1: float, u2: float) -> bool:
    """Estimate from the readings and the last commands (u1, u2) sent; return whether the sample was ordinary.

    If not, only the past state is unchanged.
    """
    copy_state(o.places, o.past_places)
    k, s, commands, held = o.known, o.now, floats(o.places.commands), floats(o.places.held)
    if not (k.outer[0, 2] <= u1 <= k.outer[1, 2] and k.outer[0, 3] <= u2 <= k.outer[1, 3]):
        return False
    for i in range(commands.size - 2):
        commands[i] = commands[i + 2]
    commands[commands.size - 2], commands[commands.size - 1] = u1, u2
    for i in range(held.size - 2):
        held[i] = held[i + 2]
    held[held.size - 2], held[held.size - 1] = P1, P2
    s.read[0], s.read[1], s.read[2] = theta, held[0], held[1]
    w = o.work
    w.taken[0], w.taken[1], w.taken[2] = theta, held[0] - s.offset[0], held[1] - s.offset[1]
    change = abs(theta - o.past.read[0])
    if 0 < change < s.step:  # of an encoder
        rough = max(k.theta_noise, change / np.sqrt(12.0))
        s.step, s.variances[0], s.floor[0] = change, rough * rough, max(k.theta_floor, ROUGH * rough)
    follow_friction(o)
    predicted(o, o.past.belief, 0, k.Q, s.belief)
    if not (sound(s.belief) and believed(o) and not_frozen(o)):
        return False
    for i in range(2):
        P = s.belief.xi[2 + i]
        if abs(commands[i] - P) <= SETTLED:
            moved = s.offset[i] + k.learning * (w.taken[1 + i] - P)
            s.offset[i] = min(max(moved, -k.most_offset), k.most_offset)
    for sensor in range(3):
        correct(o, s.belief, sensor)
    return sound(s.belief) and brought_ahead(o)


@inlined
def brought_ahead(o: Sample) -> bool:
    """Predict the present belief from that at the time of the angle's reading; return whether it is finite."""
    w, s = o.work, o.now
    for i in range(SIZE):
        w.ahead.xi[i] = s.belief.xi[i]
        for j in range(SIZE):
            w.ahead.covariance[i, j] = s.belief.covariance[i, j]
    for k in range(1, floats(o.places.held).size // 2):
        predicted(o, w.ahead, k, o.known.Q, w.ahead)
    return sound(w.ahead)


@inlined
def believed(o: Sample) -> bool:
    """Return whether all readings are near the expected ones, and no angle has to be unwrapped."""
    k, s, belief, taken = o.known, o.now, o.now.belief, o.work.taken
    near = abs(belief.xi[0] - taken[0]) <= TURN / 2 - NEAR_A_TURN
    for i in range(3):
        read, place = taken[i], MEASURED[i]
        variance = belief.covariance[place, place] + s.variances[i]
        near = near and k.possible[0, i] <= read <= k.possible[1, i]
        near = near and abs(read - belief.xi[place]) <= max(SIGMAS * np.sqrt(variance), s.floor[i])
    return bool(near)


@inlined
def not_frozen(o: Sample) -> bool:
    """Update the beliefs without sensors that repeat themselves; return whether none of them is frozen."""
    k, s, past = o.known, o.now, o.past
    for i in range(3):
        if s.read[i] != past.read[i]:
            s.repeating[i] = s.repeats[i] = 0.0
            continue
        s.repeating[i] += k.dt
        belief, place = s.without[i], MEASURED[i]
        predicted(o, past.without[i] if s.repeats[i] > 0 else past.belief, 0, k.Q_rest, belief)
        variance = belief.covariance[place, place] + s.variances[i]
        if s.repeating[i] > k.tolerance and (o.work.taken[i] - belief.xi[place]) ** 2 > DOUBT**2 * variance:
            return False
        for sensor in range(3):
            if s.read[sensor] != past.read[sensor]:
                correct(o, belief, sensor)
        s.repeats[i] = 1.0
    return True


@inlined
def follow_friction(o: Sample) -> None:
    """Update the memory of the known friction by the angle: see `FrictionState.follow`."""
    s, before, now = o.now, floats(o.past_places.memory), floats(o.places.memory)
    nearest(o, s.belief)
    s.angle = followed(rubbing_in(floats(o.friction)), s.belief.xi[0], pressing(o), s.angle, before, now)


@inlined
def pressing(o: Sample) -> Pressed:
    """Return the loads on the sliding surfaces in the nearest state."""
    x = o.work.near
    found = muscles(x[0], x[1], x[2], x[3], floats(o.c))
    return Pressed(found[0] - found[1], x[2] + x[3], found[6])


@inlined
def rubbing(o: Sample) -> float:
    """Return the friction torque [N·m] in the nearest state."""
    friction, memory, total = rubbing_in(floats(o.friction)), floats(o.places.memory), 0.0
    if friction.kind == ABSENT:
        return 0.0
    for i in range(memory.size):
        total += friction.springs[i] * memory[i]
    return strength(friction, pressing(o)) * total


@inlined
def nearest(o: Sample, belief: Belief) -> None:
    """Fill in the nearest possible ξ (5,), and the nearest state (4,) for which the muscle models are valid."""
    k, w = o.known, o.work
    for i in range(SIZE):
        w.inside[i] = min(max(belief.xi[i], k.outer[0, i]), k.outer[1, i])
    for i in range(4):
        w.near[i] = min(max(w.inside[i], k.inner[0, i]), k.inner[1, i])


@inlined
def predicted(o: Sample, belief: Belief, k: int, noise: Array, target: Belief) -> None:
    """Set the `target` to the prediction of a `belief` for the next sample, with the k-th commands and the covariance
    `noise`: see `Filter`. Target and belief may be the same.
    """
    w, commands, rest = o.work, floats(o.places.commands), o.known.dead_band / 2
    nearest(o, belief)
    for i in range(2):
        e = commands[2 * k + i] - w.inside[2 + i]
        w.acting[i] = w.inside[2 + i] + e - min(max(e, -rest), rest)
    advance(o, w.inside[4] - rubbing(o))
    for i in range(4):
        x = w.S[i, 5]
        for j in range(4):
            x += w.S[i, j] * (w.inside[j] - w.near[j])
        target.xi[i] = x
    target.xi[4] = w.inside[4]
    propagate(o, belief.covariance, noise, target.covariance)


@inlined
def advance(o: Sample, d: float) -> None:
    """Store in S (5, 6) the Jacobian by ξ of a sample from the nearest state, and next to it the state at its end.

    The slope K (4, 6) of each Runge–Kutta stage is taken at S + a K, and b K is added to the total.
    """
    w, c, h = o.work, floats(o.c), o.known.h
    S, K, at, total = w.S, w.slope, w.at, w.total
    for i in range(5):
        for j in range(5):
            S[i, j] = 1.0 if i == j else 0.0
    for i in range(4):
        S[i, 5] = w.near[i]
    for n in range(4 * o.known.substeps):
        a, b = h * NODES[n % 4], h * SHARES[n % 4]
        for i in range(4):
            for j in range(6):
                if n % 4 == 0:
                    K[i, j] = total[i, j] = 0.0
                at[i, j] = S[i, j] + a * K[i, j]
        f = rate_slopes(at[0, 5], at[1, 5], at[2, 5], at[3, 5], w.acting[0], w.acting[1], d, c)
        for j in range(5):
            s0, s1, s2, s3 = at[0, j], at[1, j], at[2, j], at[3, j]
            K[0, j] = f[4] * s0 + f[8] * s1 + f[12] * s2 + f[16] * s3
            K[1, j] = f[5] * s0 + f[9] * s1 + f[13] * s2 + f[17] * s3
            K[2, j] = f[6] * s0 + f[10] * s1 + f[14] * s2 + f[18] * s3
            K[3, j] = f[7] * s0 + f[11] * s1 + f[15] * s2 + f[19] * s3
        for i in range(4):
            K[i, 4] += f[20 + i]
            K[i, 5] = f[i]
            for j in range(6):
                total[i, j] += b * K[i, j]
                if n % 4 == 3:
                    S[i, j] += total[i, j]


@inlined
def propagate(o: Sample, P: Array, noise: Array, target: Array) -> None:
    """Set the `target` (5, 5) to A P Aᵀ + Q, A being in S."""
    A, product = o.work.S, o.work.product
    for i in range(SIZE):
        for j in range(SIZE):
            total = 0.0
            for m in range(SIZE):
                total += A[i, m] * P[m, j]
            product[i, j] = total
    for i in range(SIZE):
        for j in range(SIZE):
            total = noise[i, j]
            for m in range(SIZE):
                total += product[i, m] * A[j, m]
            target[i, j] = total


@inlined
def correct(o: Sample, belief: Belief, sensor: int) -> None:
    """Correct a belief by one reading: (1 - K C) P (1 - K C)ᵀ + K R Kᵀ, K = P Cᵀ/(C P Cᵀ + R).

    Corrections one after the other are equal to a joint one, because the noise is not correlated.
    """
    P, place, R = belief.covariance, MEASURED[sensor], o.now.variances[sensor]
    gain, product = o.work.gain, o.work.product
    variance = P[place, place] + R
    gap = o.work.taken[sensor] - belief.xi[place]
    for i in range(SIZE):
        gain[i] = P[i, place] / variance
        belief.xi[i] += gain[i] * gap
    for i in range(SIZE):
        for j in range(SIZE):
            less = P[i, j] - gain[i] * P[place, j]
            product[i, j] = R / variance * P[place, j] if i == place else less
    for i in range(SIZE):
        column = product[i, place]
        for j in range(SIZE):
            less = R / variance * column if j == place else product[i, j] - column * gain[j]
            P[i, j] = less + gain[i] * R * gain[j]


@inlined
def sound(belief: Belief) -> bool:
    """Return whether a belief is finite, and no variance negative."""
    good = True
    for i in range(SIZE):
        good = good and np.isfinite(belief.xi[i]) and belief.covariance[i, i] > 0
        for j in range(SIZE):
            good = good and np.isfinite(belief.covariance[i, j])
    return bool(good)


# --- the diagnosis: `mpc.observer.diagnosis` --------------------------------------------------------------------------


@inlined
def diagnosed(o: Sample) -> int:
    """Update the diagnosis; return 1, or 2 if a suspicion has begun or ended; 0 if numbers are out of range."""
    k, s, xi, v = o.known, o.now, o.now.belief.xi, floats(o.places.commands)
    found = muscles(xi[0], xi[1], xi[2], xi[3], floats(o.c))
    for i in range(6):
        if not np.isfinite(found[i]):
            return 0
    rest, dt = k.dead_band / 2, k.dt
    one = Sound(k.quick[0], k.slow[0], rest, dt, k.sigma, k.seen)
    two = Sound(k.quick[1], k.slow[1], rest, dt, k.sigma, k.seen)
    parts = (floats(o.places.one), floats(o.places.two)), floats(o.places.torque), (floats(o.places.loop),)
    read, moved = (s.read[1], s.read[2]), s.read[0] != s.last
    acting = v[0] + s.offset[0], v[1] + s.offset[1]
    known = Known((one, two), (k.usual,), (k.inertia,))
    follow(*parts, known, s.t, read, acting, (xi[1],), (xi[4],), found, moved)
    for i in range(2):
        s.large[i] = large_since(s.large[i], s.offset[i], s.t)
    for i in range(3):
        if s.lost[i] > 0:
            s.said[i] = s.read[i]
            s.lost[i], little = less_lost(s.lost[i], dt, k.tolerance)
            if little:
                s.found[i] = 0.0
    s.t, s.last = s.t + dt, s.read[0]
    return 2 if suspicious(o) else 1


@inlined
def suspicious(o: Sample) -> bool:
    """Return whether any input of the joint's health differs from that of the previous sample."""
    changed = False
    for i in range(3):
        changed = changed or o.now.found[i] != o.past.found[i]
    for i in range(2):
        before = steps(o.past.large[i], o.past.offset[i])
        changed = changed or steps(o.now.large[i], o.now.offset[i]) != before
    torque, torque_before = floats(o.places.torque), floats(o.past_places.torque)
    suspected, broken, loaded = pressure_diagnosis.SUSPECTED, torque_diagnosis.BROKEN, torque_diagnosis.LOADED
    changed = changed or floats(o.places.one)[suspected] != floats(o.past_places.one)[suspected]
    changed = changed or floats(o.places.two)[suspected] != floats(o.past_places.two)[suspected]
    changed = changed or torque[broken] != torque_before[broken]
    loop, loop_before = floats(o.places.loop)[ringing.SINCE], floats(o.past_places.loop)[ringing.SINCE]
    return bool(changed or another(torque[loaded], torque_before[loaded]) or another(loop, loop_before))


@inlined
def another(now: float, before: float) -> bool:
    """Return whether two times differ; NaN stands for no time."""
    return bool(now != before and (now == now or before == before))
