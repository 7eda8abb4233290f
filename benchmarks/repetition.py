"""Motions learned by repetition on simulated joints of other structures.

    python -m benchmarks.repetition [--seeds 1] [--structures braid,tips,power,exponential]
    python -m benchmarks.repetition --off 200

The joints are those of `benchmarks.strangers`, which the library does not model. The MPC has the data-sheet model and
the usual robust weights, and knows the age of the encoder's readings. Each motion is repeated 10 times, or until
learning ends; all repetitions begin in one state, each with its own noise. Learning sees the encoder; the figures are
RMS errors of the true angle after the first rest. *Predicted* is the ratio of the second error to the first that the
design computes for the worst of its linear plants, *seen* that of the measured errors.

Reference and best correction are each played five times more, with other noise. The standard deviation between these
runs, RMS over time, *does not return*: no learning gets below it. The RMS error of their mean *returns* (less the share
of that standard deviation in it); it is all that can be learned. A repetition *rose* if its error exceeds that of the
one before by more than noise: 3 % and the encoder's RMS error, or 2√2 times the standard deviation of the RMS errors of
the runs with the best correction if that is more.

Corrections at another speed are those of the min-jerk motion in 1 s, scaled in time. `Correction.along` refuses the
marked ones.
"""

import argparse
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import DEG
from benchmarks.strangers.identified import data_sheet
from benchmarks.strangers.physics import Parts
from benchmarks.strangers.plants import REPORTING, STRUCTURES, Stranger, drawn
from benchmarks.strangers.runs import DT, K
from mpc import Reference, Run, simulate
from mpc.repetition.learner import Learner, Reason
from mpc.repetition.practice import Practice, played, practise
from mpc.repetition.response import Response, responses
from mpc.trials.loops import Settings, loop, robust
from mpc.trials.metrics import metrics
from mpc.trials.motions.corrections import SPEEDS as SCALED
from mpc.trials.motions.corrections import Correction, Owner
from mpc.trials.motions.trajectories import chirp, point_to_point, rested_sine

REPETITIONS, WRONG = 10, 5  # of the motions, of the runs with wrong models
PLAYED = 5  # runs of one reference, to separate errors that return
OFF = 1.3
DRAWS = 2  # beside three postures of the model
SPEEDS = (0.5, 0.8, 1.25, 2.0)
MOTIONS = {
    "sine": rested_sine(K),
    "min-jerk": point_to_point(K),
    "chirp": chirp(K),
    "60° in 0.4 s": point_to_point(K, time=0.4),
}


