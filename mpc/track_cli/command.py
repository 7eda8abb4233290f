"""The command `antagonist track`."""

from contextlib import ExitStack
from pathlib import Path
from typing import Annotated

import typer

from allocator.errors import InvalidInput
from allocator.shell.options import grouped
from allocator.shell.outputs import IMAGES, Force, check_ending, claim, files_of_run
from mpc.plant_cli import LoopOptions, PlantOptions
from mpc.repetition.options import RepeatOptions
from mpc.track_cli.options import ArmOptions, Request, TrialOptions

_SUFFIXES = (*IMAGES, ".csv", ".npz", ".mcap", ".gif", ".mp4")
_OWN_NAMES = ("tracking.png", "tracking.csv")
_OWN_FILM = "tracking.gif"  # for several joints


@grouped
def track_command(
    options: PlantOptions,
    at: LoopOptions,
    more: ArmOptions,
    repeated: RepeatOptions,
    tried: TrialOptions,
    trajectory: Annotated[
        str | None,
        typer.Argument(
            help="sine (the default), min-jerk, chirp, steps, stiffness-step, stiffness-ramps, together, jumps, "
            "or a file; a CSV has the columns t,theta_deg,stiffness. Standard trajectories are smaller on a "
            "joint with less room. For several joints: circle (the default), reach, hold, draw (arm26), or a "
            "CSV of angles or of the hand's path and of stiffness. An .npz of a run repeats its trajectory"
        ),
    ] = None,
    reference: Annotated[str | None, typer.Option(help="file of the trajectory; instead of the argument")] = None,
    out: Annotated[
        list[Path] | None,
        typer.Option(
            help="a .png, .gif, .mp4, .csv, .npz or .mcap to write, or a directory; may be repeated. A directory "
            "gets tracking.png and tracking.csv, and for several joints tracking.gif"
        ),
    ] = None,
    margins: Annotated[Path | None, typer.Option(help="picture of the loop's margins at three postures")] = None,
    show: Annotated[bool, typer.Option("--show", help="open the picture when it is written")] = False,
    force: Force = False,
) -> None:
    """Simulate a controller that tracks angle and stiffness, and report its errors.

    By default the controller drives a joint that its model does not describe: muscles of another force law, 10 %
    stronger and weaker than modelled, with hysteresis, dead time and noise.

    With several joints (--machine arm26, arm48, leg37, a file with [bodies], or a MuJoCo model (.xml) on hinges with
    tendons as muscles) the controller tracks angles and a stiffness matrix on MuJoCo, and the motion is filmed.
    """
    if None not in (trajectory, reference):
        raise InvalidInput(f"two trajectories are asked for: {trajectory} and --reference {reference}; leave one out")
    trajectory = trajectory if reference is None else reference
    several = options.of_several
    own = (*_OWN_NAMES, _OWN_FILM) if several else _OWN_NAMES
    files = files_of_run(out or [Path()], _SUFFIXES, own)
    check_ending("--margins", margins, IMAGES)
    learned = repeated.written(trajectory)
    claim(*files, margins, *learned, inputs=(trajectory, repeated.learned, *options.files), force=force, own=own)
    if not several and more != ArmOptions():
        raise InvalidInput("--stiffness-of, --hand, --catch and --view go with a --machine of several joints")
    request = Request(options, at, more, repeated, tried, trajectory, files)

    from rich.console import Console

    from mpc.track_cli.trial import driven, reported, shown, written
    from mpc.trials.pictures.animation import check_film

    console = Console()
    for path in files:
        check_film(path)
    with ExitStack() as opened:
        if several:
            from mpc.track_cli.arm import arm_trial

            trial = arm_trial(request, opened)
        else:
            from mpc.track_cli.joint import joint_trial

            trial = joint_trial(request)
        outcome = driven(trial, repeated, tried.seed, console)
    reported(trial, outcome, learned, console)
    files = written(trial, outcome.run, files, margins, console)
    if show:
        shown(files)
