"""Motions of several joints from CSV files: angles of the joints or the path of the hand, each with a stiffness matrix.

| columns | meaning |
|---|---|
| `t` | time [s] |
| `joint_1_deg`, … | the angles [°], named as the machine names its joints, blanks as `_`; or |
| `x_mm`, `y_mm`, … | the path of the hand [mm] |
| `K11`, `K12`, `K22`, … | stiffness of the joints [N·m/rad]; `Kx11`, … [N/m] if that of the hand is tracked |

Entries off the diagonal are 0 without a column. Without any stiffness, it is the usual one of the machine.

The angles of a path follow from Gauss–Newton steps in q on |x(q) - x|². Each sample starts from the one before, so that
the arm does not change sides.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.csv_table import Table, read_table
from allocator.mechanism.endpoint import Endpoint
from allocator.units import DEG, MM
from mpc.model.arm.model import Arm
from mpc.model.arm.ranges import about_the_middle
from mpc.trials.files import place_of, refuse
from mpc.trials.motions.arm_trajectories import tracked_stiffness, usual_stiffness
from mpc.trials.motions.reference import Reference

_NEAR = 0.1 * MM  # of the path
_STEPS = 60  # of Gauss and Newton
_LONGEST = 0.3  # [rad] greatest step


def load_motion(path: str | Path, arm: Arm, hand: Endpoint | None = None) -> Reference:
    """Load the motion in a CSV file for `arm`; `hand` moves along a path.

    Raises `InvalidFile` with line and column for a file that is not a motion of this arm.
    """
    table = read_table(path)
    t = table.numbers(place_of(table, "t"))
    if t.size < 2:
        raise InvalidFile(path, f"a motion needs at least 2 samples, this file has {t.size}")
    refuse(table, "t", np.diff(t, prepend=-np.inf) <= 0, t, "{:g} s does not come after the sample before")
    q = _angles(table, arm, hand)
    return Reference(t, q, _stiffness(table, arm, q), Path(path).stem)


def _angles(table: Table, arm: Arm, hand: Endpoint | None) -> Array:
    """Return the angles (M, n) [rad]."""
    names = [f"{name}_deg".replace(" ", "_") for name in arm.labels.angles]
    axes = [] if hand is None else [f"{axis}_mm" for axis in getattr(hand.kinematics, "axes", "xyz"[: hand.dim])]
    of_joints, of_hand = (any(name in table.names for name in some) for some in (names, axes))
    if of_joints == of_hand:
        what = "both" if of_joints else "neither"
        path = f"the path {', '.join(axes)} of the hand" if axes else "a path of the hand, which this machine lacks"
        found = ", ".join(table.names)
        raise InvalidFile(table.path, f"has {what} the angles {', '.join(names)} and {path}; found: {found}", line=1)
    if hand is None or of_joints:
        angles = np.stack([table.numbers(place_of(table, name)) for name in names], axis=1)
        for name, column in zip(names, angles.T, strict=True):
            refuse(table, name, np.abs(column) > 360, column, "{:g}° is over a turn")
        return angles * DEG
    return _followed(table, arm, hand, np.stack([table.numbers(place_of(table, axis)) for axis in axes], axis=1) * MM)


def _followed(table: Table, arm: Arm, hand: Endpoint, path: Array) -> Array:
    """Return postures (M, n) with the hand on the `path` (M, dim) [m]. Raises `InvalidFile` if there are none."""
    starts = np.vstack([arm.middle, about_the_middle(arm)])
    found: list[Array] = []
    for k, x in enumerate(path):
        reached = [_posture(arm, hand, x, q) for q in (found[-1:] or starts)]
        missed, q = next((one for one in reached if one[0] <= _NEAR), (np.inf, starts[0]))
        if missed > _NEAR:
            missed, q = min((_nearest(arm, hand, x, q) for q in (*found[-1:], *starts[:4])), key=lambda one: one[0])
        if missed > _NEAR:
            where = ", ".join(f"{value / MM:g}" for value in x)
            nearest = f"the nearest it comes is {missed / MM:.1f} mm away"
            said = f"the hand does not reach ({where}) mm within the ranges of the joints; {nearest}"
            raise InvalidFile(table.path, said, line=table.lines[k])
        found.append(q)
    return np.array(found)


def _posture(arm: Arm, hand: Endpoint, x: Array, q: Array) -> tuple[float, Array]:
    """Return the remaining distance of the hand from `x` (dim,) [m], and the posture (n,), sought from `q` on."""
    for _ in range(_STEPS):
        place = hand.at(q)
        off = x - place.position
        if np.abs(off).max() <= _NEAR / 100:
            break
        step = np.linalg.lstsq(place.jacobian, off, rcond=1e-6)[0]
        step *= min(1.0, _LONGEST / max(float(np.abs(step).max()), 1e-12))
        q = np.clip(q + step, *arm.angle_limits)
    return float(np.linalg.norm(x - hand.at(q).position)), q


def _nearest(arm: Arm, hand: Endpoint, x: Array, q: Array) -> tuple[float, Array]:
    """Return the results of `_posture`, by a slower method that can move along the ends of the ranges."""
    from scipy.optimize import least_squares

    q = np.clip(q, *arm.angle_limits)
    found = least_squares(lambda q: hand.at(q).position - x, q, lambda q: hand.at(q).jacobian, arm.angle_limits)
    return float(np.linalg.norm(found.fun)), found.x


def _stiffness(table: Table, arm: Arm, q: Array) -> Array:
    """Return the tracked stiffness (M, k, k) at the postures `q` (M, n)."""
    names, k = arm.labels.stiffness, arm.tracked
    other = "Kx11" if arm.endpoint is None else "K11"
    if other in table.names:
        whose = ("hand", "joints") if arm.endpoint is None else ("joints", "hand")
        raise InvalidFile(
            table.path, f"this is the stiffness of the {whose[0]}, and that of the {whose[1]} is tracked: use "
            f"--stiffness-of {whose[0]}, or give {', '.join(names)} [{arm.stiffness_unit}]", line=1, column=other,
        )  # fmt: skip
    if not any(name in table.names for name in names):
        try:
            return tracked_stiffness(arm, q, usual_stiffness(arm)(q))
        except InvalidInput as singular:
            raise InvalidFile(table.path, str(singular)) from None
    K = np.zeros((len(q), k, k))
    for name, i, j in _entries(table, arm):
        K[:, i, j] = K[:, j, i] = table.numbers(place_of(table, name))
    _check(table, arm, K)
    return K


def _entries(table: Table, arm: Arm) -> Iterator[tuple[str, int, int]]:
    """Yield name, row and column of every entry that the file needs or contains."""
    for name, i, j in zip(arm.labels.stiffness, *np.triu_indices(arm.tracked), strict=True):
        if i == j or name in table.names:
            yield name, int(i), int(j)


def _check(table: Table, arm: Arm, K: Array) -> None:
    least = np.asarray(np.linalg.eigvalsh(K)[:, 0], float)
    refuse(
        table, arm.labels.stiffness[0], ~(least > 0), least,
        f"the stiffness has to be positive definite, and an eigenvalue is {{:.3g}} {arm.stiffness_unit}",
    )  # fmt: skip
