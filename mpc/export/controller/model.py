"""Formulas of an exported controller's machine, as CasADi functions that the C files call by their names.

Friction is exported as the kind of model, its elements and its dependence on the state. Both supported models are T_f =
strength · Σ k_i m_i. The angle moves the memories m_i, each bounded by a half width that `scale` multiplies;
`mpc/export/c/mpc/friction.c` moves them.
"""

from collections.abc import Iterator, Sequence
from math import inf
from typing import Any

import numpy as np

from allocator.calculus import Array, Value
from allocator.errors import InvalidInput
from allocator.lazy import Function
from mpc.export.joint import Numbers
from mpc.export.parts import Functions, dense
from mpc.model.arm.formulas import falls, pressure_functions
from mpc.model.compensation import Compensation
from mpc.model.experiment import variational
from mpc.model.friction.contact import Hysteresis, Loads, symbolic_loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip
from mpc.model.machine import Machine
from mpc.model.plant import NU, NX, Plant
from mpc.tracking.controller import TrackingMPC

_NEVER = 1e30  # [rad], in place of an infinite width


def check_frictions(known: Compensation, n: int) -> None:
    """Raise `InvalidInput` for friction models of `n` joints without a C implementation, or of different kinds."""
    frictions = known.of_joints(n)
    for friction in frictions:
        if not isinstance(friction, Friction | MaxwellSlip):
            raise InvalidInput(
                f"a controller with friction {type(friction).__name__} cannot be exported: the C code supports "
                "Dahl's Friction and MaxwellSlip"
            )
    if len(set(map(type, frictions))) > 1:
        raise InvalidInput(
            "a controller with Dahl's Friction at one joint and MaxwellSlip at another cannot be exported: take one "
            "kind for all joints"
        )


def _slips(frictions: Sequence[Hysteresis]) -> bool:
    return isinstance(frictions[0], MaxwellSlip)


def friction_sizes(frictions: Sequence[Hysteresis]) -> Numbers:
    """Return the sizes of the friction memory."""
    return {
        "SLIPS": (int(_slips(frictions)), "1 for Maxwell slip, 0 for Dahl's friction"),
        "ELEMENTS": (max(friction.size for friction in frictions), "numbers in the friction memory of a joint"),
    }


def friction_numbers(frictions: Sequence[Hysteresis]) -> Numbers:
    """Return the parameters of the model."""
    return {"NEVER": (_NEVER, "half width of an element that never slips [rad]")} if _slips(frictions) else {}


def friction_tables(frictions: Sequence[Any]) -> Iterator[tuple[str, str, Array]]:
    """Yield the parameters of every joint's friction: name, meaning, values."""
    if not _slips(frictions):
        yield "ANT_PRESLIDING", "presliding of Dahl's friction [rad]", np.array([f.presliding for f in frictions])
        return
    springs, widths = np.zeros((2, len(frictions), max(f.size for f in frictions)))
    widths[:] = _NEVER  # absent elements have no spring
    for i, friction in enumerate(frictions):
        springs[i, : friction.size] = friction.springs
        widths[i, : friction.size] = [_NEVER if r == inf else r for r in friction.widths]
    unit = "-" if frictions[0].elastic else "N*m/rad"
    yield "ANT_SPRINGS", f"stiffnesses of the Maxwell-slip elements of each joint [{unit}]", springs
    yield "ANT_WIDTHS", "their half widths at a mean pressure of 2.5 bar [rad]", widths


def friction_function(known: Compensation, plant: Machine) -> tuple["Function", str]:
    """Return the CasADi function from the state to the two load numbers of friction, and its description."""
    import casadi as ca

    x = ca.SX.sym("x", plant.size)
    loads = symbolic_loads(plant, x)
    pairs = [_of_state(friction, load) for friction, load in zip(known.of_joints(plant.n), loads, strict=True)]
    strength, scale = (ca.densify(ca.SX(ca.vertcat(*each))) for each in zip(*pairs, strict=True))
    function = ca.Function("friction", [x], ca.cse([strength, scale]), ["x"], ["strength", "scale"])
    return function, "greatest torque of Dahl's friction [N*m], or the factor of the springs; scale of their widths"


def _of_state(friction: Any, load: Loads) -> tuple[Value, Value]:
    if isinstance(friction, MaxwellSlip):
        return friction.strength(load), friction.scale(load.filled)
    return friction.most(load), 1.0


