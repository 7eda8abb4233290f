"""Motions of several joints from CSV files: angles of the joints or the path of the hand, each with a stiffness matrix.

| columns | meaning |
|---|---|
| `t` | time [s] |
| `joint_1_deg`, … | the angles [°], named as the machine names its joints, blanks as `_`; or |
| `x_mm`, `y_mm`, … | the path of the hand [mm] |
| `K11`, `K12`, `K22`, … | stiffness of the joints [N·m/rad]; `Kx11`, … [N/m] if that of the hand is tracked |

Names may have other units, such as `x [m]` (`mpc.trials.motions.columns`). Entries off the diagonal are 0 without a
column. Without any stiffness, it is the usual one of the machine.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.mechanism.endpoint import Endpoint
from allocator.units import DEG, MM
from mpc.model.arm.hand_paths import OutOfReach, followed
from mpc.model.arm.model import Arm
from mpc.trials.motions.arm_trajectories import tracked_stiffness, usual_stiffness
from mpc.trials.motions.columns import HAND_STIFFNESS, JOINT_STIFFNESS, MotionColumns
from mpc.trials.motions.reference import Reference

_ROUNDING = 1e-6  # [°] of angles in a file


def load_motion(path: str | Path, arm: Arm, hand: Endpoint | None = None) -> Reference:
    """Load the motion in a CSV file for `arm`; `hand` moves along a path.

    Raises `InvalidFile` with line and column for a file that is not a motion of this arm, and `InvalidInput`.
    Warns with `UnusedColumns` of further columns.
    """
    checks.instance("arm", arm, Arm, "an Arm, such as Arm.machine('arm26')")
    checks.instance("hand", hand, Endpoint | None, "an Endpoint, such as Endpoint.from_mjcf(file, name)")
    stiffnesses = dict.fromkeys(arm.labels.stiffness, arm.stiffness_unit) | _others(arm)
    angles, axes = dict.fromkeys(_angle_names(arm), "deg"), dict.fromkeys(_axis_names(hand), "mm")
    columns = MotionColumns.read(path, {"t": "s"} | angles | axes | stiffnesses)
    t = columns.numbers("t")
    if t.size < 2:
        raise InvalidFile(path, f"a motion needs at least 2 samples, this file has {t.size}")
    columns.refuse("t", np.diff(t, prepend=-np.inf) <= 0, t, "{:g} s does not come after the sample before")
    q = _angles(columns, arm, hand)
    K = _stiffness(columns, arm, q)
    columns.tell_unused()
    return Reference(t, q, K, Path(path).stem)


def _angle_names(arm: Arm) -> list[str]:
    return [f"{name}_deg".replace(" ", "_") for name in arm.labels.angles]


def _axis_names(hand: Endpoint | None) -> list[str]:
    return [] if hand is None else [f"{axis}_mm" for axis in getattr(hand.kinematics, "axes", "xyz"[: hand.dim])]


def _others(arm: Arm) -> dict[str, str]:
    """Return names and units of the columns of the stiffness that is not tracked."""
    if arm.endpoint is None:
        return {name.replace("K", "Kx"): HAND_STIFFNESS for name in arm.labels.stiffness}
    return {name.replace("Kx", "K"): JOINT_STIFFNESS for name in arm.labels.stiffness}


def _angles(columns: MotionColumns, arm: Arm, hand: Endpoint | None) -> Array:
    """Return the angles (M, n) [rad]."""
    table, names, axes = columns.table, _angle_names(arm), _axis_names(hand)
    of_joints, of_hand = (any(name in columns.found for name in some) for some in (names, axes))
    if of_joints == of_hand:
        what, joined = ("both", "and") if of_joints else ("neither", "nor")
        path = f"the path {', '.join(axes)} of the hand" if axes else "a path of the hand, which this machine lacks"
        found = ", ".join(table.names)
        raise InvalidFile(
            table.path, f"has {what} the angles {', '.join(names)} {joined} {path}; found: {found}", line=1
        )
    if hand is None or of_joints:
        angles = np.stack([columns.numbers(name) for name in names], axis=1)
        for name, column, low, high in zip(names, angles.T, *(ends / DEG for ends in arm.angle_limits), strict=True):
            columns.refuse(name, np.abs(column) > 360, column, "{:g}° is over a turn")
            out = (column < low - _ROUNDING) | (column > high + _ROUNDING)
            columns.refuse(name, out, column, f"{{:g}}° is beyond the range of the joint, {low:.4g} to {high:.4g}°")
        return angles * DEG
    return _followed(columns, arm, hand, np.stack([columns.numbers(axis) for axis in axes], axis=1) * MM)


def _followed(columns: MotionColumns, arm: Arm, hand: Endpoint, path: Array) -> Array:
    """Return postures (M, n) with the hand on the `path` (M, dim) [m]. Raises `InvalidFile` if there are none."""
    try:
        return followed(arm, hand, path)
    except OutOfReach as beyond:
        raise InvalidFile(columns.table.path, str(beyond), line=columns.table.lines[beyond.sample]) from None


def _stiffness(columns: MotionColumns, arm: Arm, q: Array) -> Array:
    """Return the tracked stiffness (M, k, k) at the postures `q` (M, n)."""
    names, k, path = arm.labels.stiffness, arm.tracked, columns.table.path
    if other := next((name for name in _others(arm) if name in columns.found), ""):
        whose = ("hand", "joints") if arm.endpoint is None else ("joints", "hand")
        raise InvalidFile(
            path, f"this is the stiffness of the {whose[0]}, and that of the {whose[1]} is tracked: use "
            f"--stiffness-of {whose[0]}, or give {', '.join(names)} [{arm.stiffness_unit}]", line=1, column=other,
        )  # fmt: skip
    if not any(name in columns.found for name in names):
        try:
            K = tracked_stiffness(arm, q, usual_stiffness(arm)(q))
        except InvalidInput as singular:
            raise InvalidFile(path, str(singular)) from None
        _check(columns, arm, K, f"without columns {', '.join(names)} the usual stiffness is tracked, which")
        return K
    K = np.zeros((len(q), k, k))
    for name, i, j in _entries(columns, arm):
        K[:, i, j] = K[:, j, i] = columns.numbers(name)
    _check(columns, arm, K, "the stiffness")
    return K


def _entries(columns: MotionColumns, arm: Arm) -> Iterator[tuple[str, int, int]]:
    """Yield name, row and column of every entry that the file needs or contains."""
    for name, i, j in zip(arm.labels.stiffness, *np.triu_indices(arm.tracked), strict=True):
        if i == j or name in columns.found:
            yield name, int(i), int(j)


def _check(columns: MotionColumns, arm: Arm, K: Array, whose: str) -> None:
    least = np.asarray(np.linalg.eigvalsh(K)[:, 0], float)
    columns.refuse(
        arm.labels.stiffness[0], ~(least > 0), least,
        f"{whose} has to be positive definite, and an eigenvalue is {{:.3g}} {arm.stiffness_unit}",
    )  # fmt: skip
