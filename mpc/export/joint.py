"""What of a joint the exported allocation needs: its law and its numbers, or why it cannot be exported."""

from typing import Any, NamedTuple

import numpy as np

from allocator.errors import InvalidInput
from allocator.joint import AntagonistJoint
from allocator.limits import Limit

_GRID = 181  # angles at which the law is checked


class Law(NamedTuple):
    """One of the two laws there is C code for."""

    directory: str  # of its files
    numbers: dict[str, tuple[float, str]]  # name: value, what it is


def law_of(joint: AntagonistJoint) -> Law:
    """The law of `joint`. Raises InvalidInput for a joint whose allocation has no closed form that is proved."""
    if joint.tondu_pulley:
        return Law("tondu", _tondu(joint))
    if not joint.affine:
        raise InvalidInput(
            f"a joint with {type(joint.agonist).__name__} and {type(joint.antagonist).__name__} cannot be exported: "
            "its allocation has no closed form; take two muscles affine in the pressure, or two equal Tondu2021 on a "
            "pulley"
        )
    _check_affine(joint)
    return Law("affine", {})


def numbers_of(joint: AntagonistJoint) -> dict[str, tuple[float | int, str]]:
    """Name, value and meaning of the limits of `joint`."""
    (lo, supply), (left, right) = joint.pressure_limits, joint.angle_range
    valid = joint.agonist.max_pressure, joint.antagonist.max_pressure
    hi1, hi2 = (min(pressure, supply) for pressure in valid)
    if not lo < min(hi1, hi2):
        raise InvalidInput(
            f"the joint cannot be exported: its supply begins at {lo:g} Pa, above the {min(valid):g} Pa up to which "
            "its muscle models hold"
        )
    limits = (Limit.P1_UPPER, Limit.AGONIST_VALIDITY), (Limit.P2_UPPER, Limit.ANTAGONIST_VALIDITY)
    limit1, limit2 = (kinds[pressure < supply] for kinds, pressure in zip(limits, valid, strict=True))
    return {
        "SUPPLY_LO": (lo, "supply [Pa]"),
        "SUPPLY_HI": (supply, "[Pa]"),
        "HI1": (hi1, "greatest P1, of the supply or the model's validity [Pa]"),
        "HI2": (hi2, "greatest P2 [Pa]"),
        "HI1_LIMIT": (int(limit1), "which of the two limits it is"),
        "HI2_LIMIT": (int(limit2), ""),
        "LEFT": (left, "joint range [rad]"),
        "RIGHT": (right, "[rad]"),
        "LEFT_LIMIT": (int(joint.angle_limit(False)), "what ends it"),
        "RIGHT_LIMIT": (int(joint.angle_limit(True)), ""),
    }


def _tondu(joint: AntagonistJoint) -> dict[str, tuple[float, str]]:
    closed = joint.tondu_pulley
    assert closed is not None  # the caller asked
    m, pulley, (lo, supply) = closed.muscle, closed.pulley, joint.pressure_limits
    weakest, strongest = 1 / (lo + m.d), 1 / (min(supply, m.max_pressure) + m.d)
    steepest = -m.g * pulley.initial_contraction * strongest**2 / (m.a - m.b)
    if (strongest - weakest) / (strongest + weakest) > 0.5 or steepest > 0.8:
        raise InvalidInput(
            "the joint cannot be exported: its supply comes so near to the pole of its Tondu2021 muscles, "
            f"{-m.d / 1e5:.3g} bar, that the steps of the exported Newton's method are not proved to suffice"
        )
    return {
        "AREA": (m.S, "S [m^2]"),
        "RADIUS": (pulley.radius, "R [m]"),
        "REST_LENGTH": (pulley.rest_length, "l0 [m]"),
        "EPS0": (pulley.initial_contraction, "eps0 [-]"),
        "Q": (m.a - m.b, "q = a - b [-]"),
        "C": (m.c, "c [Pa]"),
        "D": (m.d, "d [Pa]"),
        "G": (m.g, "g = e - c d [Pa^2]"),
    }


def _check_affine(joint: AntagonistJoint) -> None:
    """Insist on what the exported code presumes all over the joint range."""
    theta = np.linspace(*joint.angle_range, _GRID)
    (t1, t2), (k1, k2) = joint.jacobian(theta, 0.0 * theta, 0.0 * theta)
    wrong = ~((t1 > 0) & (t2 < 0) & (t1 * k2 - t2 * k1 > 0) & (k1 != 0) & (k2 != 0))
    if wrong.any():
        raise InvalidInput(
            f"the joint cannot be exported: at {theta[np.argmax(wrong)]:.3g} rad more pressure does not pull more, or "
            "torque and stiffness depend on the pressures in the same way"
        )


def sides_function(joint: AntagonistJoint) -> Any:
    """CasADi function θ ↦ (A, B, a, k', k0) of the agonist and of the antagonist, as in affine/law_state.h."""
    import casadi as ca

    theta = ca.SX.sym("theta")
    rows = [
        ca.vertcat(
            side.muscle.gain(0.0, side.contraction),
            side.force(0.0),
            side.arm,
            side.stiffness_gain(0.0),
            side.stiffness(0.0),
        )
        for side in joint.sides(theta)
    ]
    return ca.Function("sides", [theta], [ca.densify(ca.cse(row)) for row in rows], ["theta"], ["one", "two"])


__all__ = ["Law", "law_of", "numbers_of", "sides_function"]
