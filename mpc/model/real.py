"""Simulated joints and arms with effects of real ones that the prediction model lacks.

A `RealPlant` of a joint is

    θ' = ω,   J ω' = T - b ω - m g l sin(θ - θ_h) - T_f + d(t),   T = g1 a1 F1 - g2 a2 F2
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

A `RealArm` has the same regulators, sensors and friction at each joint, and

    q' = ω,   s M(q) ω' = τ(q, P) - s (C(q, ω) + g(q)) - b D ω - T_f + d(t),   τ = Σ_j r_j g_j max(F_j, 0)

Masses differ from the nominal ones by a factor s and damping by b; a slack cable does not push.
"""

from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from math import prod, sqrt
from typing import Any, Self, TypeAlias

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.joint.antagonist import report_joint
from allocator.joint.gas import complex_share
from allocator.lazy import Function
from allocator.mechanism.formulas import symbolic_lengths
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.model.arm.formulas import rises, statics, varied_acceleration
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.experiment import integrated
from mpc.model.friction.contact import Hysteresis, Loads, symbolic_loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip, friction_of
from mpc.model.machine import Machine
from mpc.model.plant import NU, Plant
from mpc.model.pressures import trapped
from mpc.model.real_experiment import RealMachine


@dataclass(frozen=True, repr=False)
class RealPlant(RealMachine):
    """Nominal plant with model errors, friction, delays and faults added. Immutable; SI units."""

    nominal: Plant = field(default_factory=Plant)  # joint, link, gravity, lags
    force_gains: tuple[float, float] = (1.0, 1.0)  # g1, g2 [-]
    friction: Hysteresis = field(default_factory=Friction)

    def __post_init__(self) -> None:
        """Check the effects."""
        checks.instance("nominal", self.nominal, Plant, "a Plant")
        super().__post_init__()
        object.__setattr__(self, "friction", friction_of(self.friction))

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
            flow=max(5 * BAR, plant.slew),  # unless told, regulators have to fill as quickly as commands change
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
        """Return a controller's knowledge of this plant: its regulators, and a `share` [-] of the friction, as Dahl's.

        The whole friction would be best for this plant and worst if the friction vanished, because the compensation
        would then push the intended motion. Less is safe.
        """
        up, down = (sqrt(prod(lags)) for lags in zip(*self.lags, strict=True))
        friction = self.friction.as_dahl(self.nominal).share(share)
        return Compensation(friction, self.dead_time, self.dead_band, lag_up=up, lag_down=down, flow=self.flow)

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

    def symbolic_outputs(self, x: Value) -> tuple[Value, Value, Value]:
        """Return the true stiffness [N·m/rad], the torque [N·m] and the forces (2,) [N] in the state `x` (4,), CasADi
        symbols.
        """
        import casadi as ca

        return ca.SX(self.stiffness(x)), ca.SX(self.torque(x)), ca.vertcat(*self.forces(x))

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
            return self.friction.moved(memory, now[0] - x[0], Loads.of(self, now))

        def rate(now: Value, t: Value) -> Value:
            return ca.vertcat(*self.rate(now, u, d, self.friction.torque(remembered(now), Loads.of(self, now))))

        after = integrated(rate, x, h, 1)
        return after, remembered(after)

    def _pressure_rates(self, x: Value, u: Value) -> list[Value]:
        rates = self.regulated([u[i] - x[2 + i] for i in range(NU)])
        if self.nominal.gas is None:
            return rates
        return [rate - q for rate, q in zip(rates, self.nominal.expansion(x, self.force_gains), strict=True)]


