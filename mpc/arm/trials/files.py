"""Runs of arms are kept as CSV tables, a line a sample."""

from pathlib import Path

import numpy as np

from allocator.calculus import Array
from allocator.files.atomic import write_text
from allocator.units import BAR, DEG
from mpc.arm.trials.simulation import ArmRun


def columns(run: ArmRun) -> dict[str, Array]:
    """Return the run as columns (M+1,) by their names, which carry units; forces in N.

    Stiffness is that of the joints, K11 …, in N·m/rad, or of the endpoint, Kx11 …, in N/m.

    The commands of a line hold until the next, the last line repeats them.
    """
    arm = run.arm
    sent = np.vstack([run.u, run.u[-1:]])
    found = {"t": run.t}
    for i, name in enumerate(arm.mechanism.joint_names):
        found[f"{name}_deg"], found[f"{name}_ref_deg"] = run.q[:, i] / DEG, run.q_ref[:, i] / DEG
    for row, column in zip(*np.triu_indices(arm.tracked), strict=True):
        entry = f"{arm.stiffness_name}{row + 1}{column + 1}"
        found[entry], found[f"{entry}_ref"] = run.K[:, row, column], run.K_ref[:, row, column]
    for j, name in enumerate(arm.mechanism.muscle_names):
        found[f"{name}_bar"], found[f"{name}_command_bar"] = run.P[:, j] / BAR, sent[:, j] / BAR
        found[f"{name}_N"] = run.forces[:, j]
    return found


def save_arm_run(run: ArmRun, path: str | Path) -> None:
    """Write `run` as a CSV table. Raises `CannotWrite`."""
    named = columns(run)
    lines = [",".join(name.replace(" ", "_") for name in named)]
    lines += [",".join(f"{value:.9g}" for value in row) for row in np.column_stack(list(named.values())).tolist()]
    write_text(path, "\n".join(lines) + "\n")
