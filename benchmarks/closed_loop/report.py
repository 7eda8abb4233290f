"""Report: medians against requirements, and the cases in which the MPC does not win."""

from collections.abc import Iterator

import numpy as np

import benchmarks.closed_loop as about
from benchmarks.closed_loop.cases import PLACED, PLANTS
from benchmarks.closed_loop.runs import CONTROLLERS, RUNGS, UNSTABLE, Row

ASKED = [  # quantity, case, figure, unit, must, stretch
    ("sine, RMS before the load", "sine", "rms", "°", 0.8, 0.5),
    ("sine, worst before the load", "sine", "worst", "°", 2.5, 1.7),
    ("min-jerk, RMS", "min-jerk", "rms", "°", 0.55, 0.4),
    ("min-jerk, worst", "min-jerk", "worst", "°", 2.1, 1.3),
    ("chirp, RMS", "chirp", "rms", "°", 0.45, 0.35),
    ("θ deviation during the K step, worst", "stiffness step", "worst", "°", 1.2, 0.7),
    ("true K, RMS on the sine", "sine", "K_rms", "N·m/rad", 0.15, 0.10),
    ("mean steady error under the load", "steps", "steady_mean", "°", 0.05, 0.03),
    ("steady error, peak to peak", "steps", "steady_swing", "°", 0.3, 0.15),
]
BROKEN = [
    ("unstable runs", "unstable"),
    ("runs with a limit exceeded", "limits_exceeded"),
    ("runs with a slack muscle", "slack"),
]
COMPARED = ("sine", "min-jerk", "chirp", "stiffness step")  # in the ratio of MPC and PID


def median(rows: list[Row], plant: str, case: str, controller: str, figure: str) -> float:
    """Return the median over the seeds."""
    chosen = [getattr(r.figures, figure) for r in rows if (r.plant, r.case, r.controller) == (plant, case, controller)]
    return float(np.median(chosen))


def unstable(rows: list[Row], plant: str, case: str, controller: str) -> tuple[int, int]:
    """Return the numbers of unstable and of all runs."""
    chosen = [r.figures.unstable for r in rows if (r.plant, r.case, r.controller) == (plant, case, controller)]
    return sum(chosen), len(chosen)


def shown(rows: list[Row], plant: str, case: str, controller: str, figure: str) -> str:
    """Return the median, or "unstable", since errors of unstable loops do not describe tracking."""
    broken, runs = unstable(rows, plant, case, controller)
    if broken:
        return f"unstable ({broken} of {runs})"
    return f"{median(rows, plant, case, controller, figure):.3g}"


def verdict(value: float, must: float, stretch: float) -> str:
    """Return the requirement met by `value`; NaN meets none."""
    return "stretch" if value <= stretch else "must" if value <= must else "**no**"


def markdown(rows: list[Row]) -> Iterator[str]:
    """Yield the lines of the report on `rows`."""
    assert about.__doc__ is not None
    title, _, rest = about.__doc__.partition("\n\n")
    yield "# " + title.removesuffix(".") + "\n"
    yield rest.partition("\n\n")[2]
    counts = {plant: len({r.seed for r in rows if r.plant == plant}) for plant in dict.fromkeys(r.plant for r in rows)}
    yield "Seeds: " + ", ".join(f"{plant} {n}" for plant, n in counts.items()) + ".\n"
    for plant in PLANTS:
        yield from _asked(rows, plant)
    yield from _untuned(rows)
    yield from _unstable(rows)
    yield from _defeats(rows)
    yield from _effort(rows)
    yield from _every_case(rows)


def _asked(rows: list[Row], plant: str) -> Iterator[str]:
    yield f"## Plant: {plant}\n"
    yield "| quantity | must | stretch | " + " | ".join(CONTROLLERS) + " | MPC meets |"
    yield "|---" * (4 + len(CONTROLLERS)) + "|"
    for quantity, case, figure, unit, must, stretch in ASKED:
        cells = " | ".join(shown(rows, plant, case, c, figure) for c in CONTROLLERS)
        ours = median(rows, plant, case, "mpc", figure)
        judged = "not asked" if figure == "K_rms" and plant == "both +10 %" else verdict(ours, must, stretch)
        yield f"| {quantity} [{unit}] | {must} | {stretch} | {cells} | {judged} |"
    ratios = {c: _ratio(rows, plant, c) for c in CONTROLLERS if c.endswith("pid")}
    cells = " | ".join(f"{ratios[c]:.3g}" if c in ratios else "" for c in CONTROLLERS)
    judged = verdict(max((r for r in ratios.values() if not np.isnan(r)), default=np.nan), 0.8, 0.6)
    yield f"| median MPC/PID over sine, min-jerk, chirp, K step | 0.8 | 0.6 | {cells} | {judged} |"
    for quantity, figure in BROKEN:
        broken = [
            sum(getattr(r.figures, figure) > 0 for r in rows if (r.plant, r.controller) == (plant, c))
            for c in CONTROLLERS
        ]
        yield f"| {quantity} | 0 | 0 | " + " | ".join(map(str, broken)) + f" | {verdict(broken[0], 0, 0)} |"
    yield ""


