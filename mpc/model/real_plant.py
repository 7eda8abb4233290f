"""Simulated plant with effects of real joints that the prediction model lacks.

    θ' = ω,   J ω' = T - b ω - m g l sin θ - T_f + d(t),   T = g1 a1 F1 - g2 a2 F2
    P_i' = dz(u_i(t - t_dead) - P_i)/τ_i within ± flow - q_i,   dz(e) = e minus the dead band, 0 within it,
                                                                 τ_i that of a rising or of a falling pressure
    q_i = κ (P_i + p_a) V_i'/V_i^eff, or 0 if the nominal plant has no gas
    measured: θ(t - t_age) rounded to the encoder's step, P_i + o_i + noise; not ω

with muscles that pull g_i times as hard as their model and the friction T_f of `mpc.model.friction`. Within its dead
band a regulator acts as a shut valve, which traps the gas. A muscle that pulls g_i times as hard swells g_i times as
much; otherwise a closed cycle would create energy. The default of its field turns an effect off; with all of them off,
this is the nominal `Plant`.

T_f depends on the angles of reversal. Within a step of integration it is a function of the angle, exact while the joint
turns in one direction; each step begins with the memory of the previous one.
"""

from dataclasses import dataclass, field, fields, replace
from functools import lru_cache
from math import ceil, inf, isfinite, prod, sqrt
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import complex_share
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.codegen.buffered import Buffered
from mpc.model.compensation import Compensation, check_regulators
from mpc.model.experiment import FINE
from mpc.model.faults import Fault
from mpc.model.friction.contact import Contact, Hysteresis
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip, friction_of
from mpc.model.gas import trapped
from mpc.model.integration import integrated
from mpc.model.plant import MOST_SUBSTEPS, NU, NX, Plant

if TYPE_CHECKING:
    from casadi import Function


