"""The MPC on a plant equal to its model: the loss by one QP per sample.

    python -m benchmarks.nominal [--out benchmarks/results]

The reference is the nonlinear MPC, solved by IPOPT to convergence at every sample: the same objective, limits, horizon
(N = 20, dt = 10 ms), previews and plant (the report's joint). Both are judged by the cost of the actual motion
(`benchmarks.objective`). Trajectories in capitals saturate: "JUMPS" stays on the slew limit, "SUPPLY" requires more
stiffness than the supply allows, "SLACK" less than taut muscles have. The output is `nominal.csv` (every run) and
`nominal.md` (against requirements).

A cost of a few units is negligible: 1 is an error of 0.02° in two samples. At negligible costs the barrier of an
interior-point method is visible, and one QP, with an exact solution, can be below IPOPT. Far from the reference
("JUMPS") the single linearisation per sample is visible, and a second QP removes the excess. On "SLACK" the two solvers
of the nonlinear problem also differ, although all of their answers satisfy the conditions of optimality: near slack
muscles the reference is no more accurate than that.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.objective import closed_loop_cost
from mpc import KalmanObserver, NonlinearMPC, Plant, RealPlant, Reference, Run, TrackingMPC, Weights, simulate, sine
from mpc.trials.metrics import metrics
from mpc.trials.motions.trajectories import LEAD, TRAJECTORIES, stiffness_step
from mpc.trials.simulation import Controller

PLANT, K = Plant(), 7.6
MUST, STRETCH = 0.5, 0.05  # [%]


def held(times: list[float], theta_deg: list[float], stiffness: list[float]) -> Reference:
    """Return values that hold until the next time [s], sampled every 10 ms; the last time is the end."""
    t = 0.01 * np.arange(round(times[-1] / 0.01) + 1)
    now = np.searchsorted(times[1:-1], t + 1e-6)
    return Reference(t, np.array(theta_deg)[now] * DEG, np.array(stiffness)[now])


CASES = {
    "report's sine": sine(),
    **{name: standard.about(K) for name, standard in TRAJECTORIES.items() if name != "jumps"},
    "JUMPS": held([0, 0.2, 1.2, 2.2], [0, 25, -25], [K, K, K]),
    "SUPPLY": held([0, 0.2, 1.2, 2.0], [0, 30, 30], [8.5, 10, 8]),
    "SLACK": held([0, 0.2, 1.2, 2.0], [0, 20, -20], [7, 6.3, 6.3]),
}
CONTROLLERS = {
    "NMPC, IPOPT": lambda: NonlinearMPC(PLANT),
    "NMPC, fatrop": lambda: NonlinearMPC(PLANT, solver="fatrop"),
    "one QP": lambda: TrackingMPC(PLANT),
    "two QPs": lambda: TrackingMPC(PLANT, iterations=2),
}


class Row(NamedTuple):
    """One run."""

    case: str
    controller: str
    cost: float
    theta_rms: float  # [°]
    K_rms: float  # [%]
    slack: float  # [N] greatest slack of a muscle
    step_median: float  # [ms]
    not_optimal: int  # steps answered by a lower rung


def row(case: str, name: str, controller: Controller) -> Row:
    run = simulate(PLANT, controller, CASES[case])
    m = metrics(run)
    lower = len(run.u) - m.rungs["QP"]
    cost = closed_loop_cost(run, Weights()).total
    return Row(case, name, cost, m.theta_rms, m.K_rms, m.violations["slack muscle"][0], m.step_median, lower)


def deviation(run: Run) -> float:
    """Return the greatest error of the angle after the first rest [°]."""
    return float(np.abs(run.theta - run.theta_ref)[round(LEAD / run.dt) :].max()) / DEG


def stiffness_steps() -> Iterator[tuple[str, float]]:
    """Yield the motions of the angle while the stiffness steps from 7 to 8 and back, under a known load [°]."""
    shaped = stiffness_step((7.0, 8.0))
    at_once = Reference(shaped.t, shaped.theta, np.where((shaped.t >= LEAD) & (shaped.t < LEAD + 2), 8.0, 7.0))
    hanging = Plant(gravity_torque=3.0)  # 1.0 N·m at 20°
    for name, reference in (("in 0.3 s", shaped), ("at once", at_once)):
        yield f"{name}, load of gravity", deviation(simulate(hanging, TrackingMPC(hanging), reference))
        loaded = RealPlant(PLANT, torque_profile=((0.0, 1.0),))
        watched = simulate(loaded, TrackingMPC(PLANT), reference, observer=KalmanObserver(PLANT, 0.01))
        yield f"{name}, load seen by the observer", deviation(watched)


def verdict(value: float, must: float, stretch: float) -> str:
    return "stretch" if value <= stretch else "must" if value <= must else "**no**"  # NaN meets nothing


def markdown(rows: list[Row], steps: list[tuple[str, float]]) -> Iterator[str]:
    assert __doc__ is not None
    yield "# " + __doc__.splitlines()[0] + "\n"
    yield __doc__.partition("\n\n")[2].partition("\n\n")[2]
    found = {(r.case, r.controller): r for r in rows}
    base, *others = CONTROLLERS
    yield "## Closed-loop cost\n"
    yield f"Above the cost of {base}, in per cent; asked of one QP: {MUST} %, stretch {STRETCH} %.\n"
    yield f"| trajectory | cost of {base} | " + " | ".join(others) + " | one QP meets | steps not optimal |"
    yield "|---" * (4 + len(others)) + "|"
    for case in CASES:
        best = found[case, base].cost
        excess = {name: 100 * (found[case, name].cost / best - 1) for name in others}
        cells = " | ".join(f"{v:+.4f}" for v in excess.values())
        lower = sum(found[case, name].not_optimal for name in CONTROLLERS)
        yield f"| {case} | {best:.5g} | {cells} | {verdict(excess['one QP'], MUST, STRETCH)} | {lower} |"
    ours = found["report's sine", "one QP"]
    yield "\n## Errors\n\n| quantity | asked | one QP |\n|---|---|---|"
    yield f"| ±40° sine, K = 7.6 ± 0.3: θ RMS [°] | 0.05 | {ours.theta_rms:.2g} |"
    yield f"| the same: K RMS [%] | 0.2 | {ours.K_rms:.2g} |"
    yield from (
        f"| K from 7 to 8 and back at 20°, {name}: θ moves by [°] | 0.1 | {moved:.2g} |" for name, moved in steps
    )
    times = ", ".join(
        f"{name} {np.median([r.step_median for r in rows if r.controller == name]):.2g}" for name in CONTROLLERS
    )
    yield f"\nMedian time of a step [ms]: {times}.\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, build in CONTROLLERS.items():
        controller = build()
        for case in CASES:
            rows.append(row(case, name, controller))
            print(f"{name}, {case}: cost {rows[-1].cost:.6g}", flush=True)
    with (given.out / "nominal.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(Row._fields)
        writer.writerows([f"{v:.9g}" if isinstance(v, float) else v for v in r] for r in rows)
    text = "\n".join(markdown(rows, list(stiffness_steps())))
    (given.out / "nominal.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
