"""Command `antagonist allocate`: the pressures of a joint or of several joints, in degrees and bar."""

from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from allocator.errors import InvalidInput
from allocator.lazy import Table
from allocator.presentation.tables import number
from allocator.shell.machine_options import Hand, HandOptions, MachineOptions, torques
from allocator.shell.options import finite, grouped, row
from allocator.shell.outputs import AsJSON, print_json, say
from allocator.shell.stiffness_options import StiffnessOptions
from allocator.shell.weight import Balance, of_gravity, weight
from allocator.units import BAR, DEG

if TYPE_CHECKING:
    from allocator.allocation.at_least import AtLeast
    from allocator.allocation.box.result import BoxAllocation
    from allocator.allocation.two_muscles.result import PairAllocation
    from allocator.calculus import Array
    from allocator.joint.antagonist import AntagonistJoint
    from allocator.joint.gas import Stiffness
    from allocator.mechanism.mechanism import Mechanism

_NOT_MET = 3  # exit code
_NOTHING = 1e-6  # [N] a smaller force is a rounding error
_MUSCLES = "agonist", "antagonist"


@grouped
def allocate_command(
    stiffness: Annotated[
        str,
        typer.Option(
            help="stiffness target [N·m/rad]; of several joints K11,K12,K22, and with --links or --hand that of the "
            "hand [N/m]. It is isobaric, unless --valves, --frequency or --amplitude say otherwise"
        ),
    ],
    options: MachineOptions,
    stiffness_options: StiffnessOptions,
    hand: HandOptions,
    theta: Annotated[float | None, typer.Option(help="joint angle [degrees]")] = None,
    torque: Annotated[
        str,
        typer.Option(
            help="torque target [N·m], beyond the gravity of the machine's file or MuJoCo model; of several joints one "
            "number per joint, with commas"
        ),
    ] = "0",
    at_least: Annotated[
        bool,
        typer.Option("--at-least", help="find the least pressures with at least this stiffness; for several joints"),
    ] = False,
    priority: Annotated[str, typer.Option(help="the target that is met first: torque or stiffness")] = "torque",
    method: Annotated[
        str,
        typer.Option(
            help="exact, qp, nlp, convex or analytic; several joints take exact and qp, and analytic ignores all limits"
        ),
    ] = "exact",
    solver: Annotated[str | None, typer.Option(help="solver of the methods qp, nlp and convex")] = None,
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    as_json: AsJSON = False,
) -> None:
    """Compute the pressures for a torque and a stiffness, and name the limits that bind.

    For one joint: two pressures at the angle --theta. For several joints: all pressures at a --posture for their
    torques and a stiffness matrix, with --links or --hand that of the hand. The exit code is 3 if a target is not met.
    """
    from rich.console import Console

    from allocator.joint.antagonist import AntagonistJoint

    asked = _asked(priority, method, solver, min_force)
    machine, balance = options.build(), weight(options)
    if isinstance(machine, AntagonistJoint):
        if theta is None or at_least:
            raise InvalidInput("a joint needs --theta; --at-least goes with a --machine of several joints")
        hand.none()
        meant = stiffness_options.meant(options.file)
        one = _of_one(machine, theta, stiffness, torque, balance, meant, **asked)
        damping = stiffness_options.damping(options.file)
        held, success = balance(one.theta), one.success
        values, tables = _values_of_one(one, damping), [_table(one, damping)]
    else:
        if theta is not None:
            raise InvalidInput("--theta is of a joint; several joints have a --posture")
        meant = stiffness_options.meant(options.file, machine.muscle_names)
        located = hand.located(machine, options.machine)
        q = hand.angles(machine)
        held = balance(q)
        several = _of_several(machine, q, located, stiffness, torque, held, at_least, meant, **asked)
        values, tables, success = _values_of_several(several), _tables(several), several.success
    if as_json:
        print_json(values | {"gravity_Nm": held})
    else:
        console = Console()
        console.print(*tables, sep="\n")
        say(console, of_gravity(held), _of_hand(values), values["message"])
    if not success:
        raise typer.Exit(_NOT_MET)


def _asked(priority: str, method: str, solver: str | None, min_force: float) -> dict[str, Any]:
    """Return the arguments of `allocate` beside the machine, its targets and the stiffness."""
    from allocator.allocation import Method
    from allocator.joint.limits import Limits

    if priority not in ("torque", "stiffness"):
        raise InvalidInput(
            f"--priority {priority}: choose torque or stiffness; allocate() in Python also takes weights"
        )
    whole = Method(method, solver=solver)  # type: ignore[arg-type]  # checked there
    return {"priority": priority, "method": whole, "limits": Limits(min_force)}


