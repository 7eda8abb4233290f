"""Governor of one command: the box of pressures, the energy, and the check that the joints can be kept in range.

A command passes if the model, simulated under it for a sample and then under a *backup*, stays in the range until it is
certain that it always will (K. P. Wabersich and M. N. Zeilinger, "Linear model predictive safety certification for
learning-based control", CDC 2018; O. Bastani, "Safe reinforcement learning with nonlinear dynamics via model predictive
shielding", ACC 2021). The backup drives the pressures to those of a stiff rest and brakes on the way. After a command
that passes, the backup is available at the next sample, so that on the model there always is one.

If strength, damping, masses or lags are intervals, the simulation is repeated for their corners in `Rules.scenes`, and
a command passes if all of them stay in the range. The backup is the same function of the measured state in all scenes.

The kernel is plain Python for arrays, which numba compiles unchanged and `mpc.export.governor` prints as C. The
formulas of `mpc.governor.model` replace the lines below that begin with `FORMULAS`: `motion(q, omega, P, scene, c,
alpha, gain, force, speed, squeeze, energy)` and `potential(q, scene, c, level)`, which fill arrays; c holds the
formulas' numbers and `scene` the uncertain ones.
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba compiles the functions for arrays; types would be Any
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array

FORMULAS: Any = None
motion = potential = FORMULAS

SAFE, MOVED, NOT_KEPT, BAD_INPUT = 0, 1, 2, -1
CONFLICT, SLACK, OUTSIDE_LIMITS = 5, 6, 9
NO_COMMAND = 1e30  # [Pa] from which a command counts as none
NO_LIMIT = 1e30  # [J] from which the energy is not limited
MOST_POWER = 1e30  # [W] above that of any arm
HALVINGS = 4  # of the segment from the backup to the command
STEPS = 60  # of the bisection that finds the multiplier of the energy
KEPT = 1e-8  # [-] of a row's size: greatest excess that counts as none
LEAST, MIN_FORCE, REACH, SLEW, NEAR, REACTION, ENERGY, BRAKE, INNER, RANGED, ATMOSPHERE = range(11)  # of `numbers`
LOWEST, ROOT = range(2)  # of a row of `barrier`


class Rules(NamedTuple):
    """Numbers of a governor of n joints and m muscles, with s scenes of k uncertain numbers."""

    numbers: Annotated[Array, 11]  # in the order of the constants above, SI units
    most: Annotated[Array, "m"]  # supply or validity [Pa]
    load: Annotated[Array, "n"]  # greatest external torque [N·m]
    ends: Annotated[Array, "n", 2]  # of the range [rad]
    rest: Annotated[Array, "m"]  # P_b of the stiff rest [Pa]
    strong: Annotated[Array, 2, "m"]  # least and greatest strength [-]
    scenes: Annotated[Array, "s", "k"]  # uncertain numbers of the formulas
    barrier: Annotated[Array, "s", 2]  # energy in the range [J] and root of the barrier [√J]
    weight: Annotated[Array, "s", "m"]  # w of the pressures' approach to the rest [√J/(Pa·s)]
    volume: Annotated[Array, "s", "m"]  # greatest V/κ of the gas in the range [m³]
    lag: Annotated[Array, "s", "m"]  # [s]
    steps: Annotated[Array, 2]  # [s] of the integration, in the first sample and later
    decay: Annotated[Array, "2 * s", "m"]  # exp(-step/lag), two rows per scene
    counts: Annotated[NDArray[np.int64], 5]  # steps in the first sample, in later ones; samples; dt in a later one; s
    motion: Annotated[Array, "c"]  # numbers of the formulas
    potential: Annotated[Array, "c"]


class Memory(NamedTuple):
    """Working arrays of `govern`; `mpc.governor.rules.memory_for` creates them."""

    angles: Annotated[Array, "n"]  # of the simulated state [rad]
    rates: Annotated[Array, "n"]  # [rad/s]
    guess: Annotated[Array, "n"]  # [rad/s] at the end of a step
    pressures: Annotated[Array, "m"]  # [Pa]
    commands: Annotated[Array, "m"]  # [Pa]
    alpha: Annotated[Array, "n"]  # [rad/s²]
    later: Annotated[Array, "n"]  # [rad/s²] at the end of a step
    gain: Annotated[Array, "m"]  # A of the forces A P + B [N/Pa]
    force: Annotated[Array, "m"]  # B [N]
    speed: Annotated[Array, "m"]  # -l', at which muscles shorten [m/s]
    before: Annotated[Array, "m"]  # the same a step earlier [m/s]
    squeeze: Annotated[Array, "m"]  # κ (P + p_a) V'/(V s), by which shortening lowers the pressures [Pa/m]
    energy: Annotated[Array, 2]  # kinetic [J], and gravity's power [W]
    level: Annotated[Array, 1]  # potential [J]
    scene: Annotated[Array, "k"]  # of the present scene
    power: Annotated[Array, "m"]  # of the strongest muscles, or of the weakest if they brake [W/Pa]
    within: Annotated[Array, "n", 2]  # range of the joints [rad]
    lo: Annotated[Array, "m"]  # [Pa]
    hi: Annotated[Array, "m"]  # [Pa]
    wanted: Annotated[Array, "m"]  # pressures next to the command [Pa]
    first: Annotated[Array, "m"]  # of the backup [Pa]


def govern(rules, q, omega, P, previous, command, safe, memory):
    """Fill `safe` (m) with the pressures next to `command` (m) that respect all limits; return the outcome."""
    begin(rules, 0, q, omega, P, previous, memory)
    found = limit(rules, previous, memory)
    status = found
    for j in range(len(command)):
        memory.wanted[j] = command[j]
        if not abs(command[j]) < NO_COMMAND:
            memory.wanted[j], status = previous[j], BAD_INPUT
    slowed = nearest(rules, q, omega, P, previous, safe, memory)
    for j in range(len(command)):
        memory.wanted[j] = safe[j]
        if safe[j] != command[j] and status == SAFE:
            status = MOVED
    kept = 1
    if rules.numbers[RANGED] > 0.0:
        kept = shielded(rules, q, omega, P, previous, safe, memory)
        if kept != 1 and status == SAFE:
            status = MOVED
    if (slowed == 0 or kept == 0) and status == MOVED:
        status = NOT_KEPT
    return status


def limit(rules, previous, memory):
    """Fill in the box of pressures for supply, tautness and slew; return the outcome if no pressure respects them.

    The slew has priority over the supply, and the supply over tautness, as in `Mechanism.pressure_box`.
    """
    numbers, status = rules.numbers, SAFE
    least, near = numbers[LEAST], numbers[NEAR]
    for j in range(len(previous)):
        most, nearest_, farthest = rules.most[j], previous[j] - numbers[REACH], previous[j] + numbers[REACH]
        taut = (numbers[MIN_FORCE] - memory.force[j]) / memory.gain[j]
        high = min(max(most, nearest_), farthest)
        memory.lo[j], memory.hi[j] = min(max(min(max(taut, least), most), nearest_), farthest), high
        if nearest_ > most + near or farthest < least - near:
            status = OUTSIDE_LIMITS
        elif taut > high + near:
            status = max(status, SLACK)
        elif taut > most + near:
            status = max(status, CONFLICT)
    return status


def nearest(rules, q, omega, P, previous, safe, memory):
    """Fill `safe` with the box's pressures nearest to the wanted ones within the energy; return whether there are any.

    In the time t of reaction the torques' power keeps the kinetic energy below its bound, ½ ωᵀM ω + t ω·τ(u) ≤ E, the
    load included, with the greatest strength of a muscle that drives the motion and the least of one that brakes it.
    That is one row a·u ≤ b, and u = clip(wanted - μ a): its multiplier μ is found by bisection.
    """
    numbers, m = rules.numbers, len(safe)
    offset = 0.0
    for j in range(m):
        strength = rules.strong[1, j] if memory.speed[j] > 0.0 else rules.strong[0, j]
        memory.power[j] = strength * memory.gain[j] * memory.speed[j]
        offset += strength * memory.force[j] * memory.speed[j]
    excess = projected(0.0, safe, memory)
    if not numbers[ENERGY] < NO_LIMIT:
        return 1
    room = energetic(rules, q, omega, P, previous, memory) - offset
    size = abs(room + offset)
    for i in range(len(omega)):
        room -= abs(omega[i]) * rules.load[i]
    for j in range(m):
        size += abs(memory.power[j]) * rules.most[j]
    if excess <= room + KEPT * size:
        return 1
    low, high = 0.0, 1.0
    for j in range(m):
        a = abs(memory.power[j])
        if a > 0.0:
            high = max(high, (abs(memory.wanted[j]) + memory.hi[j] + rules.most[j]) / a)
    if projected(high, safe, memory) > room + KEPT * size:
        return 0
    for _ in range(STEPS):
        middle = 0.5 * (low + high)
        if projected(middle, safe, memory) > room:
            low = middle
        else:
            high = middle
    projected(high, safe, memory)
    return 1


def energetic(rules, q, omega, P, previous, memory):
    """Return the power [W] to the greatest energy within the reaction time, in the worst scene."""
    room = MOST_POWER
    for s in range(rules.counts[4]):
        if s > 0:
            begin(rules, s, q, omega, P, previous, memory)
        left = (rules.numbers[ENERGY] - memory.energy[0]) / rules.numbers[REACTION] - memory.energy[1]
        room = min(room, left)
    return room


def projected(mu, safe, memory):
    """Fill `safe` with clip(wanted - μ a) within the box; return a·safe [W] of a, the muscles' power per pressure."""
    power = 0.0
    for j in range(len(safe)):
        a = memory.power[j]
        safe[j] = min(max(memory.wanted[j] - mu * a, memory.lo[j]), memory.hi[j])
        power += a * safe[j]
    return power


