"""Tracking by arms on MuJoCo: `python -m benchmarks.arm --help`."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from benchmarks.arm import nominal, rough, scaling
from benchmarks.arm.cases import ARMS, plant
from mpc.model.arm.model import Arm
from mpc.tracking.controller import TrackingMPC
from mpc.trials.motions.arm_trajectories import circle
from mpc.trials.simulation import in_motion, simulate

RESULTS = Path(__file__).parents[1] / "results"
NAME = "arm"


class Line(NamedTuple):
    """Line of the report: a measured figure, and its upper limit (None: only reported)."""

    arm: str
    what: str
    value: float
    allowed: float | None = None

    @property
    def failed(self) -> bool:
        """Whether the figure exceeds the limit, or is not a number."""
        return self.allowed is not None and not self.value <= self.allowed


def nominal_lines(name: str, turns: float, rests: int, rounds: int) -> list[Line]:
    """Yield figures on a plant equal to the model, and times of a step."""
    arm = Arm.machine(name)
    controller = TrackingMPC(arm)
    asked = circle(arm, turns=turns)
    found = nominal.tracking(simulate(plant(arm), controller, asked, x0=in_motion(arm, asked)))
    off, missed = nominal.pushed(arm, controller, rests)
    lines = [
        Line(name, "angle RMS [°]", found.angle, 0.03),
        Line(name, "angle, worst [°]", found.angle_worst),
        Line(name, "stiffness RMS [N·m/rad]", found.stiffness, 0.015),
        Line(name, f"stiffness by pushing at {rests} rests, less (M2) [N·m/rad]", off, 0.01),
        Line(name, "stiffness by pushing, less asked [N·m/rad]", missed, 0.01),
        Line(name, "limits broken", float(not found.limits_kept), 0.0),
        Line(name, "share of the steps not answered by the QP", 1 - found.on_qp, 0.0),
    ]
    return lines + [line for gas in (True, False) if rounds for line in time_lines(name, gas, min(turns, 1.0), rounds)]


def time_lines(name: str, gas: bool, turns: float, rounds: int) -> list[Line]:
    """Yield the times of a step on the circle; that of arm26 without gas has a requirement."""
    arm = replace(Arm.machine(name), gas=gas)
    clock, what = nominal.times(arm, TrackingMPC(arm), turns=turns, rounds=rounds), "" if gas else " without gas"
    asked = 300.0 if name == "arm26" and not gas else None
    return [
        Line(name, f"step{what}, median [µs]", clock.median, asked),
        Line(name, f"step{what}, 99 % [medians]", clock.p99 / clock.median, 3.0),
    ]


def gas_lines(name: str, turns: float) -> list[Line]:
    """Yield figures of the circle at 1 Hz on a plant with gas, known to the controller or not; without limits."""
    arm, lines = Arm.machine(name), []
    for what, known in (("known", arm), ("not known", replace(arm, gas=False))):
        asked = circle(arm, frequency=1.0, turns=turns)
        run = simulate(plant(arm), TrackingMPC(known), asked, x0=in_motion(known, asked))
        found = nominal.tracking(run)
        lines.append(Line(name, f"1 Hz, gas in the plant, {what}: angle RMS [°]", found.angle))
        lines.append(Line(name, f"1 Hz, gas in the plant, {what}: stiffness RMS [N·m/rad]", found.stiffness))
    return lines


def rival_lines(name: str, turns: float) -> list[Line]:
    """Yield figures of IPOPT on the same programmes, in the same run."""
    found = nominal.rival(Arm.machine(name), turns=turns)
    return [
        Line(name, "IPOPT's step, median [ms]", found.milliseconds),
        Line(name, "our time, of 1/30 of IPOPT's", 30 / found.ratio, 1.0),
        Line(name, "closed-loop cost above IPOPT's", found.cost, 0.005),
        Line(name, "commands apart from IPOPT's, at most [bar]", found.apart / 1e5),
        Line(name, "steps IPOPT did not solve", float(found.failures)),
    ]


def rough_lines(name: str, seeds: tuple[int, ...]) -> list[Line]:
    """Yield figures with muscles 5 % off, an unknown load, noise and dead time, the worst of the seeds."""
    arm, lines = Arm.machine(name), []
    for kind, build in (("MPC", rough.mpc), ("PID", rough.pid)):
        numbers = rough.TUNED.get((kind, name))
        if numbers is None:
            continue
        loop = build(arm, **numbers)
        found = [rough.figures(rough.runs(arm, loop, seed)) for seed in seeds]
        asked = kind == "MPC"
        lines += [
            Line(name, f"{kind}: angle RMS [°]", max(f.rms for f in found), 0.3 if asked else None),
            Line(name, f"{kind}: RMS in the second after the load [°]", max(f.found for f in found)),
            Line(name, f"{kind}: RMS of everything [°]", max(f.everything for f in found)),
            Line(name, f"{kind}: mean error at rest [°]", max(f.rest for f in found), 0.05 if asked else None),
            Line(name, f"{kind}: swing at rest, peak to peak [°]", max(f.swing for f in found)),
            Line(name, f"{kind}: rate of the commands at rest [bar/s]", max(f.rate for f in found)),
        ]
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.arm", description=__doc__.partition(":")[0])
    parser.add_argument("--arms", nargs="+", default=list(ARMS), choices=ARMS)
    parser.add_argument("--turns", type=float, default=4.0, help="of the circle")
    parser.add_argument("--rests", type=int, default=5, help="at which stiffness is measured by pushing")
    parser.add_argument("--rounds", type=int, default=5, help="of the times; 0 measures none")
    parser.add_argument("--ipopt", type=float, default=0.5, help="turns of the circle with IPOPT; 0: without")
    parser.add_argument("--gas", type=float, default=2.0, help="turns of the circle with gas in the plant; 0: without")
    parser.add_argument("--seeds", type=int, default=3, help="rough plants; 0: none")
    parser.add_argument("--growth", action="store_true", help="how the time grows (compiles five arms)")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report")
    given = parser.parse_args()
    lines: list[Line] = []
    for name in given.arms:
        for more in (
            lambda name=name: nominal_lines(name, given.turns, given.rests, given.rounds),
            lambda name=name: rival_lines(name, given.ipopt) if given.ipopt else [],
            lambda name=name: gas_lines(name, given.gas) if given.gas else [],
            lambda name=name: rough_lines(name, rough.JUDGED_ON[: given.seeds]) if given.seeds else [],
        ):
            lines += (found := more())
            for line in found:
                asked = "" if line.allowed is None else f" (at most {line.allowed:g})"
                print(
                    f"{'FAILED' if line.failed else 'ok':6} {line.arm}: {line.what} {line.value:.4g}{asked}", flush=True
                )
    growth = scaling.grown() if given.growth else []
    write(lines, growth, given.out)
    print(f"Written to {given.out / NAME}.md")
    return 1 if any(line.failed for line in lines) else 0


def write(lines: list[Line], growth: list[scaling.Grown], out: Path) -> None:
    """Write the report."""
    out.mkdir(parents=True, exist_ok=True)
    text = [
        "# Arms on MuJoCo: tracking errors and times",
        "",
        "Written by `python -m benchmarks.arm`. The circle is ±23°/±17° (arm48: ±23°, ±17°, ±15°, ±12°) at 0.5 Hz;",
        "K11 = 12 ± 1.5, K12 = 4.6, K22 = 9.5 N·m/rad (arm48: 6 ± 1.5, and 6 at the other joints). Errors are those of",
        "the worst joint or entry, after the first half second. Times are, sample by sample, the least of some rounds",
        "of one circle; IPOPT solves the same programme next to our step, in the same run. Plants and models have gas",
        "in the muscles unless a line says otherwise. The model of arm48, whose fastest motion is four times as fast,",
        "is integrated in four steps per sample, that of arm26 in one. On rough plants forces",
        "have errors of 5 %, an unmodelled 1 N·m after 2 s, encoders have steps of 0.02°, pressures noise of 0.02 bar,",
        "commands 20 ms of dead time: the RMS leaves out the first second and the one after the load; the worst of",
        "the seeds. MPC and PIDs were tuned by the same optimiser on another seed (`python -m benchmarks.arm.rough`).",
        "",
        "| arm | measured | | at most |",
        "|---|---|--:|--:|",
    ]
    for line in lines:
        asked = "" if line.allowed is None else f"{line.allowed:g}{' **missed**' if line.failed else ''}"
        text.append(f"| {line.arm} | {line.what} | {line.value:.3g} | {asked} |")
    if growth:
        text += ["", "| joints | muscles | N | decisions | median [µs] | 99 % [µs] |", "|--:|--:|--:|--:|--:|--:|"]
        text += [
            f"| {g.joints} | {g.muscles} | {g.horizon} | {g.decisions} | {g.times.median:.0f} | {g.times.p99:.0f} |"
            for g in growth
        ]
    (out / f"{NAME}.md").write_text("\n".join([*text, ""]), encoding="utf-8")


if __name__ == "__main__":
    raise SystemExit(main())