# --- of one joint ---------------------------------------------------------------------------------------------------


def _of_one(
    joint: "AntagonistJoint",
    theta: float,
    stiffness: str,
    torque: str,
    balance: "Balance",
    meant: "Stiffness",
    **asked: Any,
) -> "PairAllocation":
    from allocator.allocation import allocate

    finite("--theta", theta, "degrees")
    if abs(theta) > 360:
        raise InvalidInput(f"theta = {theta:g}° is over a turn")
    K, T = _one("--stiffness", stiffness, "N·m/rad"), _one("--torque", torque, "N·m")
    return allocate(theta * DEG, K, T + float(balance(theta * DEG)), joint=joint, stiffness=meant, **asked)


def _one(option: str, text: str, unit: str) -> float:
    """Read one number."""
    try:
        return float(text)
    except ValueError:
        raise InvalidInput(f"{option} {text}: expected one number [{unit}]") from None


def _values_of_one(a: "PairAllocation", damping: float) -> dict[str, Any]:
    """Return the values that `--json` prints; `damping` [N·m·s/rad] is the plant's."""
    return a.to_dict() | {
        "limits": a.active,
        "stiffness": a.stiffness_name,
        "met": bool(a.success),
        "stiffness_std_Nm_per_rad": a.K_std,
        "loss_factor": _loss_factor(a, damping) if a.kind.frequency else None,
        "F1_N": a.forces[0],
        "F2_N": a.forces[1],
        "F1_std_N": _forces_std(a)[0],
        "F2_std_N": _forces_std(a)[1],
        "torque_reachable_Nm": a.torque_interval,
        "stiffness_reachable_Nm_per_rad": a.stiffness_interval,
        "slack_assumed": a.joint.slack_assumed,
        "assumed": a.assumed,
        "message": a.message,
    }


def _loss_factor(a: "PairAllocation", damping: float) -> float:
    """Return Im/Re [-] of the dynamic stiffness of the answer, with a `damping` [N·m·s/rad]."""
    at: Any = (a.theta, a.P1, a.P2, a.kind.frequency, a.kind.lags)
    K = complex(a.joint.dynamic_stiffness(*at, amplitude=a.kind.amplitude, damping=damping))
    return K.imag / K.real


def _forces_std(a: "PairAllocation") -> tuple[float | None, float | None]:
    """Return the standard deviations of both forces [N], None for a muscle without a covariance."""
    if a.forces_std is None:
        return None, None
    whole, muscles = a.joint.covariance is not None, (a.joint.agonist, a.joint.antagonist)
    fitted = (whole or muscle.covariance is not None for muscle in muscles)
    one, two = (float(std) if known else None for std, known in zip(a.forces_std, fitted, strict=True))
    return one, two


def _table(a: "PairAllocation", damping: float) -> "Table":
    from rich.table import Table
    from rich.text import Text

    from allocator.joint.assumption import visits

    table = Table("", "asked", "given", "reachable", title=f"{number(a.theta / DEG)}° · {a.status.name}")
    (T_min, T_max), (K_min, K_max) = (map(number, ends) for ends in (a.torque_interval, a.stiffness_interval))
    table.add_row("torque [N·m]", number(a.T_target), number(a.T), f"{T_min} … {T_max}")
    table.add_row(f"{a.stiffness_name} [N·m/rad]", number(a.K_target), number(a.K), f"{K_min} … {K_max} at this torque")
    if a.K_std is not None:
        exact = [name for name, std in zip(_MUSCLES, _forces_std(a), strict=True) if std is None]
        whence = f"from the fit; the {exact[0]} counts as exact" if exact else "from the fit"
        table.add_row("  its standard deviation", "", number(a.K_std, 2), whence)
    if not a.kind.isobaric:
        table.add_row("  isobaric [N·m/rad]", "", number(a.isobaric_stiffness), "with the pressures held")
    if a.kind.frequency:
        viscous = f"with a damping of {number(damping)} N·m·s/rad"
        table.add_row("  its loss factor", "", number(_loss_factor(a, damping)), viscous)
    unseen = ", a common force was not seen" if a.joint.slack_assumed else ""
    for name, pressure, force, std in zip(_MUSCLES, (a.P1, a.P2), a.forces, _forces_std(a), strict=True):
        pull = f"pulls {number(force)}{'' if std is None else f' ± {number(std, 2)}'} N{unseen}"
        table.add_row(Text(f"{name} pressure [bar]"), "", f"{pressure / BAR:.4f}", pull)
    table.add_row("binding limits", "", ", ".join(a.active) or "none", "")
    if a.joint.slack_assumed:
        table.add_row("slack limits", "", "assumed", "not seen in the fit of the joint")
    for visit in visits(a.joint, a.theta, a.P1, a.P2):
        within = "extrapolated" if visit.extrapolates.any() else "measured"
        table.add_row(f"force of the {visit.name}", "", within, Text(str(visit.region)))
    return table