def shielded(rules, q, omega, P, previous, safe, memory):
    """Move `safe`, the wanted pressures, towards the backup's commands until the joints can be kept in range.

    Return 1 if it is unchanged, 2 if it was moved, 0 if not even the backup keeps the range.
    """
    calm = True
    for s in range(rules.counts[4]):
        if calm:
            if rules.counts[4] > 1:
                begin(rules, s, q, omega, P, previous, memory)
            calm = certain(rules, s, memory)
    brake(rules, 1, calm, memory)
    for j in range(len(safe)):
        memory.first[j] = memory.commands[j]
    low, high, share, kept = 0.0, 1.0, 1.0, False
    for k in range(HALVINGS + 2):
        given = 0 if k == 1 else 1  # the backup's own commands have a weaker condition
        for j in range(len(safe)):
            safe[j] = memory.wanted[j]
            if k > 0:
                safe[j] = memory.first[j] + share * (memory.wanted[j] - memory.first[j])
        kept = stays(rules, q, omega, P, previous, safe, given, memory)
        if k == 0 and kept:
            return 1
        if k == 1 and not kept:
            return 0
        if k > 1 and kept:
            low = share
        elif k > 1:
            high = share
        share = 0.0 if k == 0 else 0.5 * (low + high)
    for j in range(len(safe)):
        safe[j] = memory.first[j] + low * (memory.wanted[j] - memory.first[j])
    return 2


