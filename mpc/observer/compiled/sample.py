"""Template of the estimate of an ordinary sample, of n joints and m muscles.

`mpc.observer.compiled.module` replaces the sizes n, m = 1, 2 and the lines below that begin with `FORMULAS` by those of
a plant: `advance`, the motion over a sample (`mpc.observer.compiled.joint`, `arm`), functions that fill arrays,

    pulls     x ↦ those of `mpc.observer.pulling`
    pressing  x ↦ the loads (n, 3) of `mpc.model.friction.contact`

and tuples of the arrays of the diagnosis and of its constants. The numbers of the formulas are the piece c.

In an ordinary sample every reading is believed at once, as was the last one of each sensor; a sensor may repeat itself
as long as it is not doubted for that. The readable observer estimates all other samples.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.addresses import floats, opener
from mpc.codegen.jit import compiled, inlined
from mpc.model.compiled_friction import ABSENT, followed, rubbing_in, strength
from mpc.model.friction.contact import Loads
from mpc.observer import pressure_diagnosis, ringing, torque_diagnosis
from mpc.observer.compiled.layout import Belief, Places, Sample
from mpc.observer.diagnosis import Known, follow, large_since, less_lost, steps
from mpc.observer.filter import SETTLED
from mpc.observer.gating import DOUBT, NEAR_A_TURN, ROUGH, ROUNDING, SIGMAS, TURN

FORMULAS: Any = None
advance = pulls = pressing = regulators = sounds = loops = FORMULAS

n, m = 1, 2
STATES, SIZE, SENSORS = 2 * n + m, 3 * n + m, n + m
sample_at = opener(Sample, n=n, m=m)


@compiled
def estimate(sample: int, y: Array, u: Array) -> int:
    """Estimate from readings `y` (2n + m,) and the last commands `u` (m,) sent, in the `Sample` at this address.

    Return 1, or 2 if the health has to be updated; return 0 and leave the state unchanged if the sample is not
    ordinary.
    """
    answer, o = 0, sample_at(sample)
    if filtered(o, y, u):
        answer = diagnosed(o)
    if answer == 0:
        copy_state(o.past_places, o.places)
    else:
        o.now.samples += 1
    return answer


@inlined
def newest(o: Sample) -> Array:
    """Return the present estimate (3n + m,), a view."""
    return o.work.ahead.xi


@inlined
def copy_state(one: Places, other: Places) -> None:
    """Copy one state to the other."""
    state, tail, to_state, to_tail = floats(one.state), floats(one.tail), floats(other.state), floats(other.tail)
    for i in range(state.size):
        to_state[i] = state[i]
    for i in range(tail.size):
        to_tail[i] = tail[i]


@inlined
def place_of(sensor: int) -> int:
    """Return the measured entry of ξ."""
    return sensor if sensor < n else sensor + n


# --- the filter: `mpc.observer.kalman` and `mpc.observer.filter` ------------------------------------------------------


@inlined
def filtered(o: Sample, y: Array, u: Array) -> bool:
    """Estimate from the readings `y` (2n + m,) and the last commands `u` (m,); return whether the sample was ordinary.

    If not, only the past state is unchanged.
    """
    copy_state(o.places, o.past_places)
    k, s, w, commands, held = o.known, o.now, o.work, floats(o.places.commands), floats(o.places.held)
    for j in range(m):
        if not k.outer[0, 2 * n + j] <= u[j] <= k.outer[1, 2 * n + j]:
            return False
    for i in range(commands.size - m):
        commands[i] = commands[i + m]
    for i in range(held.size - m):
        held[i] = held[i + m]
    for j in range(m):
        commands[commands.size - m + j], held[held.size - m + j] = u[j], y[2 * n + j]
        s.read[n + j], w.taken[n + j] = held[j], held[j] - s.offset[j]
    for i in range(n):
        s.read[i] = w.taken[i] = y[i]
        change = abs(y[i] - o.past.read[i])
        if ROUNDING < change < s.step[i]:  # of an encoder
            rough = max(k.theta_noise, change / np.sqrt(12.0))
            s.step[i], s.variances[i], s.floor[i] = change, rough * rough, max(k.theta_floor[i], ROUGH * rough)
    follow_friction(o)
    predicted(o, o.past.belief, 0, k.Q, s.belief)
    move_apart(o)
    if not (sound(s.belief) and believed(o) and not_frozen(o)):
        return False
    for j in range(m):
        P = s.belief.xi[2 * n + j]
        if abs(commands[j] - P) <= SETTLED:
            moved = s.offset[j] + k.learning * (w.taken[n + j] - P)
            s.offset[j] = min(max(moved, -k.most_offset), k.most_offset)
    for sensor in range(SENSORS):
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
    for k in range(1, floats(o.places.held).size // m):
        predicted(o, w.ahead, k, o.known.Q, w.ahead)
    return sound(w.ahead)


@inlined
def move_apart(o: Sample) -> None:
    """Update the distances of quick and slow regulators from the model's after its prediction: see `Filter.apart`."""
    k, w, apart = o.known, o.work, o.now.apart
    for j in range(m):
        e = w.acting[j] - w.inside[2 * n + j]
        for i in range(2):
            apart[i, j] += k.shares[i, j] * (e - apart[i, j]) - k.share[j] * e


