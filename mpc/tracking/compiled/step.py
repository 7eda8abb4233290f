"""Template of a sample of the controller of a machine, or of a part of it.

`mpc.tracking.compiled.module` replaces the lines below that begin with `FORMULAS` by views of the machine's records,
and by its feed-forward, loads, motion, and outputs (`mpc.tracking.compiled.joint`); `mpc.tracking.compiled.arm.module`
does so for an arm (`mpc.tracking.compiled.arm.step`, `feedforward`), and sets its sizes.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc.codegen.addresses import floats_at, seconds_at
from mpc.codegen.jit import assign, compiled_flat, inlined_flat
from mpc.model.compiled_friction import Rubbing, followed, less_friction, rubbing_in
from mpc.model.friction.contact import Loads
from mpc.tracking import resting
from mpc.tracking.compiled.commands import cumulative, excess, finite, limit
from mpc.tracking.compiled.records import Bounds, Given
from mpc.tracking.compiled.sample.calls import settle_at, stage_at
from mpc.tracking.compiled.sample.layout import Asked, Inputs, Known, Made, Room, State, inputs_at
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
from mpc.tracking.compiled.sample.views import (
    asked_in,
    gains_in,
    known_in,
    made_in,
    memory_in,
    plan_length,
    room_in,
    state_in,
)
from mpc.tracking.compiled.structured_qp.sizes import JOINTS, NU, NX, TRACKED
from mpc.tracking.rest_memory import HELD, RESTS, RINGS, SIDE

FORMULAS: Any = None
given_in = path_in = setting_in = press = isobaric = feed_forward = motion = linear_model = read = FORMULAS


@compiled_flat
def step(what: int, table: int, last: Array, out: Array, x: Array, theta: Array, K: Array) -> bool:
    """Make the whole step or one part of it, and return whether that succeeded; if not, the guess is unchanged.

    `table` is the address of `Inputs`, `last` the result of the previous step, `out` that of this one
    (`mpc.tracking.compiled.sample.layout`). The parts are the feed-forward for `asked`, the linear model about `given`,
    and the rollout of `z`. The whole step uses the state `x`, flat previews `theta` and `K`, and the torques in
    `asked`. In a rest, held pressures replace the QP's solution, and without a QP commands in closed form do.
    """
    i = inputs_at(table)
    began = seconds_at(i.clock, i.name)
    last, out = floats_at(last.ctypes.data, last.size), floats_at(out.ctypes.data, out.size)  # not reference-counted
    k, want, now, room = known_in(i.known), asked_in(i.asked), given_in(i.given), room_in(i.room)
    whole, done, rests, delay = what == WHOLE, True, False, room.waiting.shape[0]
    made, (before, after) = made_in(out[: plan_length(now.u.shape[0])]), states_of(i, now.u.shape[0], last, out)
    bounds = setting_in(i.numbers, i.starts).bounds
    copy_set(i.guess, i.kept)
    if whole:
        ask(x, theta, K, want)
        done = foreseen(i, table, last, out, k, want, room, before, after)
        rests = done and i.rested != 0 and stage_at(i.rested, (table, last, out))
    if done and (whole or what == FEED):
        previews = want.theta[delay * JOINTS :], want.K[delay * TRACKED**2 :], want.torques[delay * JOINTS :]
        done = feed_forward(i, *previews, now.reference, made.moved)
    solves = i.closed == 0 and not rests
    fed = linearised = seconds_at(i.clock, i.name)
    if whole and done:
        take(room.path[delay], want, bounds, before, now)
        if solves:
            shift_set(i.starts, i.kept, i.guess)
    if done and solves and (whole or what == LINEARISE):
        linearise(i, k, bounds, now)
        linearised = seconds_at(i.clock, i.name)
    if whole and done and solves:
        done, i.counted[0] = settle_at(i.settle, (i.numbers, i.starts, i.given, i.buffer, i.guess, i.z))
    if whole and done and i.closed != 0:
        done = stage_at(i.closed, (table, last, out))
    if done and (whole or what == ROLLOUT):
        if i.closed == 0:
            command(i, bounds, now, rests, before, after, made)
        done = rollout(i, k, bounds, now, room.y, made)
    if whole and done:
        invert_dead_band(k, bounds, now, before, after.rest[SIDE] if rests else 0.0, made)
        remember(want, now, room.path, made, before, after)
        made.times[0], made.times[1] = fed - began, linearised - fed
        made.times[2] = seconds_at(i.clock, i.name) - linearised
    elif whole:
        copy_set(i.kept, i.guess)
    return done


@inlined_flat
def states_of(i: Inputs, N: int, last: Array, out: Array) -> tuple[State, State]:
    """Return the states in the result of the previous sample and in that of this one."""
    size, springs, delay = plan_length(N), rubbing_of(i.friction, 0).springs.size, room_in(i.room).waiting.shape[0]
    was, made = made_in(last[:size]), made_in(out[:size])
    return state_in(last[size:], was.u, springs, delay), state_in(out[size:], made.u, springs, delay)


@inlined_flat
def rubbing_of(friction: Array, joint: int) -> Rubbing:
    """Return the friction of a `joint`."""
    size = friction.size // JOINTS
    return rubbing_in(friction[joint * size : (joint + 1) * size])


# --- stages that some controllers have, compiled for these only ------------------------------------------------------


@compiled_flat
def rubbed(table: int, last: Array, out: Array) -> bool:
    """Update the memories of friction, and subtract the friction of the intended motion from the torques; return
    whether the loads on the sliding surfaces are finite.
    """
    i = inputs_at(table)
    known, asked, room = known_in(i.known), asked_in(i.asked), room_in(i.room)
    before, after = states_of(i, given_in(i.given).u.shape[0], last, out)
    press(i.c, asked.x, room.loads)
    for joint in range(JOINTS):
        rub(joint, rubbing_of(i.friction, joint), known, asked, before, after, room)
    return finite(room.loads)


@inlined_flat
def rub(joint: int, f: Rubbing, known: Known, asked: Asked, before: State, after: State, room: Room) -> None:
    """Update the memory of a joint's friction, and subtract it from the torques."""
    loads, theta = room.loads[joint], asked.theta[joint::JOINTS]
    pressed, now, felt = Loads(loads[0], loads[1], loads[2]), asked.x[joint], after.memory[joint]
    after.angle[joint] = followed(f, now, pressed, before.angle[joint], before.memory[joint], felt)
    corrected = 0.0 if before.rest[RINGS] > 0 else known.corrected
    back = theta[0] + corrected * (now - theta[0])
    less_friction(f, felt, back, theta, pressed, asked.d[joint], asked.torques[joint::JOINTS])