def begin(rules, s, q, omega, P, previous, memory):
    """Copy the initial state of the simulation, and take scene `s`."""
    for i in range(len(memory.scene)):
        memory.scene[i] = rules.scenes[s, i]
    for i in range(len(q)):
        memory.angles[i], memory.rates[i] = q[i], omega[i]
    for j in range(len(P)):
        memory.pressures[j], memory.commands[j] = P[j], previous[j]
    motion(
        memory.angles, memory.rates, memory.pressures, memory.scene, rules.motion,
        memory.alpha, memory.gain, memory.force, memory.speed, memory.squeeze, memory.energy,
    )  # fmt: skip
    for j in range(len(P)):
        memory.before[j] = memory.speed[j]


def stays(rules, q, omega, P, previous, command, given, memory):
    """Return whether the joints stay in range in all scenes under `command` for a sample and then the backup.

    A `given` command, not the backup's own, has to keep an additional distance for the error of the integration, or the
    joint's present distance if that is less.
    """
    inner = rules.numbers[INNER] if given else 0.0
    for i in range(len(q)):
        memory.within[i, 0] = max(min(rules.ends[i, 0] + inner, q[i]), rules.ends[i, 0])
        memory.within[i, 1] = min(max(rules.ends[i, 1] - inner, q[i]), rules.ends[i, 1])
    for s in range(rules.counts[4]):
        begin(rules, s, q, omega, P, previous, memory)
        if not lasts(rules, s, command, memory):
            return False
    return True


def lasts(rules, s, command, memory):
    """Return whether the joints stay in range in scene `s`, from the state that `begin` copied."""
    for k in range(rules.counts[2]):
        if k == 0:
            for j in range(len(command)):
                memory.commands[j] = command[j]
        else:
            if certain(rules, s, memory):
                return True
            brake(rules, rules.counts[3], False, memory)
        stage = 0 if k == 0 else 1
        for _ in range(rules.counts[stage]):
            if not advance(rules, s, stage, memory):
                return False
    return False


