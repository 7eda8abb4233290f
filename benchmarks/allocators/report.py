"""CSV files and Markdown report."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks.allocators.comparison import Results
from benchmarks.allocators.contenders import PRIORITIES, WEIGHTS
from benchmarks.allocators.machine import machine, versions
from benchmarks.allocators.measures import Score
from benchmarks.allocators.summary import EXPLAINED, HEADER, digits, error, findings, percent, summary
from benchmarks.allocators.targets import STRETCH

NAME = "allocators"

METHOD = f"""\
**Targets.** *Fig. 8*: the ranges of the report's figure, K = 6…9 N·m/rad, θ = ±125°, T = 0. *random*: seeded angles,
torques and stiffnesses over {STRETCH:g} times the feasible range (θ at most a turn, K > 0; T and K at the nearest angle
inside), so most of them cannot be met. *feasible*: torque and stiffness of random allowed pressures.

**Contenders.** *inverse*: the raw closed-form pressures. *clipped*: to the supply, 0 ≤ P ≤ 5 bar, the usual practice.
*in the box*: clipped to all limits, including taut cables, which requires this library's box. Without an inverse the
answer is NaN, also clipped; it counts as neither within limits nor taut, and in no error.
*exact* and the back-ends are `allocate` with its methods; a weighted cost has w_T = {WEIGHTS[0]:g}, w_K =
{WEIGHTS[1]:g}. The inverse has no priority and is the same in all tables.

**Measures.** Computed from the pressures by the muscle laws, at the nearest feasible angle: a cable with a negative
force is slack and gives no torque, no stiffness. Errors are RMS (worst), over the targets with a feasible angle; *where
feasible*: over those of them with a feasible torque within all limits. The raw inverse's pressures are used even if no
valve can give them, so its errors only show slack cables; its clipped form is more informative.

**Checked before anything is counted** (the run aborts otherwise): every allocator's answer is within all limits; an
answer not marked SOLVER_FAILED has a residual below 1e-5 of the supply range; an answer marked EXACT meets both
targets; none is better than `exact`.
"""

PLOTS = f"""\
![Share of answers within all limits]({NAME}_within_limits.png)

![Torque error where the torque is feasible]({NAME}_torque_error.png)

The report's Fig. 8: the pressures of the inverse, and the feasible ones.

![Difference and sum of the pressures over the angle]({NAME}_pressures.png)

![Time, and iterations with and without the warm start]({NAME}_time.png)
"""

LIMITATIONS = """\
* Errors are against the muscle model that the allocators use. A real muscle differs by 10–15 %: a torque error of
  "< 1e-5" means that the allocation loses no torque, not that a real joint would be as accurate.
* Random targets are uniform over a box that is wider than the feasible set by choice; the targets of a task, and their
  shares, would differ. Only Fig. 8 is not our choice.
* The baseline only clips. A controller around it would recover some of the lost torque by integration.
* Times are of one run on a shared machine, in one process; only ratios count. Batches are vectorised for the inverse
  and `exact`, while the optimisers solve target by target. Single calls include the fixed cost of vectorised code,
  least for the inverse alone.
* If the warm start is the answer, as for every feasible target, no solver runs. "Iterations" are QPs for qp and convex,
  and the solver's own count for nlp: compare within a row only.
* Solver options are the library's, tight enough to agree with `exact`; at their defaults the solvers are faster and
  coarser. Nothing was tuned for this comparison.
* A residual certifies a first-order optimum. The weighted cost of Tondu2021 is not convex, so a back-end may end in a
  worse local optimum than `exact` ("worse than exact").
* No slew limit, force ceiling, co-contraction floor or pull: the inverse cannot handle them.
* Joints with a numerical inverse (unequal Tondu2021, Tondu2021 on a lever) are not timed.
"""


def write(results: Results, out: Path) -> None:
    """Write everything into the folder `out`."""
    write_csv(out / f"{NAME}.csv", results.scores)
    write_csv(out / f"{NAME}_time.csv", results.times)
    write_csv(out / f"{NAME}_warm_start.csv", results.gains)
    (out / f"{NAME}.md").write_text("\n".join(markdown(results)), encoding="utf-8")


def write_csv(path: Path, records: Sequence[Any]) -> None:
    """Write one line per record, floats to six digits."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(asdict(records[0])))
        writer.writeheader()
        for record in records:
            values = asdict(record).items()
            writer.writerow({name: f"{value:.6g}" if isinstance(value, float) else value for name, value in values})


