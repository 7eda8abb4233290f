"""Kernel and numbers of a joint for the export, or the reason for a refusal.

The kernel (`kernel.h`, `kernel.c`) is printed from the source that Python, numba and NumPy run.
"""

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from allocator.allocation.status import Status
from allocator.allocation.two_muscles.kernels import source
from allocator.allocation.two_muscles.kernels.choice import AffineNumbers, TonduNumbers
from allocator.compilation.printer import (
    INT,
    REAL,
    ArrayKind,
    Constants,
    Kind,
    Outside,
    Printed,
    c_functions,
    with_called,
)
from allocator.errors import InvalidInput
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.limits import Limit
from allocator.lazy import Function
from mpc.export import text

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
        most: Numbers = {"MOST": (-_BELOW_POLE * tondu.d, "greatest pressure, below the pole -d [Pa]")}
        return Kernel("tondu", _numbers(joint, tondu.hi, tondu.hi, tondu) | most)
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
    return Kernel("affine", _numbers(joint, affine.most1, affine.most2, affine))


def _numbers(joint: AntagonistJoint, hi1: float, hi2: float, numbers: TonduNumbers | AffineNumbers) -> Numbers:
    """Return the numbers of joint.h."""
    ends: Numbers = {
        "SUPPLY_HI": (joint.pressure_limits[1], "[Pa]"),
        "HI1": (hi1, "greatest P1, of the supply or the model's validity [Pa]"),
        "HI2": (hi2, "greatest P2 [Pa]"),
    }
    listed = _LIMITS | (_TONDU if isinstance(numbers, TonduNumbers) else {})
    return ends | {name: (getattr(numbers, field), about) for field, (name, about) in listed.items()}


_LIMITS = {  # elements of `p`: their names in joint.h, with descriptions
    "lo": ("SUPPLY_LO", "supply [Pa]"),
    "hi_limit1": ("HI1_LIMIT", "the limit that HI1 is, see antagonist.h"),
    "hi_limit2": ("HI2_LIMIT", ""),
    "left": ("LEFT", "joint range [rad]"),
    "right": ("RIGHT", "[rad]"),
    "below": ("LEFT_LIMIT", "the limit at either end"),
    "above": ("RIGHT_LIMIT", ""),
}
_TONDU = {
    "S": ("AREA", "S [m^2]"),
    "R": ("RADIUS", "R [m]"),
    "l0": ("REST_LENGTH", "l0 [m]"),
    "eps0": ("EPS0", "eps0 [-]"),
    "q": ("Q", "q = a - b [-]"),
    "c": ("C", "c [Pa]"),
    "d": ("D", "d [Pa]"),
    "e": ("E", "e [Pa^2]"),
    "g": ("G", "g = e - c d [Pa^2]"),
}
_OTHERS = {"near": "NEAR", "hi": "HI1", "least": "-INFINITY", "most": "MOST", "most1": "HI1", "most2": "HI2"}


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


_ABSENT = {
    "min_force": "min_force <= -ANT_INFINITY",
    "max_force": "max_force >= ANT_INFINITY",
    "max_step": "max_step >= ANT_INFINITY",
    "stiffness_first": "!stiffness_first",
}
_FLAGS = "lower", "slack", "force", "rate", "hi_limit", "outside", "status1", "status2", "stiffness_first"
_RESULT = ("P1", "P2", "T_given", "K_given", "status", "limits", "sure")


def printed(name: str, single: bool) -> Printed:
    """Return the kernel `name`, "tondu" or "affine", as C, the same for every joint of the kind."""
    of: type[TonduNumbers | AffineNumbers] = TonduNumbers if name == "tondu" else AffineNumbers
    names = {field: told for field, (told, _) in (_LIMITS | _TONDU).items()} | _OTHERS
    numbers = [(_text(names[field]), INT if kind is int else REAL) for field, kind in of.__annotations__.items()]
    side = ArrayKind(REAL, ("5",), True)
    kinds: dict[str, Kind] = {"p": Constants(numbers), "one": side, "two": side, **dict.fromkeys(_FLAGS, INT)}
    structs = {("P1", "P2"): "ant_pair", _RESULT: "ant_answer"}
    outside = Outside(C_NAMES | {"MET": "ANT_MET"} | _flags(), structs, _ABSENT, REAL, "ANT_ONCE")
    entry = getattr(source, f"{name}_exact")
    return c_functions(with_called([entry]), kinds, single, {entry.__name__: f"ant_{name}_exact"}, {}, outside)


C_NAMES = {"clip": "ant_clip"} | {s.name: f"ANT_{s.name}" for s in Status if getattr(source, s.name, None) == s}
"""Functions and constants of the kernels that C has."""


def _text(defined: str) -> str:
    return f"-ANT_{defined[1:]}" if defined.startswith("-") else f"ANT_{defined}"


def _flags() -> dict[str, str]:
    return {name: _listed(getattr(source, name)) for name in ("AGONIST", "ANTAGONIST")}


def _listed(flags: Iterable[int]) -> str:
    return f"{{{', '.join(f'ANT_{Limit(flag).name}' for flag in flags)}}}"


def kernel_files(name: str, single: bool) -> dict[str, str]:
    """Return the files of the kernel `name`."""
    made = printed(name, single)
    about = "The exact allocation of one target, printed from the Python source."
    return {
        "src/kernel.h": text.header("ANT_KERNEL_H", about, made.head, ["antagonist.h"]),
        "src/kernel.c": f'/* {about} */\n#include "kernel.h"\n\n#include "joint.h"\n#include "real.h"\n\n{made.body}\n',
    }
