"""Explorer as one file: the page with its answers on a grid, for a browser without the command.

Every number is an answer of `allocate`: the page's sliders step along the grid and nothing is interpolated. Supply,
geometry and valves are those of the joint.
"""

import gzip
import json
from base64 import b64encode
from collections.abc import Callable, Iterable, Sequence
from importlib import resources
from itertools import product
from typing import TypeAlias

import numpy as np

from allocator import AntagonistJoint, stiffness_interval
from allocator.calculus import Array
from allocator.units import DEG
from mpc.explorer.question import Answer, Question, describe

Grid: TypeAlias = dict[str, list[float]]
"""Least and greatest value and step by name, in the page's units."""

_ANGLES, _STIFFNESSES, _TORQUES = 25, 25, 16  # steps at most
_DIGITS = 6
_PLACE = '<script id="saved" type="text/plain"></script>'


def grid(joint: AntagonistJoint) -> Grid:
    """Return the grid: angles [°] of the joint's range, stiffnesses [N·m/rad] and torques [N·m] within its reach."""
    left, right = (angle / DEG for angle in joint.angle_range)
    middle, high = sum(joint.angle_range) / 2, joint.pressure_limits[1]
    reach = 0.8 * float(joint.torque(middle, high, joint.pressure_limits[0]))
    most = 1.1 * float(joint.stiffness(middle, high, high))
    _, last, step = _steps(0.0, most, _STIFFNESSES)
    return {
        "theta": _steps(left, right, _ANGLES),
        "stiffness": [step, last, step],
        "torque": _steps(-reach, reach, _TORQUES),
    }


def saved_page(
    joint: AntagonistJoint,
    run: dict[str, object] | None = None,
    progress: Callable[[Sequence[Question]], Iterable[Question]] = iter,
) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    joint
        Joint of two muscles.
    run
        Frames of a run that the page plays, see `mpc.explorer.server.frames`.
    progress
        Wrapper of the iteration over the grid, e.g. `rich.progress.track`.
    """
    axes = grid(joint)
    theta, K, T = (np.round(np.arange(low, high + step / 2, step), 9) for low, high, step in axes.values())
    reach = dict(zip(product(theta, T), zip(*_reach(joint, theta, T), strict=True), strict=True))
    targets = [Question(*target) for target in product(*(axis.tolist() for axis in (theta, K, T)))]
    states = [Answer(target, joint).state(reach[target.theta, target.torque]) for target in progress(targets)]
    outlines = [Answer(Question(torque=float(torque)), joint).outline() for torque in T]
    known = describe(joint) | {"run": run, "controls": [], "gas": False}
    answers = {"grid": axes, "joint": known, "states": states, "outlines": outlines}
    packed = gzip.compress(json.dumps(_rounded(answers), allow_nan=False).encode(), mtime=0)
    page = resources.files("mpc.explorer").joinpath("page.html").read_text(encoding="utf-8")
    return page.replace(_PLACE, _PLACE.replace("><", f">{b64encode(packed).decode()}<"))


def _reach(joint: AntagonistJoint, theta: Array, T: Array) -> Iterable[list[float]]:
    """Return the ends of the feasible stiffnesses [N·m/rad], each with T fastest."""
    ends = stiffness_interval(theta[:, None] * DEG, T, joint=joint)
    return (end.ravel().tolist() for end in ends)


def _steps(low: float, high: float, most: int) -> list[float]:
    """Return ends and step of a round grid with 0 on it and at most `most` steps."""
    rough = (high - low) / most
    power = 10.0 ** np.floor(np.log10(rough))
    step = next(step for step in (power, 2 * power, 2.5 * power, 5 * power, 10 * power) if step >= rough * (1 - 1e-9))
    return [float(np.round(end, 9)) for end in (np.ceil(low / step) * step, np.floor(high / step) * step, step)]


def _rounded(found: object) -> object:
    """Return the answers with numbers of `_DIGITS` digits."""
    match found:
        case float():
            return float(f"{found:.{_DIGITS}g}")
        case dict():
            return {name: _rounded(value) for name, value in found.items()}
        case list():
            return [_rounded(value) for value in found]
    return found
