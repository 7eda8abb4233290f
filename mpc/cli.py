"""List of all commands about motion.

Options are in degrees and bar, the library is in SI units. Heavy libraries are imported when a command runs.
"""

import os
import sys
import warnings

from allocator.cli import app
from allocator.shell import failures
from allocator.shell.options import Command
from mpc.bench.shell.cli import devices_command, run_command, sweep_command
from mpc.bench.shell.measure_cli import measure_command
from mpc.explorer.cli import explore
from mpc.export.cli import export_app
from mpc.export.serial.cli import bench_check_command
from mpc.identification.cli import fit_motion_command
from mpc.plant_cli import init_command
from mpc.track_cli.command import track_command
from mpc.trials.motions.trajectories import TRAJECTORIES
from mpc.tuning_cli import tune_command

_EPILOG = "\n\n".join(
    [
        "Standard trajectories, which are smaller on a joint that has less room:",
        *(f"{name}: {t.summary}" for name, t in TRAJECTORIES.items()),
    ]
)


app.command("track", cls=Command, short_help="simulate a controller on a joint or an arm", epilog=_EPILOG)(
    track_command
)
app.command("fit-motion", cls=Command, short_help="identify lags and hysteresis from a log of a moving joint")(
    fit_motion_command
)
app.add_typer(export_app, name="export", short_help="write C code, FMUs or firmware")
app.command("devices", cls=Command, short_help="list the devices that `run` and `sweep` drive")(devices_command)
app.command("run", cls=Command, short_help="drive a joint or an arm on a device")(run_command)
app.command("sweep", cls=Command, short_help="run the experiment that identifies a joint")(sweep_command)
app.command("measure", cls=Command, short_help="measure the stiffness of a joint on a device")(measure_command)
app.command("explore", cls=Command, short_help="explore a joint in the browser")(explore)
app.command("bench-check", cls=Command, short_help="check a board on a serial line")(bench_check_command)
app.command("tune", cls=Command, short_help="tune a controller for a fitted plant or an arm")(tune_command)
app.command("init", cls=Command, short_help="write a plant file to edit, for --machine")(init_command)


def main() -> None:
    """Run the command `antagonist` and leave Python with its exit code."""
    os.environ["MPLBACKEND"] = "agg"  # pictures are only written; notebooks may need another back-end
    with warnings.catch_warnings():
        warnings.showwarning = _one_line
        sys.exit(failures.run(app))


def _one_line(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning without the line of code that it came from."""
    print(f"antagonist: {message}", file=sys.stderr)