@dataclass(frozen=True)
class RealPlant:
    """Nominal plant with model errors, friction, delays and faults added. Immutable; SI units."""

    nominal: Plant = field(default_factory=Plant)  # joint, link, gravity, lags
    force_gains: tuple[float, float] = (1.0, 1.0)  # g1, g2 [-]; 0 for a broken cable
    friction: Hysteresis = field(default_factory=Friction)
    dead_time: float = 0.0  # t_dead of the commands [s]
    dead_band: float = 0.0  # [Pa], total: a regulator does not act within half of it on either side
    lag_up: float | None = None  # time constant of a rising pressure [s], the geometric mean of both muscles, whose
    lag_down: float | None = None  # ratio is that of the nominal lags; of a falling one. None: the nominal plant's
    flow: float = inf  # fastest change of a pressure [Pa/s]
    encoder: float = 0.0  # step [rad]
    reading_age: float = 0.0  # t_age of the angle's readings [s]
    pressure_noise: float = 0.0  # standard deviation [Pa], white from sample to sample
    pressure_offset: tuple[float, float] = (0.0, 0.0)  # o_i, added to the readings [Pa]
    torque_profile: tuple[tuple[float, float], ...] = ()  # (from time [s] on, external torque [N·m]), in order
    shut: tuple[bool, bool] = (False, False)  # valves that stay shut for any command
    faults: tuple[Fault, ...] = ()  # each in its time window, the first one nearest to the plant

    def __post_init__(self) -> None:
        """Check the effects."""
        for name, unit in _UNITS:
            value = float(getattr(self, name))
            if not (value >= 0 and isfinite(value)):
                raise InvalidInput(f"{name} = {value:g} {unit} has to be 0 or more, and finite")
            object.__setattr__(self, name, value)
        check_regulators(self)
        offsets = tuple(checks.number("pressure_offset", offset, "Pa") for offset in self.pressure_offset)
        if len(offsets) != NU or max(map(abs, offsets)) > BAR:
            raise InvalidInput(f"pressure_offset = {self.pressure_offset} Pa has to be two numbers within ±1e5 Pa")
        object.__setattr__(self, "pressure_offset", offsets)
        object.__setattr__(self, "friction", friction_of(self.friction))
        object.__setattr__(self, "force_gains", tuple(float(g) for g in self.force_gains))
        if len(self.force_gains) != NU or not all(isfinite(g) and g >= 0 for g in self.force_gains):
            raise InvalidInput(f"force_gains = {self.force_gains} have to be two numbers of 0 or more [-]")
        times = [t for t, _ in self.torque_profile]
        if not np.isfinite(np.array(self.torque_profile, float)).all() or times != sorted(times):
            raise InvalidInput(
                f"torque_profile = {self.torque_profile} has to be finite pairs (s, N·m), times in order"
            )

    @classmethod
    def of(cls, plant: Plant, known: Compensation, **effects: Any) -> Self:
        """Return `plant` with the `known` friction and regulators, and further `effects` by name."""
        of_joint = {name: value for name, value in vars(known).items() if name != "frictions"}
        return cls(plant, **(of_joint | effects))

    @classmethod
    def standard(
        cls,
        force_gains: tuple[float, float] = (1.1, 0.9),
        torque_profile: tuple[tuple[float, float], ...] = (),
        nominal: Plant | None = None,
    ) -> Self:
        """Return the plant of the closed-loop benchmark, with all effects on `nominal`: the report's joint with
        Sarosi's muscles.

        Its `nominal` plant is the controllers' model.
        """
        plant = Plant(report_joint(SAROSI_DMSP_20_400N), lag=0.12) if nominal is None else nominal
        return cls(
            plant,
            force_gains,
            MaxwellSlip.of_width(plant, 5 * DEG),
            dead_time=0.03,
            dead_band=0.1 * BAR,
            flow=5 * BAR,
            encoder=0.02 * DEG,
            pressure_noise=0.02 * BAR,
            torque_profile=torque_profile,
        )

    def without(self, *effects: str) -> Self:
        """Return this plant with these effects (names of fields) off."""
        off = type(self)()
        known = {f.name for f in fields(self)} - {"nominal"}
        if unknown := set(effects) - known:
            raise InvalidInput(f"there is no effect {', '.join(sorted(unknown))}; there are {', '.join(sorted(known))}")
        return replace(self, **{name: getattr(off, name) for name in effects})

    def known(self, share: float = 0.75) -> Compensation:
        """Return a controller's knowledge of this plant: dead time, dead band, and a `share` [-] of the friction, as
        Dahl's.

        The whole friction would be best for this plant and worst if the friction vanished, because the compensation
        would then push the intended motion. Less is safe.
        """
        return Compensation(self.friction.as_dahl(self.nominal).share(share), self.dead_time, self.dead_band)

    # --- the equations ----------------------------------------------------------------------------------------------

    def torque(self, x: Value) -> Value:
        """Return T = g1 a1 F1 - g2 a2 F2 [N·m] in the state `x` [4, ...]."""
        agonist, antagonist = self.nominal.joint.sides(x[0])
        return self.force_gains[0] * agonist.torque(x[2]) + self.force_gains[1] * antagonist.torque(x[3])

    def stiffness(self, x: Value) -> Value:
        """Return the true stiffness [N·m/rad] of the muscles, without friction, in the state `x` [4, ...].

        It is isobaric, or at the nominal plant's `frequency`.
        """
        shares = self.nominal.shares
        isobaric = self.isobaric(x)
        return (
            isobaric if shares is None else isobaric + sum(s * K for s, K in zip(shares, self.trapped(x), strict=True))
        )

    def isobaric(self, x: Value) -> Value:
        """Return the true isobaric stiffness [N·m/rad] of the muscles in the state `x` [4, ...]."""
        agonist, antagonist = self.nominal.joint.sides(x[0])
        return self.force_gains[0] * agonist.stiffness(x[2]) + self.force_gains[1] * antagonist.stiffness(x[3])

    def trapped(self, x: Value) -> tuple[Value, Value]:
        """Return the stiffness of each muscle's gas behind a shut valve [N·m/rad]; 0 without gas   (G2)"""
        if self.nominal.gas is None:
            return 0.0 * x[0], 0.0 * x[0]
        sides = zip(self.nominal.joint.sides(x[0], (1.0, 1.0)), (x[2], x[3]), self.force_gains, strict=True)
        one, two = (trapped(side, P, strength) for side, P, strength in sides)
        return one, two

    def dynamic_stiffness(self, x: Array, frequency: float) -> complex:
        """Return the complex stiffness [N·m/rad] against small motions about `x` (4,) at a `frequency` [Hz]   (G4)

        Shut valves contribute all of their gas; dead band and flow limit do not count.
        """
        shares = [
            1.0 if s else complex_share(frequency, lag) for s, lag in zip(self.shut, self.nominal.lags, strict=True)
        ]
        return complex(self.isobaric(x) + sum(s * K for s, K in zip(shares, self.trapped(x), strict=True)))

    def forces(self, x: Value) -> tuple[Value, Value]:
        """Return the true muscle forces (F1, F2) [N] in the state `x` [4, ...]; negative means slack."""
        F1, F2 = self.nominal.forces(x)
        return self.force_gains[0] * F1, self.force_gains[1] * F2

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true stiffness (M,) [N·m/rad] and muscle forces (M, 2) [N] in the states `x` (M, 4)."""
        return np.asarray(self.stiffness(x.T)), np.stack(self.forces(x.T), axis=1)

    def pull(self, x: Value) -> Value:
        """Return the load a1 F1 + a2 F2 [N·m] on the sliding surfaces in the state `x` [4, ...]; 0 for slack cables."""
        agonist, antagonist = self.nominal.joint.sides(x[0])
        pulls = self.force_gains[0] * agonist.torque(x[2]), -self.force_gains[1] * antagonist.torque(x[3])
        return sum((pull + abs(pull)) / 2 for pull in pulls)

    def rate(self, x: Value, u: Value, d: Value, T_f: Value) -> tuple[Value, ...]:
        """Return the derivative of (θ, ω, P1, P2), CasADi symbols.

        `u` are the commands that act now, `d` is the external torque [N·m].
        """
        balance = self.torque(x) - self.nominal.torque_for(x[0], x[1], 0.0, d) - T_f
        return x[1], balance / self.nominal.inertia, *self._pressure_rates(x, u)

    def stepped(self, x: Value, memory: Value, u: Value, d: Value, h: Value) -> tuple[Value, Value]:
        """Return `x` (4,) and friction's `memory` after a fine step of `h` [s], CasADi symbols."""
        import casadi as ca

        def remembered(now: Value) -> Value:
            return self.friction.moved(memory, now[0] - x[0], Contact(self, now))

        def rate(now: Value, t: Value) -> Value:
            return ca.vertcat(*self.rate(now, u, d, self.friction.torque(remembered(now), Contact(self, now))))

        after = integrated(rate, x, h, 1)
        return after, remembered(after)

    def _pressure_rates(self, x: Value, u: Value) -> list[Value]:
        import casadi as ca

        rest = self.dead_band / 2
        error = [u[i] - x[2 + i] for i in range(NU)]
        passed = [ca.fmax(e - rest, 0.0) + ca.fmin(e + rest, 0.0) for e in error]
        rates = [
            0.0 if shut else ca.fmin(ca.fmax(self._pull(e, *lags), -self.flow), self.flow)
            for e, lags, shut in zip(passed, self.lags, self.shut, strict=True)
        ]
        if self.nominal.gas is None:
            return rates
        return [rate - q for rate, q in zip(rates, self.nominal.expansion(x, self.force_gains), strict=True)]

    @property
    def lags(self) -> tuple[tuple[float, float], ...]:
        """Time constants [s] of the rising and the falling pressure of each muscle."""
        nominal, own = self.nominal.lags, (self.lag_up, self.lag_down)
        mean = sqrt(prod(nominal))
        return tuple((_of(own[0], lag, mean), _of(own[1], lag, mean)) for lag in nominal)

    @staticmethod
    def _pull(e: Value, up: float, down: float) -> Value:
        """Return the rate [Pa/s] of a pressure with the error `e` [Pa] and its lags [s]."""
        import casadi as ca

        return e / up if up == down else ca.fmax(e, 0.0) / up + ca.fmin(e, 0.0) / down

    def substeps(self, dt: float, resolution: float) -> int:
        """Return the number of equal steps over `dt` [s] of the nominal plant, or more if its own lags are shorter.

        Raises `InvalidInput` like that of the nominal plant.
        """
        least, shortest = self.nominal.substeps(dt, resolution), min(min(lags) for lags in self.lags)
        steps = dt / shortest / resolution
        if steps > MOST_SUBSTEPS:
            raise InvalidInput(
                f"lag_up or lag_down = {shortest:.3g} s is so short that dt = {dt:g} s would take {steps:.3g} steps of "
                f"integration, over {MOST_SUBSTEPS}; omit such a short lag or give 1e-3 s"
            )
        return max(least, ceil(steps))

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the nominal plant's state at rest (4,), from which this plant drifts until it settles."""
        return self.nominal.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> "RealExperiment":
        """Begin an experiment from `x0` (4,) with commands every `dt` [s] and the `seed` of the sensors' noise."""
        return RealExperiment(self, dt, x0, seed)


