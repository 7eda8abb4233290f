"""Simulated arm with effects of real ones that the prediction model lacks, the counterpart of `RealPlant`.

    q' = ω,   s M(q) ω' = τ(q, P) - s (C(q, ω) + g(q)) - b D ω - T_f + d(t),   τ = Σ_j r_j g_j max(F_j, 0)
    P_j' = dz(u_j(t - t_dead) - P_j)/τ_j within ± flow - κ (P_j + p_a) V_j'/V_j^eff, the last term with gas only
    measured: q(t - t_age) rounded to the encoder's step, P_j + o_j + noise; not ω

Masses differ from the nominal ones by a factor s, damping by b, the muscles' strengths by g_j; a slack cable does not
push. The friction T_f of each joint, regulators and sensors are those of `mpc.model.real_plant`.
"""

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import Function
from allocator.mechanism.formulas import symbolic_lengths
from mpc.model.arm.formulas import rises, statics, varied_acceleration
from mpc.model.arm.model import Arm
from mpc.model.arm.pressing import symbolic_loads
from mpc.model.friction.contact import Hysteresis
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import friction_of
from mpc.model.integration import integrated
from mpc.model.real_experiment import RealMachine


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