def joint_functions(controller: TrackingMPC) -> Functions:
    """Return the CasADi functions of a joint and its friction, each with its description."""
    import casadi as ca

    plant = controller.plant
    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    q, omega, alpha = ca.SX.sym("q"), ca.SX.sym("omega"), ca.SX.sym("alpha")
    rate = ca.SX(ca.vertcat(*plant.rate(x, u, d)))
    K, F = ca.SX(plant.stiffness(x)), ca.vertcat(*plant.forces(x))
    C, D = ca.gradient(K, x), ca.jacobian(F, x).T
    slopes = [ca.SX(side.torque_gain(P)) for side, P in zip(plant.joint.sides(x[0]), (x[2], x[3]), strict=True)]
    moving = {"q": q, "omega": omega, "alpha": alpha}

    state = {"x": x}
    return [
        (dense("rate", {"x": x, "u": u, "d": d}, {"rate": rate}), "the rate of the state"),
        *_motion(plant),
        (dense("outputs", state, {"K": K, "F": F}), "stiffness and both forces"),
        (dense("gradients", state, {"C": C, "D": D}), "their derivatives by x, (4) and (2, 4)"),
        (
            dense("holding", state, {"K": ca.SX(plant.isobaric(x)), "slopes": ca.vertcat(*slopes)}),
            "stiffness, and derivatives of the torque by the pressures",
        ),
        (dense("torque_for", moving, {"T": ca.SX(plant.torque_for(q, omega, alpha))}), "torque of a motion [N*m]"),
        friction_function(controller.compensation, plant),
        (
            dense("expansion", state, {"q": ca.SX(ca.vertcat(*plant.expansion(x)))}),
            "pressure loss by expansion of the muscles [Pa/s]",
        ),
    ]


def variational_of(plant: Plant) -> "Function":
    """Return the CasADi function (x, S, u, d) ↦ (x', S') of a joint, S = ∂x/∂(x(0), u, d)."""
    import casadi as ca

    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    return variational(x, [u, d], ca.vertcat(u, d), ca.SX(ca.vertcat(*plant.rate(x, u, d))))


def _motion(plant: Plant) -> Functions:
    """Return the functions that begin y = (x, entries of S) at a state, have its rate, and end it: see motion.h."""
    import casadi as ca

    rates = variational_of(plant)
    pattern = rates.sparsity_in(1)
    x, u, d = ca.SX.sym("x", NX), ca.SX.sym("u", NU), ca.SX.sym("d")
    y, start = ca.SX.sym("y", NX + pattern.nnz()), ca.horzcat(ca.DM.eye(NX), ca.DM(NX, NU + 1))
    S = ca.SX(pattern, y[NX:])
    slope, S_slope = rates(y[:NX], S, u, d)
    A, B, by_d = (part.T for part in ca.horzsplit(S, [0, NX, NX + NU, NX + NU + 1]))  # CasADi stores columns, C rows
    return [
        (
            dense("begun", {"x": x}, {"y": ca.vertcat(x, ca.project(start, pattern).nz[:])}),
            "a state and its derivatives by itself, u and d, see motion.h",
        ),
        (
            dense("variational", {"y": y, "u": u, "d": d}, {"rate": ca.vertcat(slope, S_slope.nz[:])}),
            "the rate of these",
        ),
        (
            dense("ended", {"y": y}, {"later": y[:NX], "A": A, "B": B, "by_d": by_d}),
            "the state and its derivatives by x (4, 4), u (4, 2) and d (4)",
        ),
    ]


_OF_PRESSURES = {
    "pressures": "the rates of the pressures [Pa/s]",
    "pressure_slopes": "their derivatives, those by q, w and P as rows, and by their commands",
}


def arm_functions(controller: TrackingMPC) -> Functions:
    """Return the CasADi functions of an arm and its friction, each with its description."""
    import casadi as ca

    arm = controller.plant
    s, bodies = arm.statics, arm.bodies
    x, q, P = ca.SX.sym("x", arm.size), s.q, s.P
    omega, alpha, d = (ca.SX.sym(name, arm.n) for name in ("omega", "alpha", "d"))
    pushing, M = s.torque - bodies.bias(q, omega), bodies.mass_matrix(q)

    def of_state(value: "ca.SX") -> "ca.SX":
        return ca.Function("of_state", [q, P], [value])(x[: arm.n], x[2 * arm.n :])

    y = arm.outputs
    by = ca.jacobian(y, ca.vertcat(q, P)).T  # CasADi stores columns, C rows
    moving, state = {"q": q, "omega": omega, "P": P}, {"x": x}
    outputs = {"K": of_state(y[: arm.stiffnesses]), "F": of_state(y[arm.stiffnesses :])}
    holding = {"K": of_state(s.stiffness), "slopes": of_state(ca.jacobian(s.torque, P).T)}
    return [
        (dense("dynamics", moving | {"d": d}, {"M": M, "pushing": pushing + d}), "mass matrix; tau - C - D w - g + d"),
        (
            dense(
                "dynamics_slopes",
                moving | {"alpha": alpha},
                {"by": ca.jacobian(pushing - M @ alpha, ca.vertcat(q, omega, P))},
            ),
            "derivatives of the latter less M w', those by q, w and P as rows",
        ),
        (dense("outputs", state, outputs), "stiffness times ANT_SVEC, and all forces"),
        (dense("gradients", state, {"by": of_state(by)}), "their derivatives by (q, P), one output a row"),
        (dense("holding", state, holding), "the joints' stiffness, and derivatives of the torques by the pressures"),
        (
            dense("torque_for", {"q": q, "omega": omega, "alpha": alpha}, {"T": bodies.torque_for(q, omega, alpha)}),
            "torques of a motion [N*m]",
        ),
        friction_function(controller.compensation, arm),
        (
            dense("expansion", state, {"q": ca.substitute(falls(arm, omega), ca.vertcat(q, omega, P), x)}),
            "pressure loss by expansion of the muscles [Pa/s]",
        ),
        *((dense(name, *parts), _OF_PRESSURES[name]) for name, parts in pressure_functions(arm).items()),
    ]