# --- of several -----------------------------------------------------------------------------------------------------


def _of_several(
    mechanism: "Mechanism",
    q: "Array",
    hand: Hand | None,
    stiffness: str,
    torque: str,
    held: "Array",
    at_least: bool,
    meant: "Stiffness",
    **asked: Any,
) -> "BoxAllocation | AtLeast":
    """Return the answer for several joints at the posture `q` (n,) [rad], with `held` (n,) [N·m] against gravity.

    Numbers come as text, joint by joint with commas: `torque` [N·m], one number for all joints or n of them, and
    `stiffness` [N·m/rad], or of a hand [N/m], one number, a diagonal (n) or the matrix's upper triangle, row by row.
    """
    from allocator.allocation import allocate
    from allocator.allocation.at_least import allocate_at_least

    T, n = torques(torque, mechanism) + held, mechanism.n if hand is None else hand.endpoint.dim
    counts = {1: "one for all", n: "one each", n * (n + 1) // 2: "the upper triangle of the matrix, row by row"}
    K = _stiffness(row("--stiffness", stiffness, "N·m/rad" if hand is None else "N/m", counts), n)
    if hand is not None:
        meant = replace(meant, endpoint=hand.endpoint, force=hand.force)
    if not at_least:
        return allocate(q, K, T, joint=mechanism, stiffness=meant, **asked)
    if (asked["priority"], *asked["method"][:2]) != ("torque", "exact", None):
        raise InvalidInput("--at-least goes without --priority, --method and --solver")
    if not meant.kind(mechanism.muscle_names).isobaric:
        raise InvalidInput("--at-least is of the isobaric stiffness; it goes without --valves and --frequency")
    return allocate_at_least(mechanism, q, K, T, stiffness=meant, limits=asked["limits"])


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


def _values_of_several(found: "BoxAllocation | AtLeast") -> dict[str, Any]:
    """Return the values that `--json` prints."""
    from allocator.allocation.at_least import AtLeast

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


def _tables(found: "BoxAllocation | AtLeast") -> "list[Table]":
    from rich.markup import escape
    from rich.table import Table

    from allocator.allocation.at_least import AtLeast

    a, status = (found.allocation, found.status) if isinstance(found, AtLeast) else (found, found.status)
    m, angles = a.mechanism, ", ".join(f"{number(angle)}°" for angle in a.q / DEG)
    joints = Table("joint", "torque asked [N·m]", "given", title=f"{angles} · {status.name}")
    joints.add_column(escape(f"{a.kind.text} given [N·m/rad], by {', '.join(m.joint_names)}"))
    for i, name in enumerate(m.joint_names):
        given = ", ".join(number(value) for value in a.K[i])
        joints.add_row(escape(name), number(a.T[i] + a.T_error[i]), number(a.T[i]), given)
    muscles = Table(*map(escape, ("muscle", "pressure [bar]", "pulls [N]", "binding limits")))
    for name, P, F in zip(m.muscle_names, a.P, a.forces, strict=True):
        binding = [limit.removeprefix(f"{name} ") for limit in a.active if limit.startswith(f"{name} ")]
        pulls = F if abs(F) > _NOTHING else 0.0
        muscles.add_row(escape(name), f"{P / BAR:.4f}", number(pulls), ", ".join(binding))
    return [joints, muscles]


def _of_hand(values: dict[str, Any]) -> str:
    """Return a sentence on the hand; "" without one."""
    from allocator.allocation.box.result import vector

    K = values.get("endpoint_stiffness_N_per_m")
    return "" if K is None else f"the hand at {vector(values['position_m'])} m has the stiffness {vector(K)} N/m"
