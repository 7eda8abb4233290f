"""Arms of the command line: whose stiffness they track, their hand, and their references."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar, NamedTuple

import typer

from allocator.errors import InvalidInput, MissingBackend

if TYPE_CHECKING:
    from allocator.mechanism.endpoint import Endpoint
    from mpc.model.arm.model import Arm
    from mpc.model.arm.reading import Read
    from mpc.plant_cli import PlantOptions
    from mpc.trials.motions.corrections import Owner
    from mpc.trials.motions.reference import Reference

_JOINTS, _HAND = _TRACKED = "joints", "hand"
_CIRCLE = "circle"


@dataclass(frozen=True)
class HandOptions:
    """Options of the stiffness that several joints track."""

    PANEL: ClassVar[str] = "Several joints"

    stiffness_of: Annotated[str, typer.Option(help="stiffness to track: that of the joints, or of the hand")] = _JOINTS
    hand: Annotated[
        str | None,
        typer.Option(help="hand of a MuJoCo model: a site or a body; with some of its coordinates, such as tip:xy"),
    ] = None

    def __post_init__(self) -> None:
        if self.stiffness_of not in _TRACKED:
            raise MissingBackend("stiffness to follow", self.stiffness_of, _TRACKED)


class Described(NamedTuple):
    """Arm of the options, with the place of its hand and remarks about it."""

    arm: "Arm"
    hand: "Endpoint | None"
    notes: list[str]
    read: "Read | None"  # the MuJoCo model


def described(options: "PlantOptions", more: HandOptions) -> Described:
    """Return the arm of the options, which tracks the stiffness that they name. Raises `InvalidInput`."""
    arm, hand, notes, read = _from_mujoco(options, more) if options.is_mujoco else _with_bodies(options, more)
    if more.stiffness_of == _HAND:
        if hand is None:
            raise InvalidInput(f"--stiffness-of hand: {options.machine} has no hand; name a site or body with --hand")
        arm = replace(arm, endpoint=hand)
    return Described(arm, hand, notes, read)


def _with_bodies(options: "PlantOptions", more: HandOptions) -> Described:
    if more.hand is not None:
        raise InvalidInput(f"--hand is of a MuJoCo model: --machine FILE.xml; {options.machine} has its own")
    arm = options.arm()
    return Described(arm, arm.bodies.endpoint, [], None)


def _from_mujoco(options: "PlantOptions", more: HandOptions) -> Described:
    """Read the arm of a MuJoCo model. Raises the errors of `PlantOptions.mujoco`."""
    read = options.mujoco(more.hand)
    notes = [f"muscles: {', '.join(options.mujoco_muscles)}"]
    if read.hand is not None:
        coordinates = getattr(read.hand.kinematics, "axes", "")
        notes.append(f"hand: {read.hand_name} ({', '.join(coordinates)})")
    if read.asked_of_mujoco:
        notes.append(f"without formulas, so that a step is slow: {read.asked_of_mujoco}")
    if read.left_out:
        notes.append(f"not in the controller's model: {read.left_out}")
    return Described(options.mujoco_arm(read), read.hand, notes, read)


def owner_of_arm(options: "PlantOptions", more: HandOptions, arm: "Arm", load: str) -> "Owner":
    """Return the owner of a correction from the files of an arm, the stiffness that it tracks and its load."""
    from mpc.trials.motions.corrections import Owner, digest_of

    named = [str(options.machine), *(options.muscle or [])]
    texts = (Path(name).read_text(encoding="utf-8") if Path(name).is_file() else name for name in named)
    return Owner(arm.summary, digest_of("\0".join(texts), more.stiffness_of, more.hand), load=load)


def refuse_options_of_one_joint(**given: object) -> None:
    """Refuse options that only one joint has. Raises `InvalidInput` for any that is not None."""
    if option := next((name for name, value in given.items() if value is not None), None):
        raise InvalidInput(
            f"--{option} is for one joint; several joints track their usual stiffness with mpc and its observer"
        )


def asked_of_arm(trajectory: str | None, arm: "Arm", hand: "Endpoint | None") -> "Reference":
    """Return the reference of a name, or that of a user's file; by default the circle."""
    from mpc.trials.files import is_recording, recorded
    from mpc.trials.motions.arm_trajectories import REFERENCES, reference
    from mpc.trials.motions.motion_files import load_motion

    trajectory = trajectory or _CIRCLE
    if is_recording(trajectory):
        return recorded(trajectory, arm)
    if trajectory not in REFERENCES and (Path(trajectory).suffix or Path(trajectory).exists()):
        return load_motion(trajectory, arm, hand)
    return reference(trajectory, arm)