@dataclass(frozen=True)
class Unwatched(Stranger):
    """Stranger without stiffness and forces along a run, which take three quarters of its time."""

    @classmethod
    def of(cls, s: Stranger, parts: Parts) -> "Unwatched":
        """Return the stranger with these parts."""
        return cls(s.structure, s.seed, parts, s.sensors, s.delay, s.jitter, s.nominal, s.told)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return ones."""
        return np.ones(len(x)), np.ones((len(x), 2))


class Ready(NamedTuple):
    """Stranger with its loop, and the possible responses of the loop."""

    stranger: Stranger
    settings: Settings
    responses: tuple[Response, ...]

    @classmethod
    def of(cls, structure: str, seed: int) -> "Ready":
        """Return the stranger of this structure and seed."""
        stranger = drawn(structure, seed)
        model, late = data_sheet(stranger), stranger.sensors.late * DT
        told = replace(model.told, reading_age=late)
        settings = robust("mpc", Settings(model.plant, DT, compensation=told), MOTIONS["sine"])
        return cls(stranger, settings, responses("mpc", settings, MOTIONS["sine"], n_draws=DRAWS))

    def learned(self, motion: Reference, repetitions: int, parts: Parts | None = None, draw: int = 0) -> Practice:
        """Learn a motion on the stranger, or on one with other `parts`; `draw` seeds the noise."""
        plant = Unwatched.of(self.stranger, parts or self.stranger.parts)
        controller, observer = loop("mpc", self.settings)
        x0 = self.settings.plant.at_rest(motion.theta[0], motion.K[0])
        learner = Learner(motion, self.responses, DT, repetitions, angle_limits=self.settings.plant.angle_limits)
        seed = 100 * self.stranger.seed + 1000 * draw
        return practise(plant, controller, learner, observer=observer, x0=x0, seed=seed)

    def again(self, learner: Learner, given: Reference) -> "Again":
        """Play a reference several times."""
        plant = Unwatched.of(self.stranger, self.stranger.parts)
        controller, observer = loop("mpc", self.settings)
        wanted, begin, count = learner.course.wanted, learner.course.begin, learner.course.count
        x0 = self.settings.plant.at_rest(wanted.theta[0], wanted.K[0])
        reads = [
            played(plant, controller, given, learner, observer=observer, x0=x0, seed=seed)[1]
            for seed in range(9000, 9000 + PLAYED)
        ]
        errors = (wanted.theta[:count] - np.array(reads))[:, begin:]
        variance = float(errors.var(axis=0, ddof=1).mean())
        returns = max(float((errors.mean(axis=0) ** 2).mean()) - variance / PLAYED, 0.0)
        return Again(returns**0.5, variance**0.5, float(np.sqrt((errors**2).mean(axis=1)).std(ddof=1)))


class Again(NamedTuple):
    """Measured errors of several runs along one reference [rad]."""

    returns: float  # RMS of their mean
    apart: float  # RMS between them
    std: float  # of their RMS errors


def error(run: Run, begin: int) -> float:
    """Return the RMS error of the true angle after the first rest [°]."""
    return float(np.sqrt(np.mean((run.theta - run.theta_ref)[begin:] ** 2)) / DEG)


def stiffness_error(stranger: Stranger, run: Run, begin: int) -> float:
    """Return the RMS error of the true stiffness after the first rest [N·m/rad]."""
    K, _ = stranger.along(run.x[begin:])
    return float(np.sqrt(np.mean((K - run.K_ref[begin:]) ** 2)))


class Row(NamedTuple):
    """One motion that was learned."""

    structure: str
    seed: int
    motion: str
    first: float  # [°]
    best: float  # [°]
    K_first: float  # [N·m/rad]
    K_best: float
    predicted: float  # e_2/e_1 at most
    seen: float
    rises: int  # repetitions before the best whose error grew by more than noise
    done: int
    reason: str
    broken: bool  # a limit of commands or of the joint range
    apart: float  # RMS error that does not return [°]
    returned: float  # RMS error that returns, without a correction [°]
    returns: float  # with the best one [°]

    @classmethod
    def of(cls, ready: Ready, motion: str) -> "Row":
        """Learn a motion and return its figures."""
        practice = ready.learned(MOTIONS[motion], REPETITIONS)
        learner, begin = practice.learner, practice.learner.course.begin
        rms = np.array([one.rms for one in learner.history])
        until = int(rms.argmin()) + 1
        before, after = (ready.again(learner, given) for given in (learner.course.wanted, learner.reference))
        noise = np.maximum(0.03 * rms[:-1] + ready.stranger.sensors.step / 12**0.5, 2 * 2**0.5 * after.std)
        limits = ("commanded pressure", "pressure slew", "joint range")
        runs = practice.first, practice.best
        kept = (not metrics(run).violations[name][0] for run in runs for name in limits)
        return cls(
            ready.stranger.structure, ready.stranger.seed, motion, error(practice.first, begin),
            error(practice.best, begin), *(stiffness_error(ready.stranger, run, begin) for run in runs),
            learner.update.predicted[1] if learner.update else np.nan, rms[1] / rms[0],
            int((np.diff(rms) > noise)[: until - 1].sum()), len(rms), learner.reason.name, not all(kept),
            after.apart / DEG, before.returns / DEG, after.returns / DEG,
        )  # fmt: skip


def wrong(ready: Ready, draw: int) -> tuple[float, float, float, str]:
    """Return first, best and last error as read [°] of a joint 30 % off, and why learning ended."""
    rng = np.random.default_rng([draw, 37])
    p = ready.stranger.parts
    inertia, force, lag = OFF ** rng.choice([-1, 1], 3)
    parts = p._replace(inertia=p.inertia * inertia, strength=p.strength * force, up=p.up * lag, down=p.down * lag)
    learner = ready.learned(MOTIONS["min-jerk"], WRONG, parts, draw).learner
    return learner.history[0].rms / DEG, learner.best.rms / DEG, learner.history[-1].rms / DEG, learner.reason.name


def faster(ready: Ready) -> list[tuple[float, float, float]]:
    """Return for each speed the errors without and with the correction learned at speed 1 [°]."""
    learner = ready.learned(MOTIONS["min-jerk"], 6).learner
    correction = Correction(learner.course.wanted, learner.best.correction, Owner("", ""))
    controller, observer = loop("mpc", ready.settings)
    plant, rows = Unwatched.of(ready.stranger, ready.stranger.parts), []
    for speed in SPEEDS:
        own = MOTIONS["min-jerk"]
        moved = np.maximum(own.t - 4.0, 0) / speed
        other = Reference(np.minimum(own.t, 4.0) + moved, own.theta, own.K).resampled(DT)
        x0 = ready.settings.plant.at_rest(other.theta[0], other.K[0])
        scaled = correction.along(other, speeds=(0.0, np.inf))
        runs = (
            simulate(plant, controller, given, x0=x0, observer=observer, seed=7) for given in (other, scaled.reference)
        )
        found = [replace(run, theta_ref=other.theta[: run.t.size]) for run in runs]
        rows.append((speed, *(error(run, round(4.0 / DT)) for run in found)))
    return rows


def table(rows: list[Row]) -> list[str]:
    """Return the figures by motion and by structure, as lines of Markdown."""
    lines = [
        "| | RMS error [°], first → best | divided by: median, least | does not return [°] | returns [°], first → "
        "best | divided by: median, least | e₂/e₁ predicted, seen | repetitions that rose | K error, first → best "
        "[N·m/rad] | limits broken |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    groups = [(m, [r for r in rows if r.motion == m]) for m in MOTIONS]
    groups += [(s, [r for r in rows if r.structure == s]) for s in STRUCTURES] + [("all", rows)]
    for name, mine in groups:
        if not mine:
            continue
        ratio = np.array([r.first / r.best for r in mine])
        part = np.array([r.returned / max(r.returns, 1e-3) for r in mine])
        names = ("first", "best", "K_first", "K_best", "predicted", "seen", "apart", "returned", "returns")
        first, best, K1, K2, said, seen, apart, e1, e2 = (np.median([getattr(r, n) for r in mine]) for n in names)
        rises = f"{sum(r.rises for r in mine)} of {sum(r.done - 1 for r in mine)}"
        lines.append(
            f"| {name} | {first:.2f} → {best:.3f} | {np.median(ratio):.1f}, {ratio.min():.1f} | {apart:.3f} | "
            f"{e1:.2f} → {e2:.3f} | {np.median(part):.1f}, {part.min():.1f} | {said:.2f}, {seen:.2f} | {rises} | "
            f"{K1:.3f} → {K2:.3f} | {sum(r.broken for r in mine)} of {len(mine)} |"
        )
    return lines


def floors(rows: list[Row], steps: dict[str, float]) -> list[str]:
    """Return the errors that remain against those of the encoders, as lines of Markdown."""
    lines = ["| structure | step of the encoder [°] | its RMS error [°] | best true RMS error: median, least [°] |"]
    lines.append("|---|---|---|---|")
    for structure, step in steps.items():
        best = [r.best for r in rows if r.structure == structure]
        lines.append(f"| {structure} | {step:g} | {step / 12**0.5:.3f} | {np.median(best):.3f}, {min(best):.3f} |")
    return lines


def main() -> None:
    """Run the benchmark and write the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1, help="strangers per structure")
    parser.add_argument("--first", type=int, default=REPORTING, help="the first seed; from 1000 on they are for tuning")
    parser.add_argument("--structures", default=",".join(STRUCTURES))
    parser.add_argument("--off", type=int, default=0, help="runs with models 30 %% off, instead")
    parser.add_argument("--out", type=Path, help="file to write; else in benchmarks/results")
    asked = parser.parse_args()
    out = asked.out or Path(__file__).parent / "results" / ("repetition_off.md" if asked.off else "repetition.md")
    strangers = list(product(range(asked.first, asked.first + asked.seeds), asked.structures.split(",")))
    if asked.off:
        known, off = [Ready.of(structure, seed) for seed, structure in strangers], []
        for i in range(asked.off):
            off.append(wrong(known[i % len(known)], i))
            out.write_text(off_report(off, len(known)), encoding="utf-8")  # as far as it is
    else:
        learned(strangers, out)
    print(out.read_text(encoding="utf-8"))


