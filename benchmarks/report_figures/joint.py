"""Figures 3 and 8: difference and sum of the pressures over the angle, at constant stiffness and without torque."""

import numpy as np

from allocator.calculus import Array, Mask
from allocator.closed_form import inverse
from allocator.joint.antagonist import AntagonistJoint, report_joint
from allocator.joint.geometry import Pulley
from allocator.joint.torque_levels import Pair
from allocator.muscles.catalogue import TONDU_MCKIBBEN
from allocator.units import BAR, DEG
from benchmarks.report_figures.panel import Curve, Panel

_ANGLE = "joint angle θ [°]"
_STEPS = 501
_LETTERS = (("(a) difference of the pressures", "P1 - P2 [bar]"), ("(b) sum of the pressures", "P1 + P2 [bar]"))
MCKIBBEN_STIFFNESSES = np.arange(1.0, 6.5, 1.0)  # [N·m/rad]
FESTO_STIFFNESSES = np.arange(6.0, 9.1, 0.5)  # [N·m/rad]; the report gives the range, not the step


def mckibben_joint() -> AntagonistJoint:
    """Return the report's joint of ideal McKibben muscles: ε0 = ε_max/2, ±145°."""
    pulley = Pulley(0.40, 0.02, TONDU_MCKIBBEN.max_contraction / 2)
    return AntagonistJoint(pulley, TONDU_MCKIBBEN, TONDU_MCKIBBEN, angle_limits=(-145 * DEG, 145 * DEG))


def figure_3() -> tuple[Panel, ...]:
    """Compute figure 3, of ideal McKibben muscles (9), (10): pressures within 0 … 5 bar for K = 1 … 6 N·m/rad over
    ±145°.
    """
    return _panels("3", mckibben_joint(), MCKIBBEN_STIFFNESSES, slack_too=True)


def figure_8() -> tuple[Panel, ...]:
    """Compute figure 8, of Festo muscles: the pressures within 0 … 5 bar for K = 6 … 9 N·m/rad over ±125°.

    Like the report it has only the pressures; the curves are meaningless where a cable would be slack, see
    `figure_8_marked`.
    """
    return _panels("8", report_joint(), FESTO_STIFFNESSES, slack_too=True)


def figure_8_marked() -> tuple[Panel, ...]:
    """Compute figure 8 with infeasible parts marked: dashed for a slack cable, dotted beyond the supply pressure."""
    return _panels("8", report_joint(), FESTO_STIFFNESSES, slack_too=False)


def _panels(number: str, joint: AntagonistJoint, stiffnesses: Array, *, slack_too: bool) -> tuple[Panel, ...]:
    theta = np.linspace(*joint.angle_range, _STEPS)
    curves: tuple[list[Curve], list[Curve]] = ([], [])
    for K in stiffnesses:
        pair = inverse(theta, K, 0.0, joint=joint)
        for style, where in _parts(joint, theta, pair, slack_too).items():
            for panel, P in zip(curves, (pair[0] - pair[1], pair[0] + pair[1]), strict=True):
                panel.append(Curve(f"{K:g} N·m/rad", theta / DEG, np.where(where, P / BAR, np.nan), style))
    styles = (
        () if slack_too else (("line", "both taut"), ("dashed", "a cable is slack"), ("dotted", "beyond 0 … 5 bar"))
    )
    return tuple(
        Panel(f"{number}{letter}", _ANGLE, y, tuple(panel), styles)
        for (letter, y), panel in zip(_LETTERS, curves, strict=True)
    )


def _parts(joint: AntagonistJoint, theta: Array, pair: Pair, slack_too: bool) -> dict[str, Mask]:
    """Return the parts of the curve by style."""
    low, high = joint.pressure_limits
    supplied = np.logical_and.reduce([(low <= P) & (P <= high) for P in pair])
    if slack_too:
        return {"line": supplied}
    taut = np.logical_and.reduce([F >= 0 for F in joint.forces(theta, *pair)])
    return {"line": supplied & taut, "dashed": _grown(supplied & ~taut), "dotted": _grown(~supplied)}


def _grown(where: Mask) -> Mask:
    """Return the parts with one more point at either end, so that adjacent parts meet."""
    padded = np.pad(where, 1)
    return np.asarray(padded[:-2] | padded[1:-1] | padded[2:])
