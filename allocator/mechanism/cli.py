"""`antagonist allocate --mechanism` is answered here, in degrees and bar; behind it all is SI."""

from typing import TYPE_CHECKING, Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.presentation.tables import number
from allocator.shell.options import finite
from allocator.shell.printing import print_json, say
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from allocator.mechanism.mechanism import Mechanism
    from allocator.mechanism.result import MechanismAllocation


def answer(name: str, posture: str | None, stiffness: str, torque: str, *, as_json: bool, **asked: Any) -> bool:
    """Find and print the pressures of the mechanism called `name`; return whether the targets are met.

    Numbers come as text, joint by joint with commas: `posture` [degrees], `torque` [N·m], one number for all joints or
    n of them, and `stiffness` [N·m/rad], one number, a diagonal (n) or the matrix's upper triangle, row by row. `asked`
    goes to `allocate_mechanism`. Raises `InvalidInput` and `MissingBackend`.
    """
    from allocator.mechanism.entry import allocate_mechanism
    from allocator.mechanism.machines import machine

    mechanism = machine(name)
    n = mechanism.n
    if posture is None:
        raise InvalidInput(f"--mechanism {name} needs --posture, {n} angles [degrees], such as {','.join(['10'] * n)}")
    q = np.array(_row("--posture", posture, "degrees", {n: f"the angles of {', '.join(mechanism.joint_names)}"}))
    if (np.abs(q) > 360).any():
        raise InvalidInput(f"--posture {posture}: an angle is over a turn")
    each = {1: "one for all joints", n: "one a joint"}
    T = _row("--torque", torque, "N·m", each)
    triangle = n * (n + 1) // 2
    K = _row("--stiffness", stiffness, "N·m/rad", each | {triangle: "the upper triangle of the matrix, row by row"})
    found = allocate_mechanism(mechanism, q * DEG, _stiffness(K, mechanism), T[0] if len(T) == 1 else T, **asked)
    if as_json:
        print_json(_values(found))
    else:
        _print(found)
    return bool(found.success)


def _row(option: str, text: str, unit: str, counts: dict[int, str]) -> list[float]:
    """Read as many numbers as one of `counts` says."""
    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in counts:
        listed = " or ".join(f"{count} ({what})" for count, what in counts.items())
        raise InvalidInput(f"{option} {text}: expected {listed} numbers with commas between them [{unit}]")
    for value in numbers:
        finite(option, value, unit)
    return numbers


def _stiffness(K: list[float], mechanism: "Mechanism") -> Any:
    n, (rows, columns) = mechanism.n, mechanism.upper_triangle
    if len(K) == 1:
        return K[0]
    if len(K) == n:
        return K
    matrix = np.empty((n, n))
    matrix[rows, columns] = matrix[columns, rows] = K
    return matrix


def _values(a: "MechanismAllocation") -> dict[str, Any]:
    """Return what `--json` prints."""
    direction, reach, asked = a.separation
    return a.to_dict() | {
        "muscles": a.mechanism.muscle_names,
        "joints": a.mechanism.joint_names,
        "forces_N": a.forces,
        "met": bool(a.success),
        "holds_itself": bool(a.holds),
        "kkt_residual": a.kkt_residual,
        "separating_direction": direction,
        "separating_reach": reach,
        "separating_asked": asked,
        "message": a.message,
    }


def _print(a: "MechanismAllocation") -> None:
    from rich.console import Console
    from rich.table import Table

    m, console = a.mechanism, Console()
    angles = ", ".join(f"{number(angle)}°" for angle in a.q / DEG)
    joints = Table("joint", "torque asked [N·m]", "given", title=f"{angles} · {a.status.name}")
    joints.add_column(f"stiffness given [N·m/rad], by {', '.join(m.joint_names)}")
    for i, name in enumerate(m.joint_names):
        given = ", ".join(number(value) for value in a.K[i])
        joints.add_row(name, number(a.T[i] + a.T_error[i]), number(a.T[i]), given)
    muscles = Table("muscle", "pressure [bar]", "pulls [N]", "binding limits")
    for name, P, F in zip(m.muscle_names, a.P, a.forces, strict=True):
        binding = [limit.removeprefix(f"{name} ") for limit in a.active if limit.startswith(f"{name} ")]
        muscles.add_row(name, f"{P / BAR:.4f}", number(F), ", ".join(binding))
    console.print(joints, muscles, sep="\n")
    say(console, a.message)


__all__ = ["answer"]