def brake(rules, samples, calm, memory):
    """Fill in the backup's commands some `samples` later: towards the rest, and against the motion unless `calm`.

    With the shortening speeds s of the muscles, u = P_b - β s takes energy from the bodies.
    """
    numbers = rules.numbers
    reach = numbers[REACH] * samples
    for j in range(len(rules.rest)):
        aim = rules.rest[j]
        if not calm:
            taut = (numbers[MIN_FORCE] - memory.force[j]) / memory.gain[j]
            aim = min(max(aim - numbers[BRAKE] * memory.speed[j], max(taut, numbers[LEAST])), rules.most[j])
        memory.commands[j] = min(max(aim, memory.commands[j] - reach), memory.commands[j] + reach)


def certain(rules, s, memory):
    """Return whether the joints of scene `s` always stay in range if the pressures go to the rest now.

    The bodies' energy E above that of the rest decides. The potential at the ends is nowhere less than ROOT² above the
    rest's.
    """
    most = room(rules, s, memory)
    if memory.energy[0] >= most:
        return False
    potential(memory.angles, memory.scene, rules.potential, memory.level)
    return memory.energy[0] + memory.level[0] - rules.barrier[s, LOWEST] < most


def room(rules, s, memory):
    """Return the energy E [J] below which the joints stay in range while the pressures go to the rest.

    Pressure errors δ = P - P_b let √E grow by (√E)' ≤ ‖∂τ/∂P δ‖_{M⁻¹}/√2, in all by less than w·∫|δ|dt, where
    ∫|δ_j|dt ≤ e_j²/2r + τ |δ_j| with e = u - P_b, the slew r and the lag τ.

    Motion that compresses gas changes δ, but the gas returns the work that it takes: with κ (P + p_a) ψ' = ψ + δ and
    ψ(P_b) = 0 only the commands let E + Σ V_j ψ_j grow. With c = V/(κ (p + p_a)) at the least p of P, u and P_b,
    V ψ is at most c δ²/2, and grows by at most c e²/4τ, where ∫e²dt ≤ |e|³/3r.
    """
    numbers, gas, grows, stored = rules.numbers, rules.numbers[ATMOSPHERE], 0.0, 0.0
    for j in range(len(rules.rest)):
        off, error = abs(memory.commands[j] - rules.rest[j]), abs(memory.pressures[j] - rules.rest[j])
        if gas > 0.0:
            least = min(memory.pressures[j], min(memory.commands[j], rules.rest[j]))
            c = rules.volume[s, j] / (least + gas)
            stored += 0.5 * c * error * error
            if off > 0.0:
                stored += c * off * off * off / (12.0 * numbers[SLEW] * rules.lag[s, j])
        else:
            grows += rules.weight[s, j] * (0.5 * off * off / numbers[SLEW] + rules.lag[s, j] * error)
    left = max(rules.barrier[s, ROOT] - grows, 0.0)
    return left * left - stored


def advance(rules, s, stage, memory):
    """Take a step of velocity Verlet in scene `s`; return whether all joints are within their range.

    Between two steps a reversing joint is at most h²|ω'|/8 farther than at their ends. Gas is compressed at the speed
    in the middle of the step, continued from its beginning and the step before.
    """
    h = rules.steps[stage]
    for j in range(len(rules.rest)):
        u, decay = memory.commands[j], rules.decay[2 * s + stage, j]
        middle = 1.5 * memory.speed[j] - 0.5 * memory.before[j]
        fall = rules.lag[s, j] * (1.0 - decay) * memory.squeeze[j] * middle
        memory.pressures[j] = u + decay * (memory.pressures[j] - u) - fall
        memory.before[j] = memory.speed[j]
    for i in range(len(memory.angles)):
        memory.angles[i] += h * (memory.rates[i] + 0.5 * h * memory.alpha[i])
        memory.guess[i] = memory.rates[i] + h * memory.alpha[i]
    motion(
        memory.angles, memory.guess, memory.pressures, memory.scene, rules.motion,
        memory.later, memory.gain, memory.force, memory.speed, memory.squeeze, memory.energy,
    )  # fmt: skip
    inside = True
    for i in range(len(memory.angles)):
        old = memory.rates[i]
        memory.rates[i] += 0.5 * h * (memory.alpha[i] + memory.later[i])
        memory.alpha[i] = memory.later[i]
        beyond = 0.125 * h * h * abs(memory.alpha[i]) if old * memory.rates[i] < 0.0 else 0.0
        if memory.angles[i] - beyond < memory.within[i, 0] or memory.angles[i] + beyond > memory.within[i, 1]:
            inside = False
    return inside


FUNCTIONS = (projected, limit, begin, energetic, nearest, room, certain, brake, advance, lasts, stays, shielded, govern)
