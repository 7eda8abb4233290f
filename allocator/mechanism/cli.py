"""`antagonist allocate --mechanism` is answered here, in degrees and bar; behind it all is SI."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from allocator.allocation import allocate
from allocator.errors import InvalidInput
from allocator.presentation.tables import number
from allocator.shell.mechanism_options import MechanismOptions
from allocator.shell.options import finite, within
from allocator.shell.printing import print_json, say
from allocator.units import BAR, DEG, MM

if TYPE_CHECKING:
    from allocator.calculus import Array
    from allocator.joint.gas import Stiffness
    from allocator.mechanism.at_least import AtLeast
    from allocator.mechanism.endpoint import Endpoint
    from allocator.mechanism.mechanism import Mechanism
    from allocator.mechanism.result import BoxAllocation


def answer(
    options: MechanismOptions, stiffness: str, torque: str, *, at_least: bool, as_json: bool, **asked: Any
) -> bool:
    """Find and print the pressures of a mechanism; return whether the targets are met.

    Numbers come as text, joint by joint with commas: `torque` [N·m], one number for all joints or n of them, and
    `stiffness` [N·m/rad], or of a hand [N/m], one number, a diagonal (n) or the matrix's upper triangle, row by row.
    `asked` goes to `allocate`. Raises `InvalidInput` and `MissingBackend`.
    """
    from allocator.allocation.method import Method
    from allocator.joint.limits import Limits
    from allocator.mechanism.at_least import allocate_at_least

    mechanism, hand = chosen(options)
    q, n = posture(options, mechanism), mechanism.n if hand is None else hand.endpoint.dim
    T = torques(torque, mechanism)
    each = {1: "one for all", n: "one each"}
    unit = "N·m/rad" if hand is None else "N/m"
    text = _row(
        "--stiffness", stiffness, unit, each | {n * (n + 1) // 2: "the upper triangle of the matrix, row by row"}
    )
    at: dict[str, Any] = {"limits": Limits(asked["min_force"]), "stiffness": stiffness_of(hand)}
    found: BoxAllocation | AtLeast
    if at_least:
        _check_at_least(asked)
        found = allocate_at_least(mechanism, q, _stiffness(text, n), T, **at)
    else:
        method = Method(asked["method"], solver=asked["solver"])
        found = allocate(q, _stiffness(text, n), T, joint=mechanism, priority=asked["priority"], method=method, **at)
    if as_json:
        print_json(_values(found))
    else:
        _print(found)
    return bool(found.success)


def _check_at_least(asked: dict[str, Any]) -> None:
    """Refuse options that `allocate_at_least` has not."""
    if (asked["priority"], asked["method"], asked["solver"]) != ("torque", "exact", None):
        raise InvalidInput("--at-least goes without --priority, --method and --solver")


class Hand(NamedTuple):
    """A `Hand` is what --links and --push say."""

    endpoint: "Endpoint"
    force: "Array"  # (2,) [N]


def chosen(options: MechanismOptions) -> "tuple[Mechanism, Hand | None]":
    """Return the mechanism that the options name, and its hand if they say where it is. Raises `InvalidInput`."""
    from allocator.mechanism.endpoint import Endpoint
    from allocator.mechanism.machines import machine

    mechanism = machine(str(options.mechanism))
    if options.links is None:
        return mechanism, None
    n = {mechanism.n: "one a link"}
    lengths = np.array(_row("--links", options.links, "mm", n))
    within("--links", float(lengths.min()), "mm", 1, 10_000)
    within("--links", float(lengths.max()), "mm", 1, 10_000)
    angles = (
        np.zeros(1) if options.links_at_zero is None else np.array(_angles("--links-at-zero", options.links_at_zero, n))
    )
    push = [0.0, 0.0] if options.push is None else _row("--push", options.push, "N", {2: "its x and y"})
    at_zero = np.broadcast_to(angles, lengths.shape) * DEG
    return mechanism, Hand(Endpoint.planar(lengths * MM, at_zero), np.array(push))


def stiffness_of(hand: Hand | None) -> "Stiffness":
    """Return which stiffness is meant: the hand's, or without one that of the joints."""
    from allocator.joint.gas import ISOBARIC, Stiffness

    return ISOBARIC if hand is None else Stiffness(endpoint=hand.endpoint, force=hand.force)


