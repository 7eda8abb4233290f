"""Command `antagonist map`: feasible angles, stiffnesses and torques, in degrees, millimetres and bar."""

from collections.abc import Iterable, Sequence
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from allocator.errors import InvalidInput
from allocator.files.toml import Table
from allocator.joint.gas import ISOBARIC, Stiffness
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.joint.limits import Limits
from allocator.lazy import Figure
from allocator.presentation.plotting import save_figure
from allocator.shell.machine_options import Hand, HandOptions, MachineOptions, torques
from allocator.shell.options import grouped, numbers, within
from allocator.shell.outputs import IMAGES, AsJSON, Force, check_ending, claim, print_json, say
from allocator.shell.stiffness_options import StiffnessOptions
from allocator.shell.weight import Balance, of_gravity, weight
from allocator.units import DEG

if TYPE_CHECKING:
    from allocator.calculus import Array
    from allocator.feasibility.result import FeasibilityMap
    from allocator.mechanism.mechanism import Mechanism

_LONG = 8  # least number of chunks for a progress bar
_ENDINGS = (*IMAGES, ".csv", ".npz")
_DEFAULT_STEPS = 200
_OWN_NAME = "map.png"


@grouped
def map_command(
    options: MachineOptions,
    stiffness_options: StiffnessOptions,
    hand: HandOptions,
    theta: Annotated[
        str | None, typer.Option(help="angles, LOW:HIGH or LOW:HIGH:STEP [degrees]; the whole range by default")
    ] = None,
    stiffness: Annotated[
        str | None, typer.Option(help="stiffnesses, LOW:HIGH or LOW:HIGH:STEP [N·m/rad]; by default all that exist")
    ] = None,
    torque: Annotated[
        str | None,
        typer.Option(
            help="torques beyond the gravity of the machine's file or MuJoCo model, LOW:HIGH or LOW:HIGH:STEP [N·m]; 0 "
            "by default, or all if angle or stiffness is a number. Of several joints numbers with commas, or free"
        ),
    ] = None,
    targets: Annotated[
        str | None,
        typer.Option(help="the two quantities to draw, for several joints; such as K11,K12 or T1,K22 or Kx11,Kx22"),
    ] = None,
    out: Annotated[Path, typer.Option(help="picture (.png, .pdf, .svg), table (.csv) or arrays (.npz)")] = Path(
        _OWN_NAME
    ),
    pressures: Annotated[bool, typer.Option("--pressures", help="draw the pressures over the map")] = False,
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    max_memory: Annotated[float, typer.Option(help="most memory that the map may take [GB]")] = 1.0,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Draw the feasible angles, stiffnesses and torques, and the limits that bound them.

    Two or three of angle, stiffness and torque are ranges, the others numbers. The ending of --out selects the format.
    Repeat --muscle to compare muscles in one picture. For several joints at a --posture: the polygon of two --targets,
    with the binding muscles named on its edges. With --links or --hand and no posture: the feasible stiffness ellipses
    of the hand over its workspace.
    """
    from rich.console import Console

    from allocator.feasibility.maps import feasibility_map
    from allocator.joint.antagonist import AntagonistJoint

    check_ending("--out", out, _ENDINGS)
    claim(out, inputs=options.files, force=force, own=(_OWN_NAME,))
    within("--max-memory", max_memory, "GB", 1e-6, 1e6)
    base = options.base
    if not isinstance(base, AntagonistJoint):
        if theta is not None or stiffness is not None:
            raise InvalidInput("--theta and --stiffness are ranges of one joint; several joints take --targets")
        if pressures or stiffness_options != StiffnessOptions():
            raise InvalidInput("--pressures, --valves, --frequency and --amplitude are for one joint")
        machine: Any = options.build()
        check_ending("--out", out, IMAGES)
        located = hand.located(machine, options.machine)
        figure, sentence, values = _drawn(machine, hand, located, targets, torque, weight(options), min_force)
        save_figure(figure, out)
    else:
        hand.none()
        if targets is not None:
            raise InvalidInput(
                "--targets is for several joints; one joint takes ranges of --theta, --stiffness and --torque"
            )
        asked = _axes(theta, stiffness, torque) | {"max_bytes": max_memory * 1e9, "progress": _progress}
        asked |= {"stiffness": stiffness_options.meant(options.file), "limits": Limits(min_force)}
        asked["gravity"] = NO_GRAVITY if options.file is None else Gravity.of_file(Table.read(options.file))
        maps = {name: feasibility_map(joint=joint, **asked) for name, joint in options.compared(base).items()}
        _write(maps, out, pressures)
        sentence = "\n".join(_sentence(name, found) for name, found in maps.items())
        values = {"maps": [_values(name, found) for name, found in maps.items()]}
    if as_json:
        print_json(values | {"written": str(out)})
    else:
        say(Console(), sentence, f"written: {out}")


def _axis(option: str, text: str, unit: str) -> "Array":
    """Return one number (), or the steps of a range (n,)."""
    from allocator.feasibility.maps import steps

    given = numbers(option, text, 1, 3, "-90:90:1")
    if len(given) == 1:
        return np.array(given[0])
    low, high = given[:2]
    return steps(option, low, high, given[2] if len(given) == 3 else abs(high - low) / _DEFAULT_STEPS or 1.0, unit)


def _angles(text: str) -> "Array":
    """Return one angle () or the angles of a range (n,) [rad]."""
    found = _axis("--theta", text, "°")
    if np.abs(found).max() > 360:
        raise InvalidInput(f"--theta {text}: an angle is over a turn")
    return found * DEG


def _axes(theta: str | None, stiffness: str | None, torque: str | None) -> dict[str, Any]:
    """Return the axes of a map by name, None for all values.

    The torque is 0 by default, or takes all values if the angle or the stiffness is a number.
    """
    fixed = any(given is not None and ":" not in given for given in (theta, stiffness))
    return {
        "theta": None if theta is None else _angles(theta),
        "K": None if stiffness is None else _axis("--stiffness", stiffness, "N·m/rad"),
        "T": _axis("--torque", torque, "N·m") if torque is not None else None if fixed else 0.0,
    }


def _progress(chunks: Sequence[int]) -> Iterable[int]:
    from allocator.presentation.progress import counted

    return counted(chunks, "mapping") if len(chunks) >= _LONG else chunks


def _ended_by(found: "FeasibilityMap") -> list[str]:
    return list(dict.fromkeys(limit for edge in found.edges for limit in edge.active))


def _sentence(name: str, found: "FeasibilityMap") -> str:
    """Return one line on the feasible set and one on the limits that bound it."""
    if not found.share:
        return f"{name}: none of {found.status.size} combinations exists, {found.kind.text}; take other ranges"
    return (
        f"{name}: {100 * found.share:.1f} % of {found.status.size} combinations exist, {found.kind.text}\n"
        f"  bounded by: {', '.join(_ended_by(found))}"
        + (found.assumed and f"\n  {found.assumed}")
        + (f"\n  the muscles also balance gravity, {gravity}" if (gravity := found.setting.gravity).torque else "")
    )


def _values(name: str, found: "FeasibilityMap") -> dict[str, object]:
    return {
        "name": name,
        "stiffness": found.kind.text,
        "varied": found.varied,
        "combinations": found.status.size,
        "existing_share": found.share,
        "ended_by": _ended_by(found),
        "slack_assumed": found.joint.slack_assumed,
        "assumed": found.assumed,
    }


def _write(maps: dict[str, "FeasibilityMap"], out: Path, pressures: bool) -> None:
    from allocator.feasibility.plotting import plot_maps, plot_pressures

    first, *more = maps.values()
    ending = out.suffix.lower()
    if more and (ending in (".csv", ".npz") or pressures):
        raise InvalidInput("several muscles are for pictures of the edges; give one --muscle here")
    if ending == ".csv":
        first.to_csv(out)
    elif ending == ".npz":
        first.to_npz(out)
    elif pressures:
        save_figure(plot_pressures(first), out)
    else:
        save_figure((plot_maps(maps) if more else first.plot()).figure, out)


_PLACES = 6, 5  # of the workspace, over shoulder and elbow
_SWING = 60 * DEG  # of joints without limits
_BENT = 5 * DEG  # from the stretched arm, where the Jacobian is singular


def _drawn(
    mechanism: "Mechanism",
    options: HandOptions,
    hand: Hand | None,
    targets: str | None,
    torque: str | None,
    balance: Balance,
    min_force: float,
) -> tuple["Figure", str, dict[str, object]]:
    """Return the figure of a mechanism's feasible targets, a sentence on it, and the output of `--json`.

    At a posture the polygon of two `targets`, such as "K11,K22"; of a hand without a posture its stiffness ellipses
    over the workspace. `torque` is the constant torque: numbers [N·m], 0 by default, or "free". Raises `InvalidInput`.
    """
    from allocator.feasibility.targets import feasible_targets

    if options.posture is None and hand is None:
        raise InvalidInput("give a --posture [degrees] to draw its targets, or --links or --hand to draw a workspace")
    if options.posture is None and hand is not None and targets is None:
        return _workspace(mechanism, hand, torque, balance, min_force)
    meant = ISOBARIC if hand is None else Stiffness(endpoint=hand.endpoint, force=hand.force)
    found = feasible_targets(mechanism, options.angles(mechanism), limits=Limits(min_force), stiffness=meant)
    x, y = _pair(targets, mechanism.n, hand)
    weighs = balance(found.q)
    T = torques("0" if torque in (None, "free") else str(torque), mechanism) + weighs
    if hand is not None:
        T = T + hand.endpoint.torque(found.q, hand.force)
    every = {} if torque == "free" else {f"T{i + 1}": float(one) for i, one in enumerate(T)}
    held = {name: one for name, one in every.items() if name not in (x, y)}
    polygon = found.polygon(x, y, held)
    binding = list(dict.fromkeys(limit for edge in polygon.edges for limit in edge.active))
    kept = f" at {polygon.held}" if polygon.held else ""
    sentence = (
        f"{x} and {y}{kept}: {len(polygon.vertices)} corners; bounded by: {', '.join(binding) or 'nothing exists'}"
    )
    sentence = "\n".join(filter(None, (sentence, of_gravity(weighs))))
    edges = [{"start": edge.start, "end": edge.end, "limits": edge.active} for edge in polygon.edges]
    return polygon.plot().figure, sentence, {"targets": [x, y], "held": held, "area": polygon.area, "edges": edges}


def _pair(targets: str | None, n: int, hand: Hand | None) -> tuple[str, str]:
    """Return the names of two targets, by default of the first two joints, of the hand, or of a single joint."""
    if targets is None:
        targets = "Kx11,Kx22" if hand is not None else "K11,K22" if n > 1 else "T1,K11"
    names = targets.split(",")
    if len(names) != 2:
        raise InvalidInput(f"--targets {targets}: expected two with a comma between them, such as K11,K22 or T1,K12")
    return names[0], names[1]


def _workspace(
    mechanism: "Mechanism", hand: Hand, torque: str | None, balance: Balance, min_force: float
) -> tuple["Figure", str, dict[str, object]]:
    from allocator.feasibility.targets import endpoint_ellipses

    if torque == "free":
        raise InvalidInput("the ellipses of a workspace are those of held torques; --torque free goes with --posture")
    q = _postures(mechanism, hand)
    T = torques(torque or "0", mechanism) + balance(q)
    found = endpoint_ellipses(mechanism, hand.endpoint, q, T, force=hand.force, limits=Limits(min_force))
    turns = np.degrees(found.tilt[..., 1] - found.tilt[..., 0])[found.exists]
    sentence = f"{len(q)} postures, torques exist at {int(found.exists.sum())}"
    if turns.size:
        sentence += f"; the ellipse turns by {turns.min():.0f}° to {turns.max():.0f}°"
    values: dict[str, object] = {"posture_deg": q / DEG, "position_m": found.x, "tilt_deg": np.degrees(found.tilt)}
    stiffness = {"softest_N_per_m": found.softest, "stiffest_N_per_m": found.stiffest}
    return found.plot().figure, sentence, values | stiffness


def _postures(mechanism: "Mechanism", hand: Hand) -> "Array":
    """Return postures (k, 2) [rad] over the range of both joints, except those with the arm stretched out."""
    if mechanism.n != 2:
        raise InvalidInput(f"the workspace is drawn of n = 2 joints, not {mechanism.n}; give a --posture")
    limits = mechanism.angle_limits or ((-_SWING, _SWING),) * 2
    every = np.array(list(product(*(np.linspace(*ends, count) for ends, count in zip(limits, _PLACES, strict=True)))))
    area = np.abs(np.linalg.det(hand.endpoint.jacobian(every)))
    return np.asarray(every[area > np.sin(_BENT) * area.max()])  # det J = l1 l2 sin of the angle between the links