def _of(own: float | None, nominal: float, mean: float) -> float:
    """Return the lag [s] of a muscle from its `nominal` one, their `mean`, and the `own` one of both."""
    return nominal if own is None else own * (nominal / mean)


def delayed(dead_time: float, dt: float) -> tuple[list[float], int]:
    """Return the pieces [s] of a sample of `dt` [s] by acting command, oldest first, and the number of delayed
    commands.

    There are two pieces if the dead time is not a whole number of samples: the older command acts in the first one.
    """
    whole = int(dead_time / dt * (1 + 1e-12))
    late = dead_time - whole * dt
    pieces = [late, dt - late] if late > 1e-9 * dt else [dt]
    return pieces, whole + len(pieces) - 1


def outside_torque(profile: tuple[tuple[float, float], ...], t: float) -> float:
    """Return the torque [N·m] of a `torque_profile` at the time `t` [s]; 0 before its beginning."""
    return next((torque for start, torque in reversed(profile) if t >= start - 1e-9), 0.0)


class RealExperiment:
    """Experiment on a `RealPlant`, with its state, its sensors and the time."""

    def __init__(self, real: RealPlant, dt: float, x0: Array, seed: int) -> None:
        self.real, self.dt = real, dt
        self._noise = np.random.default_rng(seed)
        self._full = np.append(x0, real.friction.begun(float(x0[0])))  # with the friction's memory
        self._sample = 0
        self._said = np.full(NX, np.nan)  # readings of the previous sample
        self._pieces, waiting = delayed(real.dead_time, dt)
        self._waiting = [np.array(x0[2:])] * waiting  # delayed commands, oldest first
        remembered = int(real.reading_age / dt) + 2 if real.reading_age else 0
        self._angles = [float(x0[0])] * remembered  # of the last samples, oldest first
        # by the shares of the forces that reach the joint, and the shut valves
        self._integrators = {((1.0, 1.0), real.shut): Buffered(_integrator(real, dt))}

    @property
    def x(self) -> Array:
        """True state (4,)."""
        return self._full[:NX].copy()

    def measure(self) -> Array:
        """Read the sensors (4,): θ, NaN for the unmeasured velocity, P1, P2. Every call draws new noise."""
        return self.read(self._noise.standard_normal(NU))

    def read(self, noise: Array) -> Array:
        """Read the sensors (4,) with the `noise` (2,) of the pressure sensors in standard deviations."""
        _, _, *P = self.x
        step, theta = self.real.encoder, self._angle_then
        read = step * np.round(theta / step) if step else theta
        y = np.array([read, np.nan, *(P + np.array(self.real.pressure_offset) + self.real.pressure_noise * noise)])
        for fault in self._faults:
            y = fault.read(y + fault.offset(self._sample * self.dt), self._said)
        self._said = y
        return y

    @property
    def _angle_then(self) -> float:
        """Angle [rad] at the time of the present reading, interpolated linearly between samples."""
        if not self._angles:
            return float(self._full[0])
        whole, part = divmod(self.real.reading_age / self.dt, 1.0)
        now, before = self._angles[-1 - int(whole)], self._angles[-2 - int(whole)]
        return now + part * (before - now)

    @property
    def _faults(self) -> list[Fault]:
        t = self._sample * self.dt
        return [fault for fault in self.real.faults if fault.active(t)]

    @property
    def memory(self) -> Array:
        """State of the experiment (n,) without the time: `x`, friction's memory, delayed commands, and angles to be
        read.
        """
        return np.concatenate([self._full, *self._waiting, self._angles])

    def recall(self, memory: Array, sample: int) -> None:
        """Set the state to a `memory` (n,), at the `sample` since the beginning."""
        there, angles = self._full.size, memory.size - len(self._angles)
        self._full, self._sample = np.array(memory[:there]), sample
        self._waiting = list(np.reshape(memory[there:angles], (-1, NU)))
        self._angles = memory[angles:].tolist()

    def advance(self, u: Array, d: float = 0.0) -> None:
        """Advance by one sample with the commands `u` (2,) [Pa] given now, and a torque `d` [N·m] added to the plant's
        own.
        """
        t = self._sample * self.dt
        d += outside_torque(self.real.torque_profile, t)
        self._waiting.append(np.array(u))
        for command, duration in zip(self._waiting, self._pieces, strict=False):
            for fault in self._faults:
                command = fault.effective(command, self._full[2:NX])
            self._full = self._integrate(self._full, command, d, duration)[0][0]
        self._waiting.pop(0)
        self._angles = [*self._angles, float(self._full[0])][1:] if self._angles else []
        self._sample += 1

    @property
    def _integrate(self) -> Buffered:
        faults, (g1, g2) = self._faults, self.real.force_gains
        pulling = (
            prod((fault.pulling[0] for fault in faults), start=1.0),
            prod((fault.pulling[1] for fault in faults), start=1.0),
        )
        gas = self.real.nominal.gas is not None  # without it a stuck valve's command is its constant pressure
        one, two = (own or (gas and any(fault.shut[i] for fault in faults)) for i, own in enumerate(self.real.shut))
        shut = one, two
        if (pulling, shut) not in self._integrators:
            broken = replace(self.real, force_gains=(g1 * pulling[0], g2 * pulling[1]), shut=shut)
            self._integrators[pulling, shut] = Buffered(_integrator(broken, self.dt))
        return self._integrators[pulling, shut]


@lru_cache(maxsize=16)
def _integrator(real: RealPlant, dt: float) -> "Function":
    """Return (x, u, d, duration) ↦ x, for at most one sample, in the fine steps of `simulate` for a `Plant`."""
    import casadi as ca

    n = NX + real.friction.size
    full, u, d, duration = ca.SX.sym("x", n), ca.SX.sym("u", NU), ca.SX.sym("d"), ca.SX.sym("duration")
    given = full, u, d, duration
    step = ca.Function("step", given, [ca.vertcat(*real.stepped(full[:NX], full[NX:], u, d, duration))])
    substeps, later = real.substeps(dt, FINE), full
    for _ in range(substeps):
        later = step(later, u, d, duration / substeps)
    return ca.Function("real", given, [later])


_UNITS = (
    ("dead_time", "s"), ("dead_band", "Pa"), ("encoder", "rad"), ("reading_age", "s"), ("pressure_noise", "Pa")
)  # fmt: skip
