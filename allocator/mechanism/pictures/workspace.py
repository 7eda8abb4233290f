"""The stiffness ellipses that a hand can have are drawn where the hand is."""

from typing import TYPE_CHECKING

import numpy as np

from allocator.calculus import Array
from allocator.presentation.plotting import GREY, legend_outside, name_axes, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from allocator.mechanism.feasibility.ellipses import EndpointEllipses

_MOST_NUMBERS = 60
_TURN = np.linspace(0, 2 * np.pi, 73)
_FAN, _STIFF, _SOFT = "#dbe7f1", "#1f4e79", "#d08770"


def ellipse(K: Array) -> Array:
    """Return the curve (2, 73) of the forces K·u [N/m] that unit displacements u meet: long where the hand is stiff."""
    return np.asarray(K @ np.stack([np.cos(_TURN), np.sin(_TURN)]))


def plot_workspace(found: "EndpointEllipses", axes: "Axes | None" = None) -> "Axes":
    """Draw the softest and the stiffest ellipse at every place, over the fan of tilts that its long axis can have.

    Every place has a scale of its own; the number beside it is the longest half axis [N/m]. Returns the Matplotlib
    axes.
    """
    axes = new_axes(8.2, 5.6) if axes is None else axes
    axes.set_aspect("equal")
    name_axes(axes, "x of the hand [m]", "y of the hand [m]")
    numbers = "; beside it the longest half axis [N/m]" if np.count_nonzero(found.exists) <= _MOST_NUMBERS else ""
    axes.set_title(f"stiffness of the hand{numbers}", fontsize="medium", loc="left")
    x, softest, stiffest, tilt = (part[found.exists] for part in (found.x, found.softest, found.stiffest, found.tilt))
    missing = found.x[~found.exists]
    if len(missing):
        axes.plot(*missing.T, "x", color=GREY, markersize=5, label="torques do not exist")
    if not len(x):
        return axes
    radius = 0.46 * _spacing(found.x.reshape(-1, 2))  # of the stiffest [m]
    longest = np.linalg.eigvalsh(stiffest)[:, -1]
    for i, place in enumerate(x):
        length = radius / longest[i]  # [m] for 1 N/m
        _fan(axes, place, tilt[i], radius)
        for K, colour, width, label in (
            (stiffest[i], _STIFF, 1.6, "stiffest"),
            (softest[i], _SOFT, 1.6, "softest"),
        ):
            axes.plot(*(place[:, None] + length * ellipse(K)), color=colour, linewidth=width, label=label)
        if len(x) <= _MOST_NUMBERS:
            axes.annotate(f"{longest[i]:.0f}", place - [0, 1.05 * radius], ha="center", va="top", fontsize="x-small")
    legend_outside(axes)
    return axes


def _fan(axes: "Axes", place: Array, tilt: Array, radius: float) -> None:
    """Draw the sector of the tilts to both sides."""
    angle = np.linspace(tilt[0], tilt[1], 60)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)])
    both = np.concatenate([np.zeros((2, 1)), rim, np.zeros((2, 1)), -rim, np.zeros((2, 1))], axis=1)
    axes.fill(*(place[:, None] + both), color=_FAN, linewidth=0, label="tilts of the long axis")


def _spacing(places: Array) -> float:
    """Return the median distance of a place to its nearest neighbour, or the arm's reach of a single one."""
    if len(places) < 2:
        return float(np.hypot(*places[0])) or 1.0
    distance = np.hypot(*(places[:, None] - places[None]).transpose(2, 0, 1))
    np.fill_diagonal(distance, np.inf)
    return float(np.median(distance.min(axis=1)))
