"""Search for the worst QPs: random and adversarial states and references, and variations of the worst.

    python -m benchmarks.speed.worst_cases [--number 100000] [--horizon 20] [--seed 0] [--out benchmarks/results]

Every fourth QP is a slight variation of one of the worst so far. Recorded for the structured solver are whether it
proves its solution, its exchanges of active limits, and the time. One in a hundred is also solved by DAQP, and the
commands are compared, as is every QP without a proof. With `--out` the results of each horizon and seed are kept in
`worst_cases.csv`, and those of all seeds are written to `worst_cases.md`.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from time import thread_time
from typing import Any, NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR
from mpc import PlanStatus, Plant, TrackingMPC, Weights
from mpc.tracking.compiled.structured_qp.solve import MOST
from mpc.tracking.qp.condense import condense
from mpc.tracking.qp.solvers import DAQP
from mpc.tracking.qp.step import PreviousSample, certified

DT, KEPT = 0.01, 40
CHECKED = 101  # one of so many: not a multiple of the settings


class Situation(NamedTuple):
    """Data of a QP as numbers, so that it can be varied."""

    x: Array  # (4,)
    previous: Array  # (2,) command [Pa]
    begin: Array  # (2,) initial commands, the centre of the oscillation [Pa]
    swing: Array  # (2,) amplitude [Pa]
    reference: Array  # (4,) angle before and after a jump [rad], its place, stiffness [N·m/rad]
    load: float  # [N·m]


class Row(NamedTuple):
    """Results of one horizon and seed; times in µs, of this machine."""

    horizon: int
    seed: int
    number: int
    exchanges_median: float
    exchanges_99: float
    exchanges_most: float
    time_median: float
    time_99: float
    time_9999: float
    time_most: float
    unproved: int  # answered with their gap
    unsolved: int  # nor solved by DAQP
    apart: float  # [bar] from DAQP at most


@dataclass
class Hunt:
    """Results of the search."""

    exchanges: list[int] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    unproved: int = 0  # by the structured solver
    unsolved: int = 0  # nor by DAQP
    apart: list[float] = field(default_factory=list)  # [bar] from DAQP
    worst: list[tuple[int, Situation]] = field(default_factory=list)


def random_situation(rng: np.random.Generator, plant: Plant) -> Situation:
    """Return a random situation: angles outside, slack cables, pressures outside the supply, jumps of references."""
    (left, right), (low, high) = plant.joint.angle_range, plant.joint.pressure_limits
    angle, wild = rng.uniform(left - 0.1, right + 0.1), rng.random() < 0.5
    pressure = (low - 0.05 * BAR, high + 0.1 * BAR) if wild else (low, high)
    x = np.array([angle, (6.0 if wild else 2.0) * rng.normal(), *rng.uniform(*pressure, 2)])
    previous = x[2:] if rng.random() < 0.3 else rng.uniform(low, high, 2)
    to = rng.uniform(left, right) if wild else angle + 0.2 * rng.normal()
    reference = np.array(
        [np.clip(angle + 0.1 * rng.normal(), left, right), np.clip(to, left, right), rng.random(), 0.0]
    )
    reference[3] = rng.uniform(4.0, 12.0)
    swing = rng.choice([0.0, 0.1 * BAR, BAR]) * rng.normal(size=2)
    return Situation(
        x, previous, rng.uniform(low, high, 2), swing, reference, float(rng.choice([0.0, 2.0]) * rng.normal())
    )


def changed(rng: np.random.Generator, one: Situation) -> Situation:
    """Return a nearby situation."""
    share = 10.0 ** rng.uniform(-4, -1)
    near = (np.asarray(value) * (1 + share * rng.normal(size=np.shape(value))) for value in one)
    x, previous, begin, swing, reference, load = near
    reference[2] = min(max(reference[2], 0.0), 1.0)
    return Situation(x, previous, begin, swing, reference, float(load))


def arguments(mpc: TrackingMPC, s: Situation) -> tuple[Any, ...]:
    """Return the arguments of a QP step."""
    N, k = mpc.N, np.arange(mpc.N + 1)
    theta = np.where(k < s.reference[2] * N, s.reference[0], s.reference[1])
    d = np.full(N + 1, s.load)
    feed = mpc._feed_forward(theta, np.full(N + 1, s.reference[3]), d)
    u = s.begin + s.swing * np.sin(1.3 * k[:N, None])
    return s.x, u, d[:-1], feed, PreviousSample(s.previous, feed.u[0])


def controllers(N: int) -> list[TrackingMPC]:
    """Return the controllers of all settings."""
    plant = Plant()
    blocks = (1,) * (N - 2 * (N // 4)) + (2,) * (N // 4)
    settings: list[dict[str, Any]] = [{}, {"weights": Weights.calm()}, {"min_force": 30.0}, {"blocks": blocks}]
    return [TrackingMPC(plant, DT, N, **options) for options in settings]


def hunted(number: int, N: int, seed: int = 0) -> Iterator[Hunt]:
    """Search, and yield the results after each tenth."""
    rng, found, asked = np.random.default_rng(seed), Hunt(), controllers(N)
    for n in range(number):
        mpc = asked[n % len(asked)]
        again = found.worst and rng.random() < 0.25
        s = changed(rng, found.worst[rng.integers(len(found.worst))][1]) if again else random_situation(rng, mpc.plant)
        given, structured = arguments(mpc, s), mpc._qp_step.structured
        if rng.random() < 0.5:
            structured.reset()
        mpc._qp_step.linearise(*given)
        began = thread_time()
        proved = structured.solved()
        found.seconds.append(thread_time() - began)
        found.exchanges.append(structured.exchanges)
        found.worst = sorted([*found.worst, (structured.exchanges, s)], key=lambda one: -one[0])[:KEPT]
        if not proved or n % CHECKED == 0:
            compare(mpc, given, proved, found)
        if (n + 1) % max(number // 10, 1) == 0:
            yield found


def compare(mpc: TrackingMPC, given: tuple[Any, ...], proved: bool, found: Hunt) -> None:
    """Solve the same QP by DAQP."""
    structured = mpc._qp_step.structured
    qp = condense(mpc.problem, structured.model, given[3], *given[4])
    answer = certified(DAQP(primal_tol=1e-9), qp, inf, mpc.problem.curvature)  # 1e-6 would leave limits violated
    found.unproved += not proved
    found.unsolved += not proved and answer.status is not PlanStatus.OPTIMAL
    if proved and answer.status is PlanStatus.OPTIMAL:
        found.apart.append(float(np.abs(structured.z - answer.z[:-2]).max()))


def row(found: Hunt, N: int, seed: int) -> Row:
    """Return the results."""
    exchanges, micro = np.array(found.exchanges), 1e6 * np.array(found.seconds)
    quantiles = *np.quantile(exchanges, (0.5, 0.99, 1.0)), *np.quantile(micro, (0.5, 0.99, 0.9999, 1.0))
    return Row(N, seed, exchanges.size, *map(float, quantiles), found.unproved, found.unsolved, max(found.apart))


def said(r: Row) -> str:
    """Return the results in one line."""
    return (
        f"N = {r.horizon}, {r.number} QPs: exchanges {r.exchanges_median:.0f} median, {r.exchanges_99:.0f} 99 %, "
        f"{r.exchanges_most:.0f} at most (bound {2 * r.horizon * MOST}); time {r.time_median:.0f} µs median, "
        f"{r.time_99:.0f} µs 99 %, {r.time_9999:.0f} µs 99.99 %, {r.time_most:.0f} µs at most; without a proof of its "
        f"own {r.unproved}, of those without DAQP's {r.unsolved}; from DAQP at most {r.apart:.1e} bar"
    )


def keep(new: Row, folder: Path) -> None:
    """Add the results to the file, and write the report of all."""
    path, rows = folder / "worst_cases.csv", {}
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            old = [Row(*map(float, line)) for line in list(csv.reader(file))[1:]]  # type: ignore[arg-type]  # numbers
        rows = {(each.horizon, each.seed): each for each in old}
    rows[new.horizon, new.seed] = new
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Row._fields, *([f"{x:.6g}" for x in rows[key]] for key in sorted(rows))])
    (folder / "worst_cases.md").write_text("\n".join(report([*rows.values()])) + "\n", encoding="utf-8")


def report(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of the report: the greatest numbers of all seeds, medians of the rest."""
    yield "# Hunted QPs\n"
    yield "Written by `python -m benchmarks.speed.worst_cases --out benchmarks/results`, once per horizon and seed."
    yield "States, references and limits are random or adversarial: angles outside the joint range, slack cables,"
    yield "pressures outside the supply, jumps; every fourth QP varies one of the worst so far. Half of the QPs begin"
    yield "without the active limits of the last one. The figures of each seed are in `worst_cases.csv`.\n"
    heads = "N", "QPs", "seeds", "exchanges: median, 99 %", "at most", "bound", "without a proof", "nor DAQP's"
    heads += "from DAQP at most [bar]", "time [µs]: median, 99 %, 99.99 %", "at most"
    yield f"| {' | '.join(heads)} |\n|{'--:|' * len(heads)}"
    for N in sorted({r.horizon for r in rows}):
        yield line([r for r in rows if r.horizon == N])
    yield "\nThe bound is that of `mpc.solvers.Riccati`, `ANT_EXCHANGES` in C. A QP that reaches it is answered within"
    yield "slew and supply, with a bound of its suboptimality. Times are processor times of a busy machine:"
    yield "they count as ratios only, and the greatest one may be an interruption."