def learned(strangers: Iterable[tuple[int, str]], out: Path) -> None:
    """Learn all motions on the strangers (seed, structure), and write the report."""
    rows: list[Row] = []
    speeds: list[tuple[float, float, float]] = []
    steps: dict[str, float] = {}
    for seed, structure in strangers:
        ready = Ready.of(structure, seed)
        steps[structure] = ready.stranger.sensors.step / DEG
        rows += [Row.of(ready, motion) for motion in MOTIONS]
        speeds += faster(ready)
        out.write_text(report(rows, speeds, steps), encoding="utf-8")  # as far as it is


def off_report(off: list[tuple[float, float, float, str]], strangers: int) -> str:
    """Return the report on models that are 30 % off."""
    first, best, last = (np.array([o[i] for o in off]) for i in range(3))
    grew = sum(o[3] == Reason.GREW.name for o in off)
    lines = ["# Motions that are learned with models 30 % off", ""]
    lines += [
        f"Runs: {len(off)}, of the min-jerk motion; strangers: {strangers}; at most {WRONG} repetitions. Inertia, "
        "force and lags of the joint are 30 % off, each up or down, with noise of its own in each run; controller and "
        "update stay those of the model. "
        "Errors as read, RMS after the first rest, by `python -m benchmarks.repetition --off N`.",
        "",
        "| median error, first → best | divided by: median, least | last worse than first | stopped as it grew | worst "
        "last error |",
        "|---|---|---|---|---|",
        f"| {np.median(first):.2f}° → {np.median(best):.3f}° | {np.median(first / best):.1f}, "
        f"{(first / best).min():.1f} | {(last > first).sum()} of {len(off)} | {grew} of {len(off)} | "
        f"{last.max():.2f}° |",
    ]
    return "\n".join(lines) + "\n"