@compiled_flat
def rested(table: int, last: Array, out: Array) -> bool:
    """Update the memory of the rest mode by a sample, and return whether pressures are held: see `RestMode`."""
    i = inputs_at(table)
    rules, asked, room = known_in(i.known).rules, asked_in(i.asked), room_in(i.room)
    before, after = states_of(i, given_in(i.given).u.shape[0], last, out)
    delay, at, memory = room.waiting.shape[0], room.held, memory_in(after.rest, JOINTS, NU)
    if not resting.constant(memory, rules, asked.theta[delay * JOINTS :], asked.K[delay * TRACKED**2 :]):
        resting.begin(memory)
    elif resting.decided(memory, rules, asked.x, before.expected):
        for j in range(JOINTS):
            at[j], at[JOINTS + j] = resting.angle(memory, j), 0.0
        for j in range(NU):
            at[2 * JOINTS + j] = memory.muscle[j, HELD]
        isobaric(i.c, at, room.stiffness, room.gains)
        resting.turn(memory, room.stiffness, room.gains)
    return bool(after.rest[RESTS] > 0)


@compiled_flat
def fed_back(table: int, last: Array, out: Array) -> bool:
    """Replace the external torque in those for the feed-forward by the one of the errors: see `PIDControl`; return
    whether that is finite.
    """
    i = inputs_at(table)
    asked, room, g = asked_in(i.asked), room_in(i.room), gains_in(i.gains)
    before, after = states_of(i, given_in(i.given).u.shape[0], last, out)
    was, now, delay = before.fed, after.fed, room.waiting.shape[0]
    theta, x, error = asked.theta[delay:], room.path[delay], asked.theta[0] - asked.x[0]
    previous = error if np.isnan(was.error[0]) else was.error[0]
    now.error[0] = error
    now.integral[0] = was.integral[0] + (0.0 if was.saturated[0] > 0 else g.dt * error)
    now.slope[0] = slope = was.slope[0] + g.share * ((error - previous) / g.dt - was.slope[0])
    if g.predicted:
        omega = -1.5 / g.dt * theta[0] + 2.0 / g.dt * theta[1] - 0.5 / g.dt * theta[2]
        error, slope = theta[0] - x[0], omega - x[1]
    T = g.proportional * error + g.integral * now.integral[0] + g.derivative * slope
    for k in range(asked.torques.size):
        asked.torques[k] -= asked.d[0] + T
    return bool(np.isfinite(T))


