"""The template lets a controller drive a plant, sample by sample, as long as nothing out of the ordinary happens.

`mpc.trials.many.driving` puts modules in the place of the lines below that begin with `FORMULAS`: `process` has the
plant under test, `observer` the compiled sample of the observer, `joint` the compiled step of the controller's plant,
and `told` what is known of the plant beyond it: `torque` (x, memory) ↦ T_f and `moved` (x, memory, motion) ↦ memory of
friction in contact at x, `turning` x ↦ the isobaric stiffness and ∂T/∂P.

What is ordinary: every reading is believed, all problems are solved and proved, the state is measured. Of anything else
the loop says that it happened, and the run is left to `simulate`.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.jit import compiled, inlined
from mpc.model.compensation import JITTER, SOFT
from mpc.observer.compiled.layout import SIZE
from mpc.tracking.compiled.commands import excess, limit
from mpc.tracking.compiled.records import given_in
from mpc.tracking.compiled.sample.calls import settle_at
from mpc.tracking.compiled.sample.layout import known_in, made_in
from mpc.tracking.preview import CORRECTED
from mpc.tracking.rest import MOST as MOST_CORRECTED
from mpc.tracking.rest import NOISE
from mpc.trials.many import rest
from mpc.trials.many.records import Answers, Known, Memory, Plant, Step

FORMULAS: Any = None
process = observer = joint = told = FORMULAS

OPTIMAL, RESTING, QP, ALLOCATION = 0, 9, 0, 3  # of `PlanStatus` and `Rung`


@compiled
def driven(
    first: int, plant: Plant, observed: int, known: Known, step: Step, m: Memory, theta: Array, K: Array,
    answers: Answers,
) -> int:  # fmt: skip
    """Go on from the sample `first` to the last, and return at which one something was out of the ordinary; M if none.

    `theta`, `K` (M + ahead,) are the reference, whose last sample is held; `observed` is the address of the
    observer's `Sample`.
    """
    N, M, y = len(m.u), len(answers.u), np.empty(4)
    ahead, sample = N + known.delay, observer.sample_at(observed)
    xi = sample.now.belief.xi
    for k in range(first, M):
        process.read(plant.sensors, plant.full, plant.noise[k], y)
        if not observer.filtered(sample, y[0], y[2], y[3], answers.u[k - 1, 0], answers.u[k - 1, 1]):
            return k
        for i in range(SIZE):
            answers.estimate[k, i] = xi[i]
        if not answered(known, step, m, xi, theta[k : k + ahead + 1], K[k : k + ahead + 1], k, answers):
            return k
        plant.waiting[-1, 0], plant.waiting[-1, 1] = answers.u[k, 0], answers.u[k, 1]
        process.advance(plant.c, plant.durations, plant.substeps, plant.full, plant.waiting, plant.torques[k])
        for i in range(4):
            answers.x[k + 1, i] = plant.full[i]
    return M


# --- the controller ---------------------------------------------------------------------------------------------------


@inlined
def answered(known: Known, step: Step, m: Memory, xi: Array, theta: Array, K: Array, k: int, answers: Answers) -> bool:
    """Make and record the plan of the sample `k` from `xi` (5,) and the preview; return whether that was ordinary."""
    for i in range(4):
        if not known.lower[i] <= xi[i] <= known.upper[i]:
            return False
    delay, expected = known.delay, m.expected[0]
    torques, start = np.empty(theta.size), np.empty(4)
    if not friction_ahead(known, m, xi, theta, torques):
        return False
    for j in range(theta.size):
        torques[j] = xi[4] - torques[j]
    for i in range(4):
        start[i] = xi[i]
    if delay > 0:
        way, u = np.empty((delay + 1, 4)), m.waiting / BAR
        joint.motion(step.c, start, u, torques[:delay], step.h, step.substeps, way)
        m.expected[0] = way[1, 0]
        for i in range(4):
            start[i] = way[delay, i]
    held = known.rests and rests(known, m, xi, theta[delay:], K[delay:], expected)
    feed, moved, fixed = given_in(step.given).reference, answers.moved[k], (step.c, step.p, known_in(step.known))
    if not joint.feed_forward(*fixed, step.slopes, theta[delay:], K[delay:], torques[delay:], feed, moved):
        return False
    u_star = feed.u
    ahead = approached(known, step, m, start, torques[delay:], k, answers) if held else False
    if (held and not ahead) or (not held and not optimised(known, step, m, start, torques[delay:], u_star, k, answers)):
        return False
    m.u_star[0], m.u_star[1] = u_star[0, 0], u_star[0, 1]
    return True


@inlined
def friction_ahead(known: Known, m: Memory, x: Array, theta: Array, torques: Array) -> bool:
    """Fill in the friction torque [N·m] along the preview; return whether it is finite."""
    torques[:] = 0.0
    if known.frictionless:
        return True
    to, T_f, at, moved = np.empty(1), np.empty(1), np.empty(m.memory.size), np.empty(m.memory.size)
    contact = x[:4]
    to[0] = x[0] - m.theta[0]
    if abs(to[0]) > JITTER:
        m.theta[0] = x[0]
    else:
        to[0] = 0.0
    told.moved(contact, m.memory, to, known.c, at)
    m.memory[:] = at
    last = theta[0] + (0.0 if m.rest[rest.RINGS] > 0 else CORRECTED) * (x[0] - theta[0])
    for j in range(theta.size):
        if j > 0:
            to[0] = theta[j] - last
            last = theta[j]
            told.moved(contact, at, to, known.c, moved)
            at[:] = moved
        told.torque(contact, at, known.c, T_f)
        if not np.isfinite(T_f[0]):
            return False
        torques[j] = T_f[0]
    return True


@inlined
def rests(known: Known, m: Memory, x: Array, theta: Array, K: Array, expected: float) -> bool:
    """Return whether pressures are held, those in `m.p`."""
    if not rest.constant(m, known.resting, theta, K) or rest.pushed(m, x[0], expected):
        rest.begin(m)
        return False
    m.rest[rest.SAMPLES] += 1
    if rest.quarter_ended(m, x):
        if m.rest[rest.RESTS] > 0:
            wanted, mean, swings = rest.correction(m, known.resting)
            if wanted:
                turn(known, m, mean, swings)
        elif m.rest[rest.COUNTED] == rest.QUARTERS:
            rest.check(m, known.resting)
    return bool(m.rest[rest.RESTS] > 0)


@inlined
def turn(known: Known, m: Memory, mean: float, swings: bool) -> None:
    """Correct the mean error [rad]."""
    x, o, s = np.zeros(4), np.empty(3), m.rest
    x[0], x[2], x[3] = m.reference[0] + mean, m.p[0], m.p[1]
    told.turning(x, known.c, o)
    K, side = o[0], s[rest.SIDE]
    if not K > 0:
        return
    torque = -mean * (K if swings or s[rest.RINGS] > 0 else rest.gain(m, mean, K))
    for i in range(2):
        change = min(side * torque / o[1 + i], MOST_CORRECTED)
        if change > 0:
            m.p[i] = side * (max(side * m.p[i], side * rest.pressure(m, rest.HALF, i) - NOISE) + change)
    s[rest.SINCE], s[rest.TORQUE], s[rest.ERROR], s[rest.FREE] = 0.0, torque, mean, abs(torque) / K


@inlined
def optimised(
    known: Known, step: Step, m: Memory, start: Array, d: Array, u_star: Array, k: int, answers: Answers
) -> bool:
    """Record the answer of the QP; return whether there is one."""
    given, N = given_in(step.given), m.u.shape[0]
    for j in range(N - 1):
        given.u[j, 0], given.u[j, 1] = m.u[j + 1, 0], m.u[j + 1, 1]
    for i in range(2):
        given.u[N - 1, i] = m.u[N - 1, i] + (u_star[N - 1, i] - u_star[N - 2, i])
        given.last[0, i], given.last[1, i] = m.u[0, i], m.u_star[i]
    given.x[:], given.d[:] = start, d[:N]
    before = step.guess.copy()
    for j in range(before.size):
        step.guess[j] = before[step.shifted[j]]
    fixed = step.c, step.h, step.substeps, step.numbers, step.starts, step.given, step.buffer
    joint.linearise(*fixed)
    solved, _ = settle_at(step.settle, step.numbers, step.starts, step.given, step.buffer, step.guess, step.z)
    if not solved:
        return False
    made = made_in(step.out)
    finite = joint.rollout(*fixed, step.z, made)
    record(known, m, made.u, made.x, made.F, 0.0, k, answers)
    answers.rung[k], answers.status[k] = QP, OPTIMAL
    return bool(finite)


@inlined
def approached(known: Known, step: Step, m: Memory, start: Array, d: Array, k: int, answers: Answers) -> bool:
    """Record the approach to the pressures that are held; return whether its motion is finite."""
    N, (low, high), most = m.u.shape[0], (known.limits[0], known.limits[1]), known.limits[2]
    u, x, F, good = np.empty((N, 2)), np.empty((N + 1, 4)), np.empty((N + 1, 2)), True
    u[:] = m.p
    limit(low, high, most, m.u[0], 1.0, u)
    joint.motion(step.c, start, u / BAR, d[:N], step.h, step.substeps, x)
    for j in range(N + 1):
        _, F[j, 0], F[j, 1] = joint.outputs(x[j, 0], x[j, 1], x[j, 2], x[j, 3], step.c)
        good = good and np.isfinite(F[j, 0]) and np.isfinite(F[j, 1]) and np.isfinite(x[j]).all()
    record(known, m, u, x, F, m.rest[rest.SIDE], k, answers)
    answers.rung[k], answers.status[k] = ALLOCATION, RESTING
    return good


@inlined
def record(known: Known, m: Memory, u: Array, x: Array, F: Array, side: float, k: int, answers: Answers) -> None:
    """Record and remember what is sent for the motion `x` under `u` (N, 2)."""
    low, high, most, left, right, least = known.limits
    m.u[:] = u
    for j in range(known.delay - 1):
        m.waiting[j] = m.waiting[j + 1]
    if known.delay > 0:
        m.waiting[-1] = u[0]
    else:
        m.expected[0] = x[1, 0]
    sent, beyond = u[:1].copy(), np.empty(2)
    if known.dead_band > 0:
        for i in range(2):
            edge = side if side != 0.0 else np.tanh((sent[0, i] - x[0, 2 + i]) / SOFT)
            sent[0, i] += known.dead_band / 2 * edge
        limit(low, high, most, m.sent, 1.0, sent)
    for i in range(2):
        m.sent[i] = answers.u[k, i] = sent[0, i]
    excess(left, right, least, x, F, beyond)
    answers.slack[k], answers.slack_force[k] = beyond[0], beyond[1]
