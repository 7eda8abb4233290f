"""Kernel and numbers of a joint for the export, or the reason for a refusal."""

from typing import NamedTuple

import numpy as np

from allocator.allocation.two_muscles.kernels.choice import AffineNumbers, TonduNumbers
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.lazy import Function

Numbers = dict[str, tuple[float | int | str, str]]  # name: value, description
_BELOW_POLE = 1 - 1e-6  # of the pole: up to there forces are finite in either precision
_GRID = 181  # number of angles at which affine muscles are checked


class Kernel(NamedTuple):
    """One of the two allocation kernels in C, with the numbers of a joint."""

    name: str  # "tondu" or "affine", also the directory of the file that calls it
    numbers: Numbers


def kernel_of(joint: AntagonistJoint) -> Kernel:
    """Return the kernel of `joint`. Raises InvalidInput for a joint without a proved closed-form allocation."""
    if joint.tondu_pulley:
        if (tondu := TonduNumbers.of(joint)) is None:
            raise InvalidInput(
                f"the joint cannot be exported: its supply ({_bar(joint)}) comes so near to the pole of its Tondu2021 "
                f"muscles ({-joint.tondu_pulley.muscle.d / 1e5:.3g} bar) that a few steps of Newton's method may not do"
            )
        return Kernel("tondu", _limits(joint, tondu.hi, tondu.hi, tondu) | _tondu(tondu))
    if not joint.affine:
        raise InvalidInput(
            f"a joint with {type(joint.agonist).__name__} and {type(joint.antagonist).__name__} cannot be exported: "
            "its allocation has no closed form; take two muscles affine in the pressure, or two equal Tondu2021 on a "
            "pulley, or export its allocation alone as that of a mechanism, "
            "mpc.export.mechanism.export_mechanism(out, Mechanism.from_joint(joint))"
        )
    if (affine := AffineNumbers.of(joint)) is None:
        raise InvalidInput(
            f"the joint cannot be exported: its supply ({_bar(joint)}) begins above the pressures of its muscle models"
        )
    _check_affine(joint)
    return Kernel("affine", _limits(joint, affine.most1, affine.most2, affine))


def _limits(joint: AntagonistJoint, hi1: float, hi2: float, numbers: TonduNumbers | AffineNumbers) -> Numbers:
    return {
        "SUPPLY_LO": (numbers.lo, "supply [Pa]"),
        "SUPPLY_HI": (joint.pressure_limits[1], "[Pa]"),
        "HI1": (hi1, "greatest P1, of the supply or the model's validity [Pa]"),
        "HI2": (hi2, "greatest P2 [Pa]"),
        "HI1_LIMIT": (numbers.hi_limit1, "the limit that HI1 is, see antagonist.h"),
        "HI2_LIMIT": (numbers.hi_limit2, ""),
        "LEFT": (numbers.left, "joint range [rad]"),
        "RIGHT": (numbers.right, "[rad]"),
        "LEFT_LIMIT": (numbers.below, "the limit at either end"),
        "RIGHT_LIMIT": (numbers.above, ""),
    }


def _tondu(numbers: TonduNumbers) -> Numbers:
    return {
        "AREA": (numbers.S, "S [m^2]"),
        "RADIUS": (numbers.R, "R [m]"),
        "REST_LENGTH": (numbers.l0, "l0 [m]"),
        "EPS0": (numbers.eps0, "eps0 [-]"),
        "Q": (numbers.q, "q = a - b [-]"),
        "C": (numbers.c, "c [Pa]"),
        "D": (numbers.d, "d [Pa]"),
        "E": (numbers.e, "e [Pa^2]"),
        "G": (numbers.g, "g = e - c d [Pa^2]"),
        "MOST": (-_BELOW_POLE * numbers.d, "greatest pressure, below the pole -d [Pa]"),
    }


def _check_affine(joint: AntagonistJoint) -> None:
    """Check the assumptions of the exported code over the joint range."""
    theta = np.linspace(*joint.angle_range, _GRID)
    (t1, t2), (k1, k2) = joint.jacobian(theta, 0.0 * theta, 0.0 * theta)
    wrong = ~((t1 > 0) & (t2 < 0) & (t1 * k2 - t2 * k1 > 0) & (k1 != 0) & (k2 != 0))
    if wrong.any():
        raise InvalidInput(
            f"the joint cannot be exported: at {theta[np.argmax(wrong)]:.3g} rad more pressure does not pull more, or "
            "torque and stiffness depend on the pressures in the same way"
        )


def _bar(joint: AntagonistJoint) -> str:
    low, high = joint.pressure_limits
    return f"{low / 1e5:.3g} to {high / 1e5:.3g} bar"


def sides_function(joint: AntagonistJoint) -> "Function":
    """Return the CasADi function θ ↦ (A, B, a, k', k0), (…) of both muscles, as `affine_exact` takes them."""
    import casadi as ca

    theta = ca.SX.sym("theta")
    rows = [
        ca.vertcat(
            side.muscle.gain(0.0, side.contraction),
            side.force(0.0),
            side.moment_arm,
            side.stiffness_gain(0.0),
            side.stiffness(0.0),
        )
        for side in joint.sides(theta)
    ]
    return ca.Function("sides", [theta], [ca.densify(ca.cse(row)) for row in rows], ["theta"], ["one", "two"])


def stiffness_function(joint: AntagonistJoint) -> "Function":
    """Return the CasADi function (θ, P1, P2, A) ↦ (K, K_h, gas of both muscles, h) of `ant_stiffness_at`.

    The gas is NaN for a muscle of unknown volume.
    """
    import casadi as ca

    theta, P1, P2, A = (ca.SX.sym(name) for name in ("theta", "P1", "P2", "amplitude"))
    K = joint.stiffness(theta, P1, P2)
    hysteresis = joint.stiffness(theta, P1, P2, amplitude=A) - K
    pair = zip(joint.sides(theta, (1.0, 1.0)), (P1, P2), strict=True)
    gas = [side.trapped(P) if side.muscle.volume_known else ca.SX.nan() for side, P in pair]
    lost = joint.loop_work(theta, P1, P2, A) / (np.pi * A**2)
    out = ca.densify(ca.cse(ca.vertcat(K, hysteresis, *gas, lost)))
    return ca.Function("stiffness", [ca.vertcat(theta, P1, P2, A)], [out], ["at"], ["found"])