@inlined
def believed(o: Sample) -> bool:
    """Return whether all readings are near the expected ones, and no angle has to be unwrapped."""
    k, s, belief, taken = o.known, o.now, o.now.belief, o.work.taken
    near = True
    for i in range(n):
        near = near and abs(belief.xi[i] - taken[i]) <= TURN / 2 - NEAR_A_TURN
    for i in range(SENSORS):
        read = taken[i]
        near = near and k.possible[0, i] <= read <= k.possible[1, i]
        least = most = foreseen(o, belief, i)
        if i >= n:
            quick, slow = s.apart[0, i - n], s.apart[1, i - n]
            least, most = least + min(quick, slow, 0.0), most + max(quick, slow, 0.0)
        width = max(SIGMAS * np.sqrt(variance(o, belief, i)), s.floor[i])
        near = near and abs(read - min(max(read, least), most)) <= width
    return bool(near)


@inlined
def not_frozen(o: Sample) -> bool:
    """Update the beliefs without sensors that repeat themselves; return whether none of them is frozen."""
    k, s, past = o.known, o.now, o.past
    for i in range(SENSORS):
        if s.read[i] != past.read[i]:
            s.repeating[i] = s.repeats[i] = 0.0
            continue
        s.repeating[i] += k.dt
        belief = s.without[i]
        predicted(o, past.without[i] if s.repeats[i] > 0 else past.belief, 0, k.Q_rest[i], belief)
        off = o.work.taken[i] - foreseen(o, belief, i)
        if s.repeating[i] > k.tolerance and off**2 > DOUBT**2 * variance(o, belief, i):
            return False
        for sensor in range(SENSORS):
            if s.read[sensor] != past.read[sensor]:
                correct(o, belief, sensor)
        s.repeats[i] = 1.0
    return True


@inlined
def follow_friction(o: Sample) -> None:
    """Update the memories of the known friction by the angles: see `FrictionState.follow`."""
    s = o.now
    nearest(o, s.belief)
    press(o)
    for i in range(n):
        before, now = floats(o.past_places.memories[i]), floats(o.places.memories[i])
        s.angle[i] = followed(
            rubbing_in(floats(o.frictions[i])), s.belief.xi[i], pressed(o, i), s.angle[i], before, now
        )


@inlined
def press(o: Sample) -> None:
    """Fill in the loads on the sliding surfaces in the nearest state, if there is friction."""
    rubs = False
    for i in range(n):
        rubs = rubs or rubbing_in(floats(o.frictions[i])).kind != ABSENT
    if rubs:
        pressing(o.work.near, floats(o.c), o.work.loads.reshape(-1))