def line(rows: Sequence[Row]) -> str:
    """Return the line of one horizon."""
    median = Row(*np.median(rows, axis=0))
    most, total = Row(*np.max(rows, axis=0)), Row(*np.sum(rows, axis=0))
    seeds = f"{min(r.seed for r in rows):.0f} to {most.seed:.0f}" if len(rows) > 1 else f"{most.seed:.0f}"
    cells = (
        *(f"{most.horizon:.0f}", f"{total.number:.0f}", seeds),
        f"{median.exchanges_median:.0f}, {median.exchanges_99:.0f}",
        *(f"{most.exchanges_most:.0f}", f"{2 * most.horizon * MOST:.0f}"),
        *(f"{total.unproved:.0f}", f"{total.unsolved:.0f}", f"{most.apart:.1e}"),
        f"{median.time_median:.0f}, {median.time_99:.0f}, {median.time_9999:.0f}",
        f"{most.time_most:.0f}",
    )
    return f"| {' | '.join(cells)} |"


def main() -> int:
    """Search; fail if a QP has no proved solution."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.worst_cases", description="Hunt the worst QPs.")
    parser.add_argument("--number", type=int, default=100_000)
    parser.add_argument("--horizon", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="folder of worst_cases.csv and worst_cases.md")
    asked = parser.parse_args()
    found = Hunt()
    for found in hunted(asked.number, asked.horizon, asked.seed):
        print(said(row(found, asked.horizon, asked.seed)), flush=True)
    if asked.out:
        keep(row(found, asked.horizon, asked.seed), asked.out)
    return 1 if found.unsolved else 0


if __name__ == "__main__":
    raise SystemExit(main())
