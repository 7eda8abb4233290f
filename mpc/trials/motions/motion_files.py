"""Motions of several joints from CSV files: angles of the joints or the path of the hand, each with a stiffness matrix.

| columns | meaning |
|---|---|
| `t` | time [s] |
| `joint_1_deg`, … | the angles [°], named as the machine names its joints, blanks as `_`; or |
| `x_mm`, `y_mm`, … | the path of the hand [mm] |
| `K11`, `K12`, `K22`, … | stiffness of the joints [N·m/rad]; `Kx11`, … [N/m] if that of the hand is tracked |

Entries off the diagonal are 0 without a column. Without any stiffness, it is the usual one of the machine.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.csv_table import Table, read_table
from allocator.mechanism.endpoint import Endpoint
from allocator.units import DEG, MM
from mpc.model.arm.hand_paths import OutOfReach, followed
from mpc.model.arm.model import Arm
from mpc.trials.files import place_of, refuse
from mpc.trials.motions.arm_trajectories import tracked_stiffness, usual_stiffness
from mpc.trials.motions.reference import Reference


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
    try:
        return followed(arm, hand, path)
    except OutOfReach as beyond:
        raise InvalidFile(table.path, str(beyond), line=table.lines[beyond.sample]) from None


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