@inlined
def pressed(o: Sample, i: int) -> Loads:
    """Return the loads at joint `i`, as filled in."""
    return Loads(o.work.loads[i, 0], o.work.loads[i, 1], o.work.loads[i, 2])


@inlined
def rubbing(o: Sample, i: int) -> float:
    """Return the friction torque [N·m] at joint `i` in the nearest state."""
    friction, memory, total = rubbing_in(floats(o.frictions[i])), floats(o.places.memories[i]), 0.0
    if friction.kind == ABSENT:
        return 0.0
    for j in range(memory.size):
        total += friction.springs[j] * memory[j]
    return strength(friction, pressed(o, i)) * total


@inlined
def nearest(o: Sample, belief: Belief) -> None:
    """Fill in the nearest possible ξ, and the nearest state (2n + m,) for which the muscle models are valid."""
    k, w = o.known, o.work
    for i in range(SIZE):
        w.inside[i] = min(max(belief.xi[i], k.outer[0, i]), k.outer[1, i])
    for i in range(STATES):
        w.near[i] = min(max(w.inside[i], k.inner[0, i]), k.inner[1, i])


@inlined
def predicted(o: Sample, belief: Belief, k: int, noise: Array, target: Belief) -> None:
    """Set the `target` to the prediction of a `belief` for the next sample, with the k-th commands and the covariance
    `noise`: see `Filter`. Target and belief may be the same.
    """
    w, commands, rest, reach = o.work, floats(o.places.commands), o.known.dead_band / 2, o.known.reach
    nearest(o, belief)
    press(o)
    for j in range(m):
        P = w.inside[2 * n + j]
        e = commands[m * k + j] - P
        w.acting[j] = P + min(max(e - min(max(e, -rest), rest), -reach[1, j]), reach[0, j])
    for i in range(n):
        w.torque[i] = w.inside[STATES + i] - rubbing(o, i)
    advance(o)
    for i in range(STATES):
        x = w.S[i, SIZE]
        for j in range(STATES):
            x += w.S[i, j] * (w.inside[j] - w.near[j])
        target.xi[i] = x
    for i in range(STATES, SIZE):
        target.xi[i] = w.inside[i]
        for j in range(SIZE):
            w.S[i, j] = 1.0 if i == j else 0.0
    propagate(o, belief.covariance, noise, target.covariance)


@inlined
def propagate(o: Sample, P: Array, noise: Array, target: Array) -> None:
    """Set the `target` to A P Aᵀ + Q, A being in S."""
    A, product = o.work.S, o.work.product
    for i in range(SIZE):
        for j in range(SIZE):
            total = 0.0
            for l in range(SIZE):  # noqa: E741
                total += A[i, l] * P[l, j]
            product[i, j] = total
    for i in range(SIZE):
        for j in range(SIZE):
            total = noise[i, j]
            for l in range(SIZE):  # noqa: E741
                total += product[i, l] * A[j, l]
            target[i, j] = total


@inlined
def rate_of(sensor: int) -> int:
    """Return the entry of ξ that moves the reading of an angle; its own entry for another sensor."""
    return n + sensor if sensor < n else place_of(sensor)


@inlined
def age_of(o: Sample, sensor: int) -> float:
    """Return by how much [s] a reading is older than the belief."""
    return o.known.older if sensor < n else 0.0


@inlined
def foreseen(o: Sample, belief: Belief, sensor: int) -> float:
    """Return the expected reading, C ξ."""
    return float(belief.xi[place_of(sensor)] - age_of(o, sensor) * belief.xi[rate_of(sensor)])


@inlined
def variance(o: Sample, belief: Belief, sensor: int) -> float:
    """Return the variance C P Cᵀ + R of a reading."""
    P, place, rate, age = belief.covariance, place_of(sensor), rate_of(sensor), age_of(o, sensor)
    return float(P[place, place] - 2 * age * P[place, rate] + age * age * P[rate, rate] + o.now.variances[sensor])


