"""The template lets a controller drive a plant, sample by sample, as long as nothing out of the ordinary happens.

`mpc.trials.many.driving` puts modules in the place of the lines below that begin with `FORMULAS`: `process` has the
plant under test, `observer` the compiled sample of the observer, `joint` the compiled step of the controller, and
`told` the function `turning` x ↦ the isobaric stiffness and ∂T/∂P.

A sample is ordinary if every reading is believed, all problems are solved and proved, and the state is measured. The
loop returns the first sample that is not, and the run is left to `simulate`.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.model.compiled_friction import rubbing_in
from mpc.observer.compiled.layout import SIZE
from mpc.tracking.compiled.commands import excess, limit
from mpc.tracking.compiled.records import given_in, setting_in
from mpc.tracking.compiled.sample.layout import asked_in, inputs_at, known_in, made_in, plan_length, state_in
from mpc.tracking.compiled.sample.stages import WHOLE, ask, remember
from mpc.tracking.compiled.structured_qp.certificate import finite
from mpc.tracking.preview import CORRECTED
from mpc.tracking.rest import MOST as MOST_CORRECTED
from mpc.tracking.rest import NOISE
from mpc.trials.many import rest
from mpc.trials.many.records import Answers, Plant, Resting

FORMULAS: Any = None
process = observer = joint = told = FORMULAS

OPTIMAL, RESTING, QP, ALLOCATION = 0, 9, 0, 3  # of `PlanStatus` and `Rung`


@compiled
def driven(
    first: int, plant: Plant, observed: int, table: int, m: Resting, both: Array, theta: Array, K: Array,
    answers: Answers,
) -> int:  # fmt: skip
    """Go on from the sample `first` to the last, and return at which one something was out of the ordinary; M if none.

    `observed` and `table` are the addresses of the observer's `Sample` and of the step's `Inputs`, `both` (2, …) is
    what the last sample made and room for the next. `theta`, `K` (M + ahead,) are the reference.
    """
    i, M, x, y = inputs_at(table), len(answers.u), np.empty(4), np.empty(4)
    known, ahead, N = known_in(i.known), asked_in(i.asked).theta.size, given_in(i.given).u.shape[0]
    sample, what = observer.sample_at(observed), np.int64(WHOLE)  # for a constant numba would compile the step anew
    xi, last, out = sample.work.ahead.xi, both[0], both[1]
    for k in range(first, M):
        process.read(plant.sensors, plant.full, plant.angles, plant.noise[k], y)
        if not observer.filtered(sample, y[0], y[2], y[3], answers.u[k - 1, 0], answers.u[k - 1, 1]):
            return k
        for j in range(SIZE):
            answers.estimate[k, j] = xi[j]
        for j in range(4):
            x[j] = xi[j]
        now, then = theta[k : k + ahead : 1], K[k : k + ahead : 1]
        known.corrected[0] = 0.0 if m.rest[rest.RINGS] > 0 else CORRECTED
        if m.worthwhile and rests(m, x, now[ahead - N - 1 :], then[ahead - N - 1 :], expected_in(table, last)):
            answers.rung[k], answers.status[k] = ALLOCATION, RESTING
            done = approached(table, m, last, out, x, now, then, xi[4])
        else:
            answers.rung[k], answers.status[k] = QP, OPTIMAL
            done = joint.step(what, table, last, out, x[::1], now, then, xi[4])
        if not done:
            return k
        made = made_in(out[: plan_length(N)])
        for j in range(2):
            answers.u[k, j] = plant.waiting[-1, j] = made.sent[0, j]
        answers.slack[k], answers.slack_force[k] = made.slack[0], made.slack[1]
        for j in range(3):
            answers.moved[k, j] = made.moved[j]
        moving = plant.full, plant.waiting, plant.angles
        process.advance(plant.c, plant.durations, plant.substeps, *moving, plant.torques[k])
        for j in range(4):
            answers.x[k + 1, j] = plant.full[j]
        last, out = out, last
    return M


@inlined
def expected_in(table: int, last: Array) -> float:
    """Return the angle [rad] that the sample before predicted for this one."""
    i = inputs_at(table)
    N, n = given_in(i.given).u.shape[0], rubbing_in(i.friction).springs.size
    size, delay = plan_length(N), asked_in(i.asked).theta.size - N - 1
    return float(state_in(last[size:], made_in(last[:size]).u, n, delay).expected[0])


@inlined
def rests(m: Resting, x: Array, theta: Array, K: Array, expected: float) -> bool:
    """Return whether pressures are held, those in `m.p`."""
    if not rest.constant(m, theta, K) or rest.pushed(m, x[0], expected):
        rest.begin(m)
        return False
    m.rest[rest.SAMPLES] += 1
    if rest.quarter_ended(m, x):
        if m.rest[rest.RESTS] > 0:
            wanted, mean, swings = rest.correction(m)
            if wanted:
                turn(m, mean, swings)
        elif m.rest[rest.COUNTED] == rest.QUARTERS:
            rest.check(m)
    return bool(m.rest[rest.RESTS] > 0)


@inlined
def turn(m: Resting, mean: float, swings: bool) -> None:
    """Correct the mean error [rad]."""
    x, o, s = np.zeros(4), np.empty(3), m.rest
    x[0], x[2], x[3] = m.reference[0] + mean, m.p[0], m.p[1]
    told.turning(x, m.c, o)
    K, side = o[0], s[rest.SIDE]
    if not K > 0:
        return
    torque = -mean * (K if swings or s[rest.RINGS] > 0 else rest.gain(m, mean, K))
    for i in range(2):
        change = min(side * torque / o[1 + i], MOST_CORRECTED)
        if change > 0:
            play = min(side * rest.pressure(m, rest.HALF, i), side * m.began[i]) - NOISE
            m.p[i] = m.began[i] = side * (max(side * m.p[i], play) + change)
    s[rest.SINCE], s[rest.TORQUE], s[rest.ERROR], s[rest.FREE] = 0.0, torque, mean, abs(torque) / K


@inlined
def approached(table: int, m: Resting, last: Array, out: Array, x: Array, theta: Array, K: Array, d: float) -> bool:
    """Make the approach to the pressures that are held, as `joint.step` makes a plan; return whether it is finite."""
    i = inputs_at(table)
    known, want, now, f = known_in(i.known), asked_in(i.asked), given_in(i.given), rubbing_in(i.friction)
    N, bounds = now.u.shape[0], setting_in(i.numbers, i.starts).bounds
    delay, n, size = want.theta.size - N - 1, f.springs.size, plan_length(N)
    was, made = made_in(last[:size]), made_in(out[:size])
    before, after = state_in(last[size:], was.u, n, delay), state_in(out[size:], made.u, n, delay)
    path, waiting = i.work[: 4 * (delay + 1)].reshape(delay + 1, 4), i.work[4 * (delay + 1) :].reshape(delay, 2)
    ask(x, theta, K, d, want)
    done, angle = joint.foreseen(i.c, known, f, want, before, after.memory, waiting, path)
    previews = want.theta[delay:], want.K[delay:], want.torques[delay:]
    slopes = i.slopes.reshape(2, N + 1, N + 1)
    if not (done and joint.feed_forward(i.c, i.p, known, slopes, *previews, now.reference, made.moved)):
        return False
    half, side = known.dead_band / 2 / BAR, m.rest[rest.SIDE]
    for k in range(N):
        for j in range(2):
            made.u[k, j] = m.p[j] / BAR
    limit(bounds.low, bounds.high, bounds.step, before.u[0], BAR, made.u)
    joint.motion(i.c, path[delay], made.u, previews[2], known.h, known.substeps, made.x)
    for k in range(N + 1):
        s = made.x[k]
        made.K[k], made.F[k, 0], made.F[k, 1] = joint.outputs(s[0], s[1], s[2], s[3], i.c)
    excess(bounds.left, bounds.right, bounds.min_force, made.x, made.F, made.slack)
    for k in range(N):
        for j in range(2):
            made.sent[k, j] = made.u[k, j] + side * half
    if half > 0:
        limit(bounds.low, bounds.high, bounds.step, before.sent, BAR, made.sent)
    for k in range(N):
        for j in range(2):
            made.u[k, j], made.sent[k, j] = BAR * made.u[k, j], BAR * made.sent[k, j]
    remember(want, now, path, angle, made, before, after)
    return finite(made.x) and finite(made.F)