def _ratio(rows: list[Row], plant: str, pid: str) -> float:
    """Return the ratio over trajectories on which both are stable: an unstable PID would flatter."""
    stable = [c for c in COMPARED if not any(unstable(rows, plant, c, name)[0] for name in ("mpc", pid))]
    ratios = [median(rows, plant, c, "mpc", "rms") / median(rows, plant, c, pid, "rms") for c in stable]
    return float(np.median(ratios)) if ratios else np.nan


def _untuned(rows: list[Row]) -> Iterator[str]:
    yield "## The effect of tuning the PID\n"
    yield "Standard plant, RMS errors before the load [°]; gains that place poles (`cases.placed`), and tuned ones.\n"
    cases = dict.fromkeys(r.case for r in rows if r.controller in PLACED)
    yield "| | " + " | ".join(cases) + " |"
    yield "|---" * (1 + len(cases)) + "|"
    for c in (*PLACED, "pid", "predictive-pid"):
        yield f"| {c} | " + " | ".join(shown(rows, "standard", case, c, "rms") for case in cases) + " |"
    yield ""


def _unstable(rows: list[Row]) -> Iterator[str]:
    yield f"## Where a loop is unstable: the joint is thrown off by more than {UNSTABLE:g}°\n"
    for plant, c in dict.fromkeys((r.plant, r.controller) for r in rows if r.figures.unstable):
        cases = dict.fromkeys(r.case for r in rows if r.figures.unstable and (r.plant, r.controller) == (plant, c))
        counts = ("{} ({} of {} runs)".format(case, *unstable(rows, plant, case, c)) for case in cases)
        yield f"* {plant}: {c}: " + ", ".join(counts)
    yield ""


def _defeats(rows: list[Row]) -> Iterator[str]:
    yield "## Where the MPC does not win\n"
    for plant in PLANTS:
        for quantity, case, figure, unit, *_ in ASKED:
            values = {c: median(rows, plant, case, c, figure) for c in CONTROLLERS}
            best = min(values, key=lambda c: values[c])
            if best != "mpc":
                yield f"* {plant}: {quantity}: {best} {values[best]:.3g} {unit}, MPC {values['mpc']:.3g} {unit}"
    for plant, case, c in dict.fromkeys((r.plant, r.case, r.controller) for r in rows):
        if plant not in PLANTS and median(rows, plant, case, c, "rms") < median(rows, plant, case, "mpc", "rms"):
            theirs, ours = (median(rows, plant, case, name, "rms") for name in (c, "mpc"))
            yield f"* {plant}: {case}, RMS before the load: {c} {theirs:.3g} °, MPC {ours:.3g} °"
    yield ""


def _effort(rows: list[Row]) -> Iterator[str]:
    yield "## Air, time, and how the steps were answered\n"
    yield "Standard plant. Air: rises of both pressures [bar]. Time of a step: median / 99th percentile [ms].\n"
    yield "| | " + " | ".join(CONTROLLERS) + " |"
    yield "|---" * (1 + len(CONTROLLERS)) + "|"
    for case in dict.fromkeys(r.case for r in rows if r.plant == "standard"):
        yield (
            f"| air, {case} | "
            + " | ".join(f"{median(rows, 'standard', case, c, 'air'):.3g}" for c in CONTROLLERS)
            + " |"
        )
    times = (
        " / ".join(f"{median(rows, 'standard', 'sine', c, t):.2f}" for t in ("step_median", "step_p99"))
        for c in CONTROLLERS
    )
    yield "| time of a step, sine | " + " | ".join(times) + " |"
    total = np.sum([r.figures.rungs for r in rows if r.controller == "mpc"], axis=0)
    answered = ", ".join(f"{name} {n}" for name, n in zip(RUNGS, total.tolist(), strict=True))
    yield f"\nSteps of the MPC in all runs, by the rung that answered: {answered}.\n"


def _every_case(rows: list[Row]) -> Iterator[str]:
    yield "## Every plant and trajectory\n"
    yield "RMS / worst angle error before the load (with it), at the final rest peak to peak [°]; K RMS [N·m/rad]\n"
    yield "| plant | trajectory | " + " | ".join(CONTROLLERS) + " |"
    yield "|---" * (2 + len(CONTROLLERS)) + "|"
    for plant, case in dict.fromkeys((r.plant, r.case) for r in rows):
        there = {r.controller for r in rows if (r.plant, r.case) == (plant, case)}
        cells = [_cell(rows, plant, case, c) if c in there else "" for c in CONTROLLERS]
        yield f"| {plant} | {case} | " + " | ".join(cells) + " |"
    yield ""


def _cell(rows: list[Row], plant: str, case: str, controller: str) -> str:
    if unstable(rows, plant, case, controller)[0]:
        return shown(rows, plant, case, controller, "rms")
    names = ("rms", "worst", "rms_with_load", "worst_with_load", "steady_swing", "K_rms")
    a, b, c, d, swing, K = (median(rows, plant, case, controller, name) for name in names)
    return f"{a:.2f} / {b:.2f} ({c:.2f} / {d:.2f}), {swing:.2f}; {K:.3f}"