@inlined
def correct(o: Sample, belief: Belief, sensor: int) -> None:
    """Correct a belief by one reading: (1 - K C) P (1 - K C)ᵀ + K R Kᵀ, K = P Cᵀ/(C P Cᵀ + R).

    Corrections one after the other are equal to a joint one, because the noise is not correlated. The row and the
    column of the reading's own entry are those of C (1 - K C) P = R/(C P Cᵀ + R) C P, without a difference.
    """
    P, place, rate, age = belief.covariance, place_of(sensor), rate_of(sensor), age_of(o, sensor)
    gain, product, R, total = o.work.gain, o.work.product, o.now.variances[sensor], variance(o, belief, sensor)
    gap = o.work.taken[sensor] - foreseen(o, belief, sensor)
    for i in range(SIZE):
        gain[i] = (P[i, place] - age * P[i, rate]) / total
        belief.xi[i] += gain[i] * gap
    for j in range(SIZE):
        CP = P[place, j] - age * P[rate, j]
        for i in range(SIZE):
            product[i, j] = P[i, j] - gain[i] * CP
        product[place, j] = R / total * CP + age * product[rate, j]
    for i in range(SIZE):
        column = product[i, place] - age * product[i, rate]
        for j in range(SIZE):
            P[i, j] = product[i, j] - column * gain[j] + gain[i] * R * gain[j]
        P[i, place] = R / total * column + age * (product[i, rate] - column * gain[rate]) + gain[i] * R * gain[place]


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
    k, s, w, xi, v = o.known, o.now, o.work, o.now.belief.xi, floats(o.places.commands)
    pulls(xi[:STATES], floats(o.c), w.pulls)
    for i in range(w.pulls.size):
        if not np.isfinite(w.pulls[i]):
            return 0
    moved = False
    for i in range(n):
        moved = moved or s.read[i] != s.last[i]
    for j in range(m):
        w.read_as[j] = v[j] + s.offset[j]
    known, torque = Known(sounds(k), k.usual, k.inertia), floats(o.places.parts[m])
    given = s.t, s.read[n:], w.read_as, xi[n : 2 * n], xi[STATES:], w.pulls, moved
    follow(regulators(o.places), torque, loops(o.places), known, *given)
    for j in range(m):
        s.large[j] = large_since(s.large[j], s.offset[j], s.t)
    for i in range(SENSORS):
        if s.lost[i] > 0:
            s.said[i] = s.read[i]
            s.lost[i], little = less_lost(s.lost[i], k.dt, k.tolerance)
            if little:
                s.found[i] = 0.0
    s.t += k.dt
    for i in range(n):
        s.last[i] = s.read[i]
    return 2 if suspicious(o) else 1


@inlined
def suspicious(o: Sample) -> bool:
    """Return whether any input of the health differs from that of the previous sample."""
    changed, now, past = False, o.places.parts, o.past_places.parts
    for i in range(SENSORS):
        changed = changed or o.now.found[i] != o.past.found[i]
    for j in range(m):
        before = steps(o.past.large[j], o.past.offset[j])
        changed = changed or steps(o.now.large[j], o.now.offset[j]) != before
        suspected = pressure_diagnosis.SUSPECTED
        changed = changed or floats(now[j])[suspected] != floats(past[j])[suspected]
    torque, torque_before = floats(now[m]), floats(past[m])
    changed = changed or torque[torque_diagnosis.BROKEN] != torque_before[torque_diagnosis.BROKEN]
    for i in range(n):
        loop, loop_before = floats(now[m + 1 + i])[ringing.SINCE], floats(past[m + 1 + i])[ringing.SINCE]
        loaded = torque_diagnosis.LOADED + i
        changed = changed or another(torque[loaded], torque_before[loaded]) or another(loop, loop_before)
    return bool(changed)


@inlined
def another(now: float, before: float) -> bool:
    """Return whether two times differ; NaN stands for no time."""
    return bool(now != before and (now == now or before == before))
