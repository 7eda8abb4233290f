"""Template of the parts of a step that depend on the joint: feed-forward, linearisation, and the rollout of an answer.

`mpc.tracking.compiled.module` replaces the lines below that begin with `FORMULAS` by the formulas of the joint, as
functions of scalars that return tuples: `rate` (x, u, d) ↦ x', `variational` (x, S, u, d) ↦ (x', S') with the `layout`
of `mpc.tracking.compiled.module`, `outputs` x ↦ y = (K, F1, F2), `output_slopes` x ↦ (y, its Jacobian by columns),
`expansion` x ↦ the pressures' fall as the muscles swell, `pressing` x ↦ the loads on the sliding surfaces
(pull, isobaric stiffness) and ∂T/∂P. `allocated` (θ, K, T) ↦ (P1, P2, T, K, …, sure) is the kernel of
`allocator.allocation` for the joint, if there is one. The array c holds the numbers of the formulas, p those of the
kernel.

The motion is that of `mpc.model.integration`, and its derivatives are those of the formula. Each formula occurs once
and is evaluated four times: writing it out would make the graph and the compilation four times as long.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.addresses import floats_at, seconds_at
from mpc.codegen.jit import assign, compiled_flat, inlined_flat
from mpc.model.compiled_friction import ABSENT, Rubbing, followed, less_friction, rubbing_in
from mpc.model.friction.contact import Pressed
from mpc.model.integration import NODES, SHARES
from mpc.model.plant import NU
from mpc.tracking.compiled.commands import cumulative, excess, finite, limit
from mpc.tracking.compiled.records import Bounds, Given, Indices, Path, Reference, given_in, path_in, setting_in
from mpc.tracking.compiled.sample.calls import settle_at
from mpc.tracking.compiled.sample.layout import (
    Asked,
    Known,
    Made,
    State,
    asked_in,
    inputs_at,
    known_in,
    made_in,
    memory_in,
    plan_length,
    state_in,
)
from mpc.tracking.compiled.sample.stages import (
    FEED,
    LINEARISE,
    ROLLOUT,
    WHOLE,
    ask,
    copy_set,
    hold,
    invert_dead_band,
    plausible,
    remember,
    shift_set,
    take,
    under_way,
)
from mpc.tracking.rest_memory import HELD, RESTS, RINGS, SIDE, THETA
from mpc.tracking.resting import begin, constant, decided, due, turn

FORMULAS: Any = None
rate = variational = begun = advanced = ended = outputs = output_slopes = expansion = pressing = allocated = FORMULAS


@compiled_flat
def step(what: int, table: int, last: Array, out: Array, x: Array, theta: Array, K: Array, d: float) -> bool:
    """Make the whole step or one part of it, and return whether that succeeded; if not, the guess is unchanged.

    `table` is the address of `Inputs`, `last` the result of the previous step, `out` that of this one
    (`mpc.tracking.compiled.sample.layout`). The parts are the feed-forward for `asked`, the linear model about `given`,
    and the rollout of `z`. The whole step uses the state `x`, previews `theta` and `K`, and the torque `d`. In a rest,
    held pressures replace the QP's solution.
    """
    i = inputs_at(table)
    began = seconds_at(i.clock, i.name)
    last, out = (
        floats_at(last.ctypes.data, last.size),
        floats_at(out.ctypes.data, out.size),
    )  # not reference-counted
    k, want, now, f = known_in(i.known), asked_in(i.asked), given_in(i.given), rubbing_in(i.friction)
    N, whole, done, rests, angle = now.u.shape[0], what == WHOLE, True, False, 0.0
    m, n, size = want.theta.size - N - 1, f.springs.size, plan_length(N)
    was, made = made_in(last[:size]), made_in(out[:size])
    before, after = state_in(last[size:], was.u, n, m), state_in(out[size:], made.u, n, m)
    path, waiting = i.work[: 4 * (m + 1)].reshape(m + 1, 4), i.work[4 * (m + 1) :].reshape(m, 2)
    copy_set(i.guess, i.kept)
    if whole:
        ask(x, theta, K, d, want)
        done, angle = foreseen(i.c, k, f, want, before, after.memory, waiting, path)
        rests = done and resting(i.c, k, want, before, after.rest)
    if done and (whole or what == FEED):
        previews, slopes = (want.theta[m:], want.K[m:], want.torques[m:]), i.slopes.reshape(2, N + 1, N + 1)
        done = feed_forward(i.c, i.p, k, slopes, *previews, now.reference, made.moved)
    fed = seconds_at(i.clock, i.name)
    if whole and done and not rests:
        take(path[m], want.torques[m:], before, now)
        shift_set(i.starts, i.kept, i.guess)
    if done and not rests and (whole or what == LINEARISE):
        linearise(i.c, k.h, k.substeps, i.numbers, i.starts, i.given, i.buffer)
    linearised = seconds_at(i.clock, i.name)
    bounds = setting_in(i.numbers, i.starts).bounds
    if whole and done and not rests:
        done, i.counted[0] = settle_at(i.settle, i.numbers, i.starts, i.given, i.buffer, i.guess, i.z)
    if done and (whole or what == ROLLOUT):
        start, torques = now.x, now.d
        if rests:
            hold(after.rest, bounds, before, made)
            start, torques = path[m], want.torques[m:]
        else:
            planned(bounds, i.starts, i.buffer, now, i.z, made)
        done = rollout(i.c, k.h, k.substeps, bounds, start, torques, made)
    if whole and done:
        invert_dead_band(k, bounds, want, before, after.rest[SIDE] if rests else 0.0, made)
        made.rests[0] = 1.0 if rests else 0.0
        remember(want, now, path, angle, made, before, after)
        made.times[0], made.times[1] = fed - began, linearised - fed
        made.times[2] = seconds_at(i.clock, i.name) - linearised
    elif whole:
        copy_set(i.kept, i.guess)
    return done


@inlined_flat
def foreseen(
    c: Array, known: Known, friction: Rubbing, asked: Asked, state: State, felt: Array, waiting: Array, path: Array
) -> tuple[bool, float]:
    """Fill in the predictions of `Preview.task`: the torques, the friction's memory `felt` (n,), and the motion `path`
    (m+1, 4) until a command acts; return whether the sample is an ordinary one, and the friction's angle.
    """
    x, d, angle = asked.x, asked.d[0], state.angle[0]
    if not plausible(known, asked):
        return False, angle
    if friction.kind == ABSENT:
        for k in range(asked.torques.size):
            asked.torques[k] = d
        assign(felt, state.memory)
    else:
        pulled, stiffness, _, _ = pressing(x[0], x[1], x[2], x[3], c)
        pressed = Pressed(pulled, x[2] + x[3], stiffness)
        angle = followed(friction, x[0], pressed, angle, state.memory, felt)
        corrected = 0.0 if known.rests and state.rest[RINGS] > 0 else known.corrected
        back = asked.theta[0] + corrected * (x[0] - asked.theta[0])
        less_friction(friction, felt, back, asked.theta, pressed, d, asked.torques)
    under_way(state, x, waiting)
    motion(c, x, waiting, asked.torques, known.h, known.substeps, path)
    return finite(path), angle


@inlined_flat
def resting(c: Array, known: Known, asked: Asked, state: State, rest: Array) -> bool:
    """Update the memory of the `rest` mode by a sample, and return whether pressures are held: see `RestMode`."""
    m, rules = asked.theta.size - state.u.shape[0] - 1, known.rules
    assign(rest, state.rest)
    if not known.rests:
        return False
    memory = memory_in(rest, 1, NU)
    if not constant(memory, rules, asked.theta[m:], asked.K[m:]):
        begin(memory)
    elif decided(memory, rules, asked.x, state.expected):
        angle = memory.joint[0, THETA] + due(memory, 0)[0]
        found = pressing(angle, 0.0, memory.muscle[0, HELD], memory.muscle[1, HELD], c)
        turn(memory, (found[1],), (found[2], found[3]))
    return bool(rest[RESTS] > 0)


@inlined_flat
def feed_forward(
    c: Array, p: Array, known: Known, slopes: Array, asked: Array, K: Array, d: Array, found: Reference, moved: Array
) -> bool:
    """Fill in the feed-forward of `mpc.tracking.feedforward.InverseDynamics`, and the distances `moved` (3,).

    Return whether the kernel is sure. `slopes` (2, N+1, N+1): the derivatives of a preview, transposed.
    """
    inertia, damping, gravity, alpha1, alpha2 = known.inertia, known.damping, known.gravity, known.alpha1, known.alpha2
    left, right, half_lag1, half_lag2 = known.left, known.right, known.lag1 / 2, known.lag2 / 2
    M, q1, q2, sure, x, y, u = asked.size, 0.0, 0.0, True, found.x, found.y, found.u
    for k in range(M):
        x[k, 0], x[k, 1], x[k, 2] = min(max(asked[k], left), right), 0.0, 0.0
    for j in range(M):
        for k in range(M):
            x[k, 1] += slopes[0, j, k] * x[j, 0]
            x[k, 2] += slopes[1, j, k] * x[j, 0]  # the acceleration, in the place of the pressures
    moved[0] = moved[1] = moved[2] = 0.0
    for k in range(M):
        theta, omega = x[k, 0], x[k, 1]
        T = inertia * x[k, 2] + damping * omega + gravity * np.sin(theta) - d[k]
        pair = allocated(theta, K[k], T, p, left, right, known.min_force, c)
        x[k, 2], x[k, 3] = pair[0], pair[1]
        y[k, 0], y[k, 1], y[k, 2], sure = pair[3], 0.0, 0.0, sure and pair[6]
        moved[0] = max(moved[0], abs(asked[k] - theta))
        moved[1] = max(moved[1], abs(K[k] - y[k, 0]))
        moved[2] = max(moved[2], abs(T - pair[2]))
        last1, last2 = q1, q2
        q1, q2 = expansion(theta, omega, pair[0], pair[1], c)
        if k > 0:
            u[k - 1, 0] = (x[k, 2] - alpha1 * x[k - 1, 2]) / (1 - alpha1) + half_lag1 * (q1 + last1)
            u[k - 1, 1] = (x[k, 3] - alpha2 * x[k - 1, 3]) / (1 - alpha2) + half_lag2 * (q2 + last2)
    return sure


@inlined_flat
def linearise(c: Array, h: float, substeps: int, numbers: Array, starts: Indices, given: Array, buffer: Array) -> None:
    """Store in `buffer` the commands of `given`, moved to within the limits, and the linear model along them."""
    setting, (path, u) = setting_in(numbers, starts), path_in(buffer)
    x0, asked, d, _, last = given_in(given)
    for k in range(u.shape[0]):
        u[k, 0], u[k, 1] = asked[k, 0] / BAR, asked[k, 1] / BAR
    bounds = setting.bounds
    limit(bounds.low, bounds.high, bounds.step, last[0], BAR, u)
    linear_model(c, x0, u, d, h, substeps, path)
    read_outputs(c, path)


@inlined_flat
def planned(bounds: Bounds, starts: Indices, buffer: Array, given: Given, z: Array, made: Made) -> None:
    """Fill in the commands [bar] that follow from `z`."""
    u, moved = path_in(buffer).u, made.u
    cumulative(starts, z, moved)
    for k in range(u.shape[0]):
        moved[k, 0] += u[k, 0]
        moved[k, 1] += u[k, 1]
    limit(bounds.low, bounds.high, bounds.step, given.last[0], BAR, moved)


@inlined_flat
def rollout(c: Array, h: float, substeps: int, bounds: Bounds, x0: Array, d: Array, made: Made) -> bool:
    """Fill in the commands in Pa, from bar, their states, K and F, and the violations of the soft limits; return
    whether all are finite.
    """
    N, moved, x, K, F = made.u.shape[0], made.u, made.x, made.K, made.F
    motion(c, x0, moved, d, h, substeps, x)
    for k in range(N + 1):
        K[k], F[k, 0], F[k, 1] = outputs(x[k, 0], x[k, 1], x[k, 2], x[k, 3], c)
    excess(bounds.left, bounds.right, bounds.min_force, x, F, made.slack)
    for k in range(N):
        moved[k, 0] *= BAR
        moved[k, 1] *= BAR
    return finite(moved) and finite(x) and finite(F)


@inlined_flat
def motion(c: Array, start: Array, u: Array, d: Array, h: float, substeps: int, x: Array) -> None:
    """Fill in the states `x` (N+1, 4) from `start` (4,) under the commands `u` (N, 2) [bar], in steps of `h` [s]."""
    x0, x1, x2, x3 = start[0], start[1], start[2], start[3]
    x[0, 0], x[0, 1], x[0, 2], x[0, 3] = x0, x1, x2, x3
    for k in range(u.shape[0]):
        for _ in range(substeps):
            k0, k1, k2, k3 = 0.0, 0.0, 0.0, 0.0
            s0, s1, s2, s3 = 0.0, 0.0, 0.0, 0.0
            for i in range(4):
                a, b = h * NODES[i], h * SHARES[i]
                k0, k1, k2, k3 = rate(x0 + a * k0, x1 + a * k1, x2 + a * k2, x3 + a * k3, u[k, 0], u[k, 1], d[k], c)
                s0, s1, s2, s3 = s0 + b * k0, s1 + b * k1, s2 + b * k2, s3 + b * k3
            x0, x1, x2, x3 = x0 + s0, x1 + s1, x2 + s2, x3 + s3
        x[k + 1, 0], x[k + 1, 1], x[k + 1, 2], x[k + 1, 3] = x0, x1, x2, x3


@inlined_flat
def linear_model(c: Array, start: Array, u: Array, d: Array, h: float, substeps: int, path: Path) -> None:
    """Fill in the motion and its Jacobians A, B, sample by sample: see `mpc.tracking.compiled.module`."""
    x = path.x
    for i in range(4):
        x[0, i] = start[i]
    for k in range(u.shape[0]):
        y = begun(x[k])
        for _ in range(substeps):
            slope, total = y, y  # times 0, to begin with
            for i in range(4):
                slope = variational(*advanced(y, h * NODES[i], slope), u[k, 0], u[k, 1], d[k], c)
                total = advanced(total, h * SHARES[i], slope)
            y = total
        ended(y, x[k + 1], path.A[k], path.B[k])


@inlined_flat
def read_outputs(c: Array, path: Path) -> None:
    """Fill in outputs and their gradients along the motion."""
    for k in range(path.x.shape[0]):
        x = path.x[k]
        o = output_slopes(x[0], x[1], x[2], x[3], c)
        for i in range(3):
            path.y[k, i] = o[i]
            for j in range(4):
                path.slope[k, i, j] = o[3 + 3 * j + i]
