"""Rest mode: at a constant reference the commands come to rest instead of hunting.

A loop that compensates friction, dead time and dead band lets sensor noise alone make the valves chatter at rest, and
it oscillates for ever if the modelled friction does not exist. But with friction such as Dahl's or Maxwell slip, which
has no peak at standstill, *any constant commands are a rest*, and a dead band is a play: commands
u = P + side · band/2, with both regulators on the same edge of it, hold the pressures P exactly, and raise (side +1) or
lower them (-1) without crossing the band. So the pressures are held at the mean P̄ of the hunting, and a remaining
angle error is corrected by a sampled integral with a dead zone. With e = θ - θ*, means over quarters of the joint's
free period 2π √(J/K*), and the model's stiffness K and torque slopes a_i = ∂T/∂P_i there,

    enter    the preview has been constant and |e| ≤ FAR for `DWELL`, |mean e| ≤ START + GROWTH · (time beyond),
             swing ≤ SWING; P̄ is the mean over half a period. On their way to the edges the regulators may turn the
             joint by EDGE
    correct  once the last correction has acted: |m| > DEAD_ZONE, m = mean e over the last quarter, or over the
             last period if the joint still swings: one of the pressures moves by ΔT/a_i, ΔT = -g m,
             g = K if it swings, else half the secant -ΔT_last/Δm, because friction before sliding makes the joint
             several times as stiff as its muscles are; bounded by g ≤ K (1 + OVERSHOOT/|m|): it may begin to slide.
             A pressure that was above the held one when the rest began is within the play, and moves from there; one
             that rose since is on the edge of a narrower band, or of a regulator with another offset
    leave    the preview changes, a state is not measured, θ is off its prediction by more than JOLT and by more than
             UNUSUAL times what was usual before the rest (a push, seen within a sample), e off its mean by more than
             PUSH + swing, or a pressure is off by LEAK

A loop that swings about its reference by more than `RINGING` to both sides repeatedly compensates friction that does
not exist. Then the controller takes the present friction as constant until the reference moves, rests at the mean over
a whole period as soon as the swing allows it, and corrects only errors of more than two dead zones.

An arm rests when all of its joints may, and stops resting when one is disturbed. The free period is that of the
greatest J and the least K*. ΔT_i is the torque for joint i alone; the torques Σ_j K_ij ΔT_j/K_jj turn each joint by its
own amount without turning the others. Changes of pressures in the direction of `side` share them by least squares.
"""

import numpy as np

from allocator.calculus import Array
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.tracking import resting
from mpc.tracking.limits import Limits
from mpc.tracking.plan import Deferred
from mpc.tracking.preview import Task
from mpc.tracking.rest_memory import HELD, Memory, Rules
from mpc.tracking.resting import DWELL, JOLT, QUARTER


class RestMode(Deferred):
    """Rest mode of a controller of `plant`: when the commands rest, and at which pressures."""

    _put_off = ("numbers",)

    def __init__(self, plant: Machine, dt: float, compensation: Compensation, limits: Limits) -> None:
        self.plant = plant
        # without friction and dead band a loop does not hunt
        self.worthwhile = not (compensation.frictionless and compensation.dead_band == 0)
        settling = round((compensation.dead_time + compensation.reading_age + 2 * max(plant.lags)) / dt)
        shortest, longest = (max(round(t / dt), 1) for t in QUARTER)
        times = settling, round(DWELL / dt), shortest, longest
        inertia = float(np.max(plant.inertias))
        self.rules = Rules(inertia, dt, *times, compensation.dead_band, limits.pressure[1], JOLT * plant.n)
        self._unit = float(plant.entries[2][0]) if isinstance(plant, Arm) else 1.0  # [N·m/rad] per unit of K
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self.catch_up()
        self.numbers = np.zeros(resting.size(self.plant.n, self.plant.m))  # see `mpc.tracking.resting`
        resting.clear(self._memory)

    def go_on(self, numbers: Array) -> None:
        """Continue from the `numbers` of a sample computed by compiled code."""
        self.numbers = numbers.copy()

    @property
    def _memory(self) -> Memory:
        return resting.memory_in(self.numbers, self.plant.n, self.plant.m)

    @property
    def resting(self) -> bool:
        """Whether the commands rest."""
        return resting.holds(self._memory)

    @property
    def ringing(self) -> bool:
        """Whether the loop compensates friction that does not exist."""
        return resting.rings(self._memory)

    @property
    def side(self) -> float:
        """Edge of the dead band, ±1; 0 before the first rest."""
        return resting.side(self._memory)

    def pressures(self, task: Task) -> Array | None:
        """Return the pressures (m,) [Pa] to hold, or None without a rest. Has to be called at every sample."""
        m, known = self._memory, task.measured and not task.refused
        if not (known and resting.constant(m, self.rules, task.theta.ravel(), self._unit * task.K.ravel())):
            resting.begin(m)
        elif resting.decided(m, self.rules, task.seen, task.expected):
            posture = np.array([resting.angle(m, i) for i in range(self.plant.n)])
            resting.turn(m, *self._slopes(posture, m.muscle[:, HELD]))
        return m.muscle[:, HELD].copy() if self.resting else None

    def _slopes(self, q: Array, P: Array) -> tuple[Array, Array]:
        """Return the flat isobaric stiffness (n n,) [N·m/rad] and ∂T/∂P (n m,) [N·m/Pa] at angles and pressures."""
        muscles = self.plant.mechanism.at(q) if isinstance(self.plant, Arm) else self.plant.joint.sides(q[0])
        held = list(zip(muscles, P, strict=True))
        gains = np.transpose([each.torque_gain(pressure) for each, pressure in held])
        return np.ravel(sum(each.stiffness(pressure) for each, pressure in held)), gains.ravel()
