"""`antagonist map`: which angles, stiffnesses and torques exist. Degrees, millimetres and bar here, SI behind."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from allocator.errors import InvalidInput

if TYPE_CHECKING:
    from rich.console import Console

    from allocator.calculus import Array
    from allocator.feasibility.result import FeasibilityMap
    from allocator.joint import AntagonistJoint
    from allocator.muscles import Muscle

_LONG = 8  # chunks from which on a progress bar is shown
_ENDINGS = (".png", ".pdf", ".svg", ".csv", ".npz")
_DEFAULT_STEPS = 200
_REPORT = "tondu-dmsp-20-400n"


def map_command(
    theta: Annotated[
        str | None, typer.Option(help="angle, LOW:HIGH or LOW:HIGH:STEP [degrees]; all by default")
    ] = None,
    stiffness: Annotated[
        str | None, typer.Option(help="stiffness, LOW:HIGH or LOW:HIGH:STEP [N·m/rad]; or all that exist")
    ] = None,
    torque: Annotated[
        str | None, typer.Option(help="torque, LOW:HIGH or LOW:HIGH:STEP [N·m]; 0, or all if another one is a number")
    ] = None,
    out: Annotated[Path, typer.Option(help="picture (.png, .pdf, .svg), table (.csv) or arrays (.npz)")] = Path(
        "map.png"
    ),
    pressures: Annotated[bool, typer.Option("--pressures", help="draw the pressures over the map")] = False,
    muscle: Annotated[
        list[str] | None, typer.Option(help="TOML file or name of a muscle; repeat it to compare on one picture")
    ] = None,
    radius: Annotated[float, typer.Option(help="radius of the pulley [mm]")] = 20.0,
    rest_length: Annotated[float, typer.Option(help="rest length of the muscles [mm]")] = 400.0,
    initial_contraction: Annotated[float, typer.Option(help="contraction ratio of both muscles at 0°")] = 0.1375,
    supply: Annotated[float, typer.Option(help="supply pressure [bar]")] = 5.0,
    stops: Annotated[str, typer.Option(help="mechanical end stops LOW:HIGH [degrees]")] = "-125:125",
    min_force: Annotated[float, typer.Option(help="least muscle force [N]")] = 0.0,
    joint: Annotated[Path | None, typer.Option(help="a joint in a TOML file written by `antagonist fit-joint`")] = None,
    max_memory: Annotated[float, typer.Option(help="memory that the map may take [GB]")] = 1.0,
) -> None:
    """Show which angles, stiffnesses and torques the joint can have, and which limit ends them.

    Two or three of angle, stiffness and torque are ranges, the others numbers. The ending of --out says what is
    written.
    """
    from rich.console import Console

    from allocator.joint_storage import load_joint
    from allocator.units import DEG, MM

    if out.suffix.lower() not in _ENDINGS:
        raise InvalidInput(f"--out {out}: the ending has to be one of {', '.join(_ENDINGS)}")
    console = Console()
    pulley = {"rest_length": rest_length * MM, "radius": radius * MM, "initial_contraction": initial_contraction}
    left, right = _numbers("--stops", stops, 2, 2)
    maps = {}
    stop_angles = (left * DEG, right * DEG)
    joints = {
        name: _joint(_muscle(name), pulley, supply, stop_angles) for name in muscle or ([] if joint else [_REPORT])
    }
    for name, shown in (joints | ({joint.stem: load_joint(joint)} if joint else {})).items():
        axes = {
            "theta": None if theta is None else _axis("--theta", theta, "°") * DEG,
            "K": None if stiffness is None else _axis("--stiffness", stiffness, "N·m/rad"),
            "T": _torque(torque, theta, stiffness),
        }
        maps[name] = _map(axes, shown, min_force, max_memory, console)
        _say(console, name, maps[name])
    _write(maps, out, pressures)
    console.print(f"written: {out}", highlight=False, markup=False, soft_wrap=True)


def _numbers(option: str, text: str, fewest: int, most: int) -> list[float]:
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        numbers = []
    if not fewest <= len(numbers) <= most:
        forms = " or ".join(("NUMBER", "LOW:HIGH", "LOW:HIGH:STEP")[fewest - 1 : most])
        raise InvalidInput(f"{option} {text}: expected {forms}, such as -90:90:1")
    return numbers


def _axis(option: str, text: str, unit: str) -> "Array":
    """One number (), or the steps of a range (n,)."""
    import numpy as np

    from allocator.feasibility.axes import steps

    numbers = _numbers(option, text, 1, 3)
    if len(numbers) == 1:
        return np.array(numbers[0])
    low, high = numbers[:2]
    return steps(option, low, high, numbers[2] if len(numbers) == 3 else abs(high - low) / _DEFAULT_STEPS or 1.0, unit)


def _torque(torque: str | None, *others: str | None) -> "Array | float | None":
    """Unless asked for: 0, or all torques where the angle or the stiffness is a number."""
    if torque is not None:
        return _axis("--torque", torque, "N·m")
    return None if any(other is not None and ":" not in other for other in others) else 0.0


def _muscle(name: str) -> "Muscle":
    from allocator.errors import MissingBackend
    from allocator.muscles import Muscle
    from allocator.muscles.catalogue import MUSCLES

    if name in MUSCLES:
        return MUSCLES[name]
    if not Path(name).exists() and not name.endswith(".toml"):
        raise MissingBackend("muscle", name, MUSCLES)
    return Muscle.load(name)


def _joint(muscle: "Muscle", pulley: dict[str, float], supply: float, stops: tuple[float, float]) -> "AntagonistJoint":
    from allocator.geometry import Pulley
    from allocator.joint import AntagonistJoint
    from allocator.units import BAR

    return AntagonistJoint(Pulley(**pulley), muscle, muscle, (0.0, supply * BAR), angle_limits=stops)


def _map(
    axes: dict[str, Any], joint: "AntagonistJoint", min_force: float, max_memory: float, console: "Console"
) -> "FeasibilityMap":
    from rich.progress import track

    from allocator.feasibility.maps import feasibility_map

    def progress(chunks: Sequence[int]) -> Iterable[int]:
        return track(chunks, "mapping", console=console, transient=True) if len(chunks) >= _LONG else chunks

    return feasibility_map(**axes, joint=joint, min_force=min_force, max_bytes=max_memory * 1e9, progress=progress)


def _say(console: "Console", name: str, found: "FeasibilityMap") -> None:
    """One line on what exists, one on what ends it."""
    limits = dict.fromkeys(limit for edge in found.edges for limit in edge.active)
    console.print(
        f"{name}: {100 * found.share:.1f} % of {found.status.size} combinations exist\n"
        f"  ended by: {', '.join(limits) or 'nothing exists'}",
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def _write(maps: dict[str, "FeasibilityMap"], out: Path, pressures: bool) -> None:
    from allocator.feasibility.plotting import plot_maps, plot_pressures
    from allocator.plotting import save_figure

    first, *more = maps.values()
    ending = out.suffix.lower()
    if more and (ending in (".csv", ".npz") or pressures):
        raise InvalidInput("several muscles are for pictures of the edges; give one --muscle here")
    try:
        if ending == ".csv":
            first.to_csv(out)
        elif ending == ".npz":
            first.to_npz(out)
        elif pressures:
            save_figure(plot_pressures(first), out)
        else:
            save_figure((plot_maps(maps) if more else first.plot()).figure, out)
    except OSError as error:
        raise InvalidInput(f"--out {out} cannot be written ({error.strerror})") from None


__all__ = ["map_command"]
