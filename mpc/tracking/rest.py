"""In rest mode, where the reference is constant, the commands come to rest, instead of hunting.

A loop that knows friction, dead time and dead band makes valves chatter at rest out of nothing but sensor noise, and
where the friction that it was told of is not there, it swings for ever. But with friction such as Dahl's or Maxwell
slip, which has no peak at standstill, *any constant commands are a rest*, and a dead band is a play: commands
u = P + side · band/2, with both regulators on the same edge of it, hold the pressures P exactly, and raise (side +1) or
lower them (-1) without crossing the band. So the pressures are held at the mean P̄ of the hunting, and an angle that is
left over is corrected by a sampled integral with a dead zone. With e = θ - θ*, means over quarters of the joint's free
period 2π √(J/K*), and the model's stiffness K and torque slopes a_i = ∂T/∂P_i there,

    enter    the preview has been constant and |e| ≤ FAR for `DWELL`, |mean e| ≤ START + GROWTH · (time beyond),
             swing ≤ SWING; P̄ is the mean over half a period. On their way to the edges the regulators may turn the
             joint by EDGE
    correct  once the last correction has acted: |m| > DEAD_ZONE, m = mean e over the last quarter, or over the
             last period if the joint still swings: one of the pressures moves by ΔT/a_i, ΔT = -g m,
             g = K if it swings, else half the secant -ΔT_last/Δm, because friction before sliding makes the joint
             several times as stiff as its muscles are; bounded by g ≤ K (1 + OVERSHOOT/|m|): it may begin to slide.
             A pressure that was above the held one when the rest began is within the play, and moves from there; one
             that rose since is on the edge of a narrower band, or of a regulator with another offset
    leave    the preview changes, a state is not measured, θ is off its prediction by more than JOLT (a push, seen
             within a sample), e off its mean by more than PUSH + swing, or a pressure is off by LEAK

A loop that swings about its reference by more than `RINGING` to both sides, again and again, counts with friction that
is not there. Then the controller takes what friction there is as constant until the reference moves, rests as soon as
the swing allows it at the mean over a whole period, and corrects only errors of more than two dead zones.
"""

import numpy as np

from allocator.calculus import Array
from mpc.deferred import Deferred
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.tracking import resting
from mpc.tracking.limits import Limits
from mpc.tracking.preview import Task
from mpc.tracking.resting import DWELL, HELD, QUARTER, QUARTER_LENGTH, RESTS, RINGS, SIDE, Rules


class RestMode(Deferred):
    """Rest mode decides when a controller of `plant` rests, and which pressures are held then."""

    _put_off = ("numbers",)

    def __init__(self, plant: Plant, dt: float, compensation: Compensation, limits: Limits) -> None:
        self.plant = plant
        # without friction and dead band a loop does not hunt
        self.worthwhile = not (compensation.friction.absent and compensation.dead_band == 0)
        settling = round((compensation.dead_time + compensation.reading_age + 2 * max(plant.lags)) / dt)
        shortest, longest = (max(round(t / dt), 1) for t in QUARTER)
        times = settling, round(DWELL / dt), shortest, longest
        self.rules = Rules(plant.inertia, dt, *times, compensation.dead_band, limits.pressure[1])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.catch_up()
        self.numbers = [0.0] * resting.SIZE  # see `mpc.tracking.resting`
        self.numbers[resting.THETA] = self.numbers[resting.K] = np.nan
        self.numbers[QUARTER_LENGTH] = 1.0
        resting.begin(self.numbers)

    def go_on(self, numbers: Array) -> None:
        """Go on from the `numbers` of a sample that was made elsewhere."""
        self.numbers = numbers.tolist()

    @property
    def resting(self) -> bool:
        """Return whether the commands rest."""
        return self.numbers[RESTS] > 0

    @property
    def ringing(self) -> bool:
        """Return whether the loop counts with friction that is not there."""
        return self.numbers[RINGS] > 0

    @property
    def side(self) -> float:
        """Return the edge of the dead band, ±1; 0 before the first rest."""
        return self.numbers[SIDE]

    def pressures(self, task: Task) -> Array | None:
        """Return the pressures (2,) [Pa] to hold in the situation of `task`, to be called at every sample; None: no
        rest.
        """
        m = self.numbers
        if not (task.measured and not task.refused and resting.constant(m, self.rules, task.theta, task.K)):
            resting.begin(m)
        elif resting.decided(m, self.rules, task.seen, task.expected):
            x = np.array([m[resting.THETA] + resting.due(m)[0], 0.0, *m[HELD : HELD + NU]])
            slopes = (side.torque_gain(P) for side, P in zip(self.plant.joint.sides(x[0]), x[NX - NU :], strict=True))
            resting.turn(m, float(self.plant.isobaric(x)), *map(float, slopes))
        return np.array(m[HELD : HELD + NU]) if self.resting else None


class NoRest:
    """The rest mode of an arm: its commands follow the MPC at a constant reference, too."""

    ringing, worthwhile, side = False, False, 0.0

    def reset(self) -> None:
        """Do nothing."""

    def pressures(self, task: Task) -> None:
        """Return None: no rest."""


def rest_mode_of(plant: Machine, dt: float, compensation: Compensation, limits: Limits) -> RestMode | NoRest:
    """Return the rest mode of a joint, which an arm has none of: nobody knows its friction."""
    return RestMode(plant, dt, compensation, limits) if isinstance(plant, Plant) else NoRest()