@dataclass(frozen=True, repr=False)
class RealArm(RealMachine):
    """Nominal arm with model errors, friction, delays and faults added. Immutable; SI units.

    Raises `InvalidInput` for an arm without formulas, and for implausible effects.
    """

    nominal: Arm
    friction: Hysteresis | tuple[Hysteresis, ...] = field(default_factory=Friction)  # of all joints, or of each
    mass: float = 1.0  # s [-]
    damping: float = 1.0  # b [-]

    def __post_init__(self) -> None:
        """Check the effects and fill in the defaults."""
        if not isinstance(self.nominal, Arm):
            raise InvalidInput(f"RealArm: nominal is a {type(self.nominal).__name__}; expected an Arm")
        if missing := self.nominal.unformulated:
            raise InvalidInput(f"RealArm: an arm that differs from its model needs formulas, and {missing}")
        n = self.nominal.n
        given = self.friction if isinstance(self.friction, tuple) else (self.friction,) * n
        if len(given) != n:
            raise InvalidInput(f"RealArm: {len(given)} frictions for n = {n} joints; give one, or one each")
        object.__setattr__(self, "friction", tuple(map(friction_of, given)))
        for name in ("mass", "damping"):
            object.__setattr__(self, name, checks.positive(f"RealArm: {name}", getattr(self, name), "-"))
        super().__post_init__()

    def __getstate__(self) -> dict[str, object]:
        """Leave out the formulas, which cannot be pickled; each process creates them for itself."""
        return {each.name: getattr(self, each.name) for each in fields(self)}

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true stiffness (M, k, k) and muscle forces (M, m) [N] in the states `x` (M, 2n + m)."""
        return self.nominal.along(x, self.force_gains)

    def symbolic_outputs(self, x: Value) -> tuple[Value, Value, Value]:
        """Return the upper triangle of the joints' true isobaric stiffness [N·m/rad], the torques (n,) [N·m] and the
        forces (m,) [N] in the state `x` (2n + m,), CasADi symbols.
        """
        import casadi as ca

        s, n = statics(self.nominal.mechanism, self.force_gains), self.nominal.n
        rows, columns = np.triu_indices(n)
        K = ca.vertcat(*(s.stiffness[i, j] for i, j in zip(rows.tolist(), columns.tolist(), strict=True)))
        K, T, F = ca.Function("outputs", [s.q, s.P], [K, s.torque, s.forces])(x[:n], x[2 * n :])
        return K, T, F

    # --- the equations ----------------------------------------------------------------------------------------------

    @cached_property
    def rate(self) -> "Function":
        """CasADi function (x, u, d, T_f) ↦ x' of the acting commands, the external torques and the friction."""
        import casadi as ca

        arm, s = self.nominal, self.nominal.statics
        omega, d, T_f = (ca.SX.sym(name, arm.n) for name in ("omega", "d", "T_f"))
        u: Value = ca.SX.sym("u", arm.m)
        slope = ca.jacobian(symbolic_lengths(arm.mechanism.routes, s.q), s.q)
        F = ca.DM(self.force_gains) * ca.fmax(s.forces, 0.0)
        torque = d - slope.T @ F - T_f
        alpha = varied_acceleration(arm.bodies, s.q, omega, torque, self.mass, self.damping)
        filling: Value = ca.vertcat(*self.regulated(ca.vertsplit(u - s.P)))
        if arm.gas is not None:
            filling += ca.if_else(F > 0, ca.vertcat(*rises(arm, omega, self.force_gains)), 0.0)
        x = ca.vertcat(s.q, omega, s.P)
        return ca.Function("rate", [x, u, d, T_f], [ca.cse(ca.densify(ca.vertcat(omega, alpha, filling)))])

    @cached_property
    def rubbed(self) -> "Function":
        """CasADi function (q, z, x) ↦ the frictions' memory and T_f in `x` after a motion from `q` with memory z."""
        import casadi as ca

        q, x = ca.SX.sym("q", self.nominal.n), ca.SX.sym("x", self.nominal.size)
        memories = [ca.SX.sym("z", one.size) for one in self.frictions]
        loads, kept, torques = symbolic_loads(self.nominal, x), [], []
        for i, (one, memory, load) in enumerate(zip(self.frictions, memories, loads, strict=True)):
            kept.append(one.moved(memory, x[i] - q[i], load))
            torques.append(one.torque(kept[i], load))
        found = [ca.densify(ca.vertcat(*parts)) for parts in (kept, torques)]
        return ca.Function("rubbed", [q, ca.vertcat(*memories), x], ca.cse(found))

    def stepped(self, x: Value, memory: Value, u: Value, d: Value, h: Value) -> tuple[Value, Value]:
        """Return `x` (2n + m,) and the frictions' `memory` after a fine step of `h` [s], CasADi symbols."""
        begun = x[: self.nominal.n], memory

        def rate(now: Value, t: Value) -> Value:
            return self.rate(now, u, d, self.rubbed(*begun, now)[1])

        after = integrated(rate, x, h, 1)
        return after, self.rubbed(*begun, after)[0]


Real: TypeAlias = RealPlant | RealArm


def real_of(machine: Machine | RealMachine, known: Compensation | None = None, **effects: Any) -> Real:
    """Return `machine` with the `known` friction and regulators and further `effects` by name.

    A `Real` machine is returned as it is. Raises `InvalidInput` for other types and for implausible effects.
    """
    if isinstance(machine, Real):
        return machine
    if not isinstance(machine, Machine):
        raise InvalidInput(f"{checks.brief(machine)} is no machine: give a Plant, an Arm, a RealPlant or a RealArm")
    kind: Any = RealPlant if isinstance(machine, Plant) else RealArm
    made: Real = kind(machine, **effects) if known is None else kind.of(machine, known, **effects)
    return made