def report(rows: list[Row], speeds: list[tuple[float, float, float]], steps: dict[str, float]) -> str:
    """Return the whole report."""
    lines = ["# Motions that are learned by repeating them", "", (__doc__ or "").split("\n\n", 2)[2].strip(), ""]
    lines += [f"Strangers: {len({(r.structure, r.seed) for r in rows})}.", "", "## Learning", "", *table(rows), ""]
    calm = sum(not r.rises for r in rows)
    ends = ", ".join(f"{name} {sum(r.reason == name for r in rows)}" for name in Reason.__members__)
    lines += [f"Monotone to within noise until the best repetition: {calm} of {len(rows)} runs. Ends: {ends}.", ""]
    lines += ["## The sensor's floor", "", *floors(rows, steps), ""]
    lines += ["## Another speed", "", "| speed | uncorrected [°] | corrected [°] | better in |", "|---|---|---|---|"]
    for speed in SPEEDS:
        mine = np.array([s[1:] for s in speeds if s[0] == speed])
        if mine.size:
            before, after = np.median(mine, axis=0)
            name = f"{speed:g}" + ("" if SCALED[0] <= speed <= SCALED[1] else ", refused")
            better = f"{(mine[:, 1] < mine[:, 0]).sum()} of {len(mine)}"
            lines.append(f"| {name} | {before:.2f} | {after:.2f} | {better} |")
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