def posture(options: MechanismOptions, mechanism: "Mechanism") -> "Array":
    """Return the posture (n,) [rad]. Raises `InvalidInput`."""
    n = mechanism.n
    if options.posture is None:
        raise InvalidInput(
            f"--mechanism {options.mechanism} needs --posture, {n} angles [degrees], such as {','.join(['10'] * n)}"
        )
    counts = {n: f"the angles of {', '.join(mechanism.joint_names)}"}
    return np.array(_angles("--posture", options.posture, counts)) * DEG


def torques(text: str, mechanism: "Mechanism") -> "Array":
    """Return the torques (n,) [N·m]. Raises `InvalidInput`."""
    row = _row("--torque", text, "N·m", {1: "one for all joints", mechanism.n: "one a joint"})
    return np.broadcast_to(np.array(row), (mechanism.n,))


def _angles(option: str, text: str, counts: dict[int, str]) -> list[float]:
    """Read angles [degrees]."""
    row = _row(option, text, "degrees", counts)
    if max(map(abs, row)) > 360:
        raise InvalidInput(f"{option} {text}: an angle is over a turn")
    return row


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


def _stiffness(K: list[float], size: int) -> Any:
    """Return a number, a diagonal or a matrix (size, size)."""
    if len(K) == 1:
        return K[0]
    if len(K) == size:
        return K
    matrix = np.empty((size, size))
    rows, columns = np.triu_indices(size)
    matrix[rows, columns] = matrix[columns, rows] = K
    return matrix


def _values(found: "BoxAllocation | AtLeast") -> dict[str, Any]:
    """Return what `--json` prints."""
    from allocator.mechanism.at_least import AtLeast

    a = found.allocation if isinstance(found, AtLeast) else found
    values = found.to_dict() | {
        "muscles": a.mechanism.muscle_names,
        "joints": a.mechanism.joint_names,
        "forces_N": a.forces,
        "met": bool(found.success),
        "holds_itself": bool(a.holds),
        "message": found.message,
    }
    if isinstance(found, AtLeast):
        proof = found.certificate
        d, reach, asked = (np.nan,) * 3 if proof is None else (proof.direction, proof.reach, proof.asked)
    else:
        d, reach, asked = found.separation
        values |= {"kkt_residual": found.kkt_residual}
    return values | {"separating_direction": d, "separating_reach": reach, "separating_asked": asked}


def _print(found: "BoxAllocation | AtLeast") -> None:
    from rich.console import Console
    from rich.table import Table

    from allocator.mechanism.at_least import AtLeast
    from allocator.mechanism.result import vector

    a, status = (found.allocation, found.status) if isinstance(found, AtLeast) else (found, found.status)
    m, console = a.mechanism, Console()
    angles = ", ".join(f"{number(angle)}°" for angle in a.q / DEG)
    joints = Table("joint", "torque asked [N·m]", "given", title=f"{angles} · {status.name}")
    joints.add_column(f"stiffness given [N·m/rad], by {', '.join(m.joint_names)}")
    for i, name in enumerate(m.joint_names):
        given = ", ".join(number(value) for value in a.K[i])
        joints.add_row(name, number(a.T[i] + a.T_error[i]), number(a.T[i]), given)
    muscles = Table("muscle", "pressure [bar]", "pulls [N]", "binding limits")
    for name, P, F in zip(m.muscle_names, a.P, a.forces, strict=True):
        binding = [limit.removeprefix(f"{name} ") for limit in a.active if limit.startswith(f"{name} ")]
        muscles.add_row(name, f"{P / BAR:.4f}", number(F), ", ".join(binding))
    console.print(joints, muscles, sep="\n")
    if a.endpoint is not None:
        say(console, f"the hand at {vector(a.x)} m has the stiffness {vector(a.K_x)} N/m")
    say(console, found.message)
