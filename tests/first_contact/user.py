"""Days with a muscle of one's own: fit it, put it on a joint, and try every command, all in one process.

Called in a directory that holds `days.json`, by the name of a day {"fit": arguments of `antagonist fit`, or none,
"muscle": the name of a muscle or its file, "geometry": a name, "tracked": whether it is}; each has a directory of its
name. It leaves `done.json` there, what every command came to by day and command.
"""

import json
import sys
import traceback
import warnings
from contextlib import chdir, redirect_stderr, redirect_stdout
from io import StringIO
from time import perf_counter

import numpy as np

from allocator import DEG, AntagonistJoint, Lever, Table, report_joint, save_machine, stiffness_interval
from allocator.muscles.catalogue import named_muscle
from mpc import sine
from mpc.cli import main
from mpc.trials.files import save_reference
from mpc.trials.motions.trajectories import usual_stiffness

warnings.filterwarnings("ignore", "the force is extrapolated")  # the whole range of the joint is more than was measured

STOPS = (-45 * DEG, 45 * DEG)
ANGLES = np.linspace(-0.9, 0.9, 4)
GEOMETRIES = {
    "pulley": None,  # that of the commands
    "lever": Lever(rest_length=0.40, anchor=0.30, lever=0.03, offset=0.0435),
    "table": Table(0.40, ANGLES, 0.13 + 0.04 * np.sin(ANGLES), 0.13 - 0.045 * np.sin(ANGLES)),
}


def called(*arguments):
    """What the command prints, its exit code, a traceback instead where it leaves one, and how long it took."""
    out, err, begun = StringIO(), StringIO(), perf_counter()
    sys.argv = ["antagonist", *map(str, arguments)]
    with redirect_stdout(out), redirect_stderr(err):
        try:
            main()
            code = None
        except SystemExit as end:
            code = end.code
        except Exception:
            code = traceback.format_exc()
    return {"code": code, "out": out.getvalue(), "err": err.getvalue(), "seconds": perf_counter() - begun}


def day(plan):
    """Every command on the joint."""
    done = {"fit": called("fit", *plan["fit"])} if "fit" in plan else {}
    muscle, name = named_muscle(plan["muscle"]), plan["geometry"]
    geometry = GEOMETRIES[name]
    joint, given = report_joint(muscle), ["--muscle", plan["muscle"]]
    if geometry is not None:
        joint = AntagonistJoint(geometry, muscle, muscle, angle_limits=STOPS)
        save_machine(joint, f"{name}.toml")
        given = ["--machine", f"{name}.toml"]
    K, reachable = usual_stiffness(joint), stiffness_interval(5 * DEG, 0.2, joint=joint)
    save_reference(sine(amplitude=5 * DEG, K=K, duration=0.3, ramp=0.1), f"{name}.csv")
    around = ("--theta=-10:10:5", f"--stiffness={0.8 * K:.4g}:{1.2 * K:.4g}:{0.2 * K:.4g}")
    commands = {
        "allocate": ("allocate", "--theta", "5", "--torque", "0.2", "--stiffness", f"{np.mean(reachable):.17g}"),
        "map": ("map", *around, "--out", f"{name}-map.csv"),
        "export": ("export", "controller", "--out", f"{name}-c", "--errors", "theta=0.1,rate=0.3", "--horizon", "5"),
    }
    if plan["tracked"]:
        short = ("--plant", "nominal", "--horizon", "10")
        commands["track"] = ("track", f"{name}.csv", *short, "--out", f"{name}.npz")
    return done | {command: called(*arguments, *given) for command, arguments in commands.items()}


if __name__ == "__main__":
    with open("days.json", encoding="utf-8") as file:
        plans = json.load(file)
    done = {}
    for name, plan in plans.items():
        with chdir(name):
            done[name] = day(plan)
    with open("done.json", "w", encoding="utf-8") as file:
        json.dump(done, file)
