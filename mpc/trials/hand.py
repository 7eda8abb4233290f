"""The way of an arm's hand in a run, and how far a force moves it there."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.mechanism.endpoint import Endpoint
from mpc.model.arm.bodies import Bodies
from mpc.model.arm.model import Arm
from mpc.trials.simulation import Run

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# Okabe & Ito's colours, told apart by colour-blind eyes
COLOURS = "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c"
_BLACK = "#000000"
_SHOWN = 0.02  # [m] to all sides
_GOLDEN = 0.5 * (5**0.5 - 1)  # whose multiples meet no period twice


class Way(NamedTuple):
    """A `Way` is where a hand went and where it should have gone, in the two coordinates in which it moved most."""

    names: tuple[str, str]
    x: Array  # (M+1, 2) [m]
    asked: Array  # (M+1, 2) [m]
    J: Array  # ∂x/∂q (M+1, 2, n) [m/rad]


def way_of(run: Run, hand: Endpoint | None = None) -> Way | None:
    """Return the way of `hand`, else of the endpoint that is tracked, or of the end of a chain in the plane.

    None for a joint, and where less than two coordinates are known.
    """
    arm = run.plant
    if not isinstance(arm, Arm):
        return None
    hand = hand or arm.endpoint or (arm.bodies.endpoint if isinstance(arm.bodies, Bodies) else None)
    if hand is None or hand.dim < 2:
        return None
    place, asked = hand.at(run.theta), hand.at(run.theta_ref)
    two = np.sort(np.argsort(-np.ptp(asked.position, axis=0))[:2])
    names = getattr(hand.kinematics, "axes", "123456789")
    return Way((names[two[0]], names[two[1]]), place.position[:, two], asked.position[:, two], place.jacobian[:, two])


def draw_hand(axes: "Axes", run: Run, way: Way) -> None:
    """Draw the way of the hand, its reference, and the arm in the plane where it ends."""
    axes.plot(way.asked[:, 0], way.asked[:, 1], color=_BLACK, ls="--", lw=1, label="reference")
    axes.plot(way.x[:, 0], way.x[:, 1], color=COLOURS[0], lw=1.2, label="hand")
    if isinstance(run.plant.bodies, Bodies):
        points = run.plant.bodies.points(run.theta[-1])
        axes.plot(points[:, 0], points[:, 1], color=COLOURS[7], lw=3, marker="o", zorder=0)
    _at_least(axes, way.asked)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="the way of the hand")
    axes.legend(frameon=False, fontsize="small")


def draw_ellipses(axes: "Axes", run: Run, way: Way) -> None:
    """Draw what forces of 1 N in all directions move the hand by, at some moments: the compliance J K⁻¹ Jᵀ."""
    K_joints = run.plant.stiffness(run.x)
    turn = np.linspace(0, 2 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)])
    for k in (np.arange(9) * _GOLDEN % 1 * (len(run.t) - 1)).astype(int):
        J, stiff = way.J[k], K_joints[k] + run.plant.bodies.gravity_stiffness(run.theta[k])
        moved = J @ np.linalg.solve(stiff, J.T) @ circle
        x, y = way.x[k]
        axes.plot(x + moved[0], y + moved[1], color=COLOURS[0], lw=1)
        axes.plot(x, y, ".", color=COLOURS[1], ms=3)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{way.names[0]} [m]", ylabel=f"{way.names[1]} [m]", title="where 1 N moves the hand")


def _at_least(axes: "Axes", points: Array) -> None:
    """Let `axes` show some centimetres about `points` (…, 2): a hand that is held is no microscope's object."""
    middle, half = points.mean(axis=0), np.maximum(np.ptp(points, axis=0) / 2, _SHOWN)
    axes.plot(*np.transpose([middle - half, middle + half]), alpha=0.0)
