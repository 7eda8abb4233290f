"""Command `antagonist plan-joint`: the pressures, weights and sag tests to measure for `fit-joint`."""

from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.console import Console

from allocator.files.atomic import write_text
from allocator.files.toml import Table
from allocator.identification.joint.planning.plan import LEVELS, JointPlan, plan_joint_experiment
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.shell.machine_options import MachineOptions
from allocator.shell.options import grouped, within
from allocator.shell.outputs import AsJSON, Force, check_ending, claim, print_json, say, write
from allocator.units import BAR, DEG, PERCENT

_HEADER = "theta_deg,pressure1_bar,pressure2_bar,torque_Nm,direction,slack,expected"


@grouped
def plan_joint_command(
    options: MachineOptions,
    accuracy: Annotated[float, typer.Option(help="wanted standard deviation of K from noise [%]")] = 5.0,
    noise: Annotated[float, typer.Option(help="standard deviation of an angle reading [degrees]")] = 0.5,
    weight: Annotated[
        list[float] | None, typer.Option(help="torque of an available weight [N·m]; may be repeated")
    ] = None,
    setpoints: Annotated[
        int | None, typer.Option(help="number of setpoints; by default three times the unknowns of the fit")
    ] = None,
    lowest: Annotated[float | None, typer.Option(help="least pressure to visit [bar]; 1.5 by default")] = None,
    out: Annotated[Path | None, typer.Option(help="table (.csv) to fill in; fit-joint reads it unchanged")] = None,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Plan the measurement of a roughly known joint: setpoints, a weight, and a sag test of the muscle forces.

    Describe the joint with the options below, from a data sheet or a first fit. The table of --out has a row for each
    reading, with an empty theta_deg, and one for each angle of a sag test (slack = 1, 2 or 3: agonist, antagonist,
    both), with empty pressures. Fill in the cells, delete the rows that were not measured, and give the table to
    `antagonist fit-joint`.
    """
    within("--accuracy", accuracy, "%", 0.01, 99)
    within("--noise", noise, "degrees", 1e-4, 45)
    check_ending("--out", out, (".csv",))
    claim(out, inputs=options.files, force=force)
    joint = options.joint()
    supply = joint.pressure_limits[1]
    within("--lowest", lowest, "bar", 0.01, supply / BAR)
    plan = plan_joint_experiment(
        joint,
        accuracy=accuracy * PERCENT,
        noise=noise * DEG,
        weights=weight,
        setpoints=setpoints,
        gravity=NO_GRAVITY if options.file is None else Gravity.of_file(Table.read(options.file)),
        pressures=None if lowest is None else np.linspace(lowest * BAR, supply, LEVELS),
    )
    console = Console(stderr=as_json)
    if as_json:
        print_json(_planned(plan))
    else:
        say(console, str(plan))
    write(out, lambda path: write_text(path, "\n".join([_HEADER, *_visits(plan)]) + "\n"), console)


def _visits(plan: JointPlan) -> list[str]:
    """Return a row for each visit of a setpoint, falling and rising, and one for each angle of the sag test."""
    rows = []
    for s in plan.setpoints:
        given = f"{s.P1 / BAR:.4g},{s.P2 / BAR:.4g},{s.torque:.4g}"
        rows += [f",{given},{way},0,{a / DEG:.1f} deg" for way, a in ((-1, s.falling), (1, s.rising))]
    for point in plan.further[0].sag if plan.further else ():
        cells = [("", f"P{i} = {P / BAR:.2g} bar") if P == P else ("0", "") for i, P in ((1, point.P1), (2, point.P2))]
        (P1, first), (P2, second) = cells
        expected = " and ".join(filter(None, (first, second)))
        rows.append(f"{point.theta / DEG:.1f},{P1},{P2},0,0,{point.slack},{expected}")
    return rows


def _planned(plan: JointPlan) -> dict[str, object]:
    """Return the values printed by `--json`."""
    return {
        "weight_Nm": plan.weight,
        "accuracy_of_stiffness": plan.accuracy,
        "expected_error_of_stiffness": plan.expected,
        "reached": plan.reached,
        "unknowns_of_the_fit": plan.unknowns,
        "setpoints": [
            {
                "torque_Nm": s.torque,
                "pressure1_bar": s.P1 / BAR,
                "pressure2_bar": s.P2 / BAR,
                "theta_falling_deg": s.falling / DEG,
                "theta_rising_deg": s.rising / DEG,
            }
            for s in plan.setpoints
        ],
        "further": [
            {
                "measurement": s.name,
                "how": s.how,
                "force_std": s.forces,
                "stiffness_std": s.stiffness,
                "gain": s.gain,
                "sag_test": [
                    {"theta_deg": p.theta / DEG, "pressure1_bar": p.P1 / BAR, "pressure2_bar": p.P2 / BAR}
                    for p in s.sag
                ],
            }
            for s in plan.further
        ],
    }