@compiled_flat
def closed(table: int, last: Array, out: Array) -> bool:
    """Fill in the commands [bar] of a feedback of the state about the feed-forward, within the limits: see `Baseline`
    and `LQRControl`; return whether they are finite.
    """
    i = inputs_at(table)
    given, g, bounds = given_in(i.given), gains_in(i.gains), setting_in(i.numbers, i.starts).bounds
    before, after = states_of(i, given.u.shape[0], last, out)
    made, star, was, now = made_in(out[: plan_length(given.u.shape[0])]), given.reference, before.fed, after.fed
    made.rests[0] = now.saturated[0] = 0.0
    for j in range(NU):
        e = 0.0
        for row in range(NX):
            e -= g.state[j, row] * (given.x[row] - star.x[0, row])
        for row in range(NU):
            e -= g.state[j, NX + row] * was.e[row]
        for k in range(given.u.shape[0]):
            made.u[k, j] = (star.u[k, j] + e) / BAR
        now.e[j] = made.u[0, j]
    done = finite(made.u)
    limit(bounds.low, bounds.high, bounds.step, given.last[0], BAR, made.u)
    for j in range(NU):
        if made.u[0, j] != now.e[j]:
            now.saturated[0] = 1.0
        now.e[j] = BAR * made.u[0, j] - star.u[0, j]
    return done


# --- before and after the QP ------------------------------------------------------------------------------------------


@inlined_flat
def foreseen(
    i: Inputs, table: int, last: Array, out: Array, known: Known, asked: Asked, room: Room, before: State, after: State
) -> bool:
    """Fill in the predictions of `Preview.task`: the torques, the memories of friction, and the motion until a command
    acts; and the torques for the feed-forward in `asked`. Return whether the sample is an ordinary one.
    """
    if not plausible(known, asked, room.factor):
        return False
    for place in range(asked.torques.size):
        asked.torques[place] = asked.d[place % JOINTS]
    assign(after.memory, before.memory)
    assign(after.angle, before.angle)
    assign(after.rest, before.rest)
    if i.rubbed != 0 and not stage_at(i.rubbed, (table, last, out)):
        return False
    under_way(before, asked.x, room.waiting)
    motion(i, known, asked.x, room.waiting, asked.torques, room.path)
    given, first = given_in(i.given), room.waiting.shape[0] * JOINTS
    for k in range(given.d.size):
        given.d[k] = asked.torques[first + k]
    return finite(room.path) and (i.fed_back == 0 or stage_at(i.fed_back, (table, last, out)))


@inlined_flat
def linearise(i: Inputs, known: Known, bounds: Bounds, given: Given) -> None:
    """Store in the buffer the commands of `given`, moved to within the limits, and the linear model along them."""
    path, u = path_in(i.buffer)
    for k in range(u.shape[0]):
        for j in range(NU):
            u[k, j] = given.u[k, j] / BAR
    limit(bounds.low, bounds.high, bounds.step, given.last[0], BAR, u)
    linear_model(i, known, given.x, u, given.d, path)


@inlined_flat
def command(i: Inputs, bounds: Bounds, given: Given, rests: bool, before: State, after: State, made: Made) -> None:
    """Fill in the commands [bar], those of a rest or those of the QP's solution."""
    made.rests[0] = 1.0 if rests else 0.0
    if rests:
        hold(after.rest, bounds, before, made)
    else:
        planned(i, bounds, given, made)


@inlined_flat
def planned(i: Inputs, bounds: Bounds, given: Given, made: Made) -> None:
    """Fill in the commands [bar] that follow from `z`."""
    u, moved = path_in(i.buffer).u, made.u
    cumulative(i.starts, i.z, moved)
    for k in range(u.shape[0]):
        for j in range(NU):
            moved[k, j] += u[k, j]
    limit(bounds.low, bounds.high, bounds.step, given.last[0], BAR, moved)


@inlined_flat
def rollout(i: Inputs, known: Known, bounds: Bounds, given: Given, y: Array, made: Made) -> bool:
    """Fill in the commands in Pa, from bar, their states, K and F, and the violations of the soft limits; return
    whether all are finite. `y` is room for the outputs of a state.
    """
    moved, x, K, F = made.u, made.x, made.K, made.F
    motion(i, known, given.x, moved, given.d, x)
    for k in range(x.shape[0]):
        read(i.c, x[k], y)
        for j in range(K.shape[1]):
            K[k, j] = y[j]
        for j in range(NU):
            F[k, j] = y[K.shape[1] + j]
    excess(bounds.left, bounds.right, bounds.min_force, x, F, made.slack)
    for k in range(moved.shape[0]):
        for j in range(NU):
            moved[k, j] *= BAR
    return finite(moved) and finite(x) and finite(K) and finite(F)