def markdown(results: Results) -> Iterator[str]:
    """Yield the report."""
    size = "a quick run on small sets" if results.quick else "a full run"
    yield f"# The allocators against the analytic inverse\n\nOf {size} of `python -m benchmarks.allocators`.\n"
    yield from (f"* {sentence}" for sentence in findings(results))
    yield f"\n## Main table\n\n{EXPLAINED}\n"
    yield from table(HEADER, summary(results))
    yield f"\n## Plots\n\n{PLOTS}\n## Comparison\n\n{METHOD}"
    for priority in PRIORITIES:
        yield f"## Priority: {priority}\n"
        yield from accuracy([s for s in results.scores if s.priority == priority])
    yield "## Time\n\nPer target, priority torque; a batch is one call for all targets.\n"
    yield from table(TIME_HEADER, time_rows(results))
    yield "\n## Warm start\n\nPriority torque; without it the optimisers start in the middle of the box.\n"
    yield from table(GAIN_HEADER, gain_rows(results))
    yield f"\n## Limitations\n\n{LIMITATIONS}\n## Machine and versions\n\n{machine()}.\n{versions()}.\n"


def table(header: Iterable[str], rows: Iterable[Sequence[str]]) -> Iterator[str]:
    """Return a Markdown table; all but the first column are numbers."""
    names = list(header)
    yield f"| {' | '.join(names)} |"
    yield "|---|" + "--:|" * (len(names) - 1)
    yield from (f"| {' | '.join(row)} |" for row in rows)


ACCURACY_HEADER = (
    "contender",
    "within all limits",
    "taut",
    "NaN",
    "T error [N·m]",
    "K error [N·m/rad]",
    "T error where feasible",
    "K error there",
    "failures",
    "worse than exact",
    "distance to exact",
)


def accuracy(scores: Sequence[Score]) -> Iterator[str]:
    """Yield a table for every set."""
    for first in [
        s for i, s in enumerate(scores) if not i or (s.set, s.joint) != (scores[i - 1].set, scores[i - 1].joint)
    ]:
        mine = [s for s in scores if (s.set, s.joint) == (first.set, first.joint)]
        yield (
            f"**{first.set}, {first.joint}**: {first.targets} targets, {first.in_range} with feasible angles, "
            f"{first.torque_reachable} of them with feasible torques.\n"
        )
        yield from table(ACCURACY_HEADER, (accuracy_row(s) for s in mine))
        yield ""


def accuracy_row(s: Score) -> tuple[str, ...]:
    return (
        s.contender,
        percent(s.within_limits),
        percent(s.taut),
        percent(s.nan),
        error(s.T_rms, s.T_worst),
        error(s.K_rms, s.K_worst),
        error(s.T_rms_reachable, s.T_worst_reachable),
        error(s.K_rms_reachable, s.K_worst_reachable),
        percent(s.solver_failed),
        *(("", "") if s.contender.startswith("inverse") else (percent(s.worse_than_exact), distance(s))),
    )


def distance(s: Score) -> str:
    return f"{s.distance_to_exact:.0e}" if s.distance_to_exact else "0"


TIME_HEADER = ("contender", "set", "batch [µs]", "batch / exact", "single call [µs]")


def time_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for t in results.times:
        yield t.contender, f"{t.set}, {t.joint}", digits(t.batch_us), digits(t.ratio), digits(t.single_us)


GAIN_HEADER = (
    "back-end",
    "set",
    "iterations with",
    "without",
    "time with [µs]",
    "without",
    "speed-up",
    "failures",
    "without",
)


def gain_rows(results: Results) -> Iterator[tuple[str, ...]]:
    for g in results.gains:
        yield (
            g.back_end,
            f"{g.set}, {g.joint}",
            f"{g.iterations_warm:.3g}",
            f"{g.iterations_cold:.3g}",
            digits(g.warm_us),
            digits(g.cold_us),
            digits(g.speed_up),
            percent(g.failed_warm),
            percent(g.failed_cold),
        )
