"""Report of the robustness benchmark."""

import csv
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.robustness.campaign import KINDS
from benchmarks.robustness.storm import WELL, Compared, Part, broken
from benchmarks.robustness.wraps import LENGTHS, WRAPS, Wrong
from mpc import PlanStatus, Rung

NAME = "robustness"

_HEAD = """# Wrong readings

## Temporarily wrong encoder readings

The joint follows ±20° at 0.5 Hz; from t = 2 s on the encoder reads one of {n} values between {low} and {high} rad,
instead of the angle or added to it. The table has the greatest error [°] from 0.5 s after the beginning of the fault
on, over all of these values, and the greatest error there without a fault.

| muscles | controller | without | {lengths} |
|---|---|---|{dashes}|
"""

_STORM = """
## A storm

{samples} samples on the standard real plant, in parts with separate seeds; {hits} faults of 1 to 30 samples of
these kinds: {kinds}.

* angle error: median {median:.3g}°, 99 % {most:.3g}°, worst {worst:.3g}°; above 5° in {above:.2%} of the samples
* {recovered} of {judged} faults with enough time were over within 3 s of their end (error below {well:g}° for 0.1 s):
  median {fast:.3g} s, 99 % {slow:.3g} s, worst {slowest:.3g} s
* broken limits, nonfinite numbers, false successes: {broken}
* steps answered by {rungs}; statuses {statuses}; observer restarts: {rebuilt}
"""

_C = """* the exported C under the address and undefined-behaviour sanitizers, on {samples} such samples:
  {differing} differ in status, rung or a verdict on a reading; the commands by at most {away:.1e} Pa
"""


def write(wrongs: Sequence[Wrong], parts: Sequence[Part], pairs: Sequence[Compared], out: Path) -> None:
    """Write the report and its rows."""
    out.mkdir(parents=True, exist_ok=True)
    (out / f"{NAME}.md").write_text(_wraps(wrongs) + _storm(parts) + _compared(pairs), encoding="utf-8")
    with (out / f"{NAME}.csv").open("w", newline="", encoding="utf-8") as file:
        rows = csv.writer(file)
        rows.writerow(Wrong._fields)
        rows.writerows(wrongs)


def _wraps(wrongs: Sequence[Wrong]) -> str:
    lengths = " | ".join(f"{n} sample{'s' * (n > 1)}" for n in LENGTHS)
    text = _HEAD.format(n=len(WRAPS), low=WRAPS[0], high=WRAPS[-1], lengths=lengths, dashes="|".join(["---"] * 3))
    for law, controller in dict.fromkeys((w.law, w.controller) for w in wrongs):
        own = [w for w in wrongs if (w.law, w.controller) == (law, controller)]
        worst = [max(w.error for w in own if w.samples == n) for n in LENGTHS]
        text += f"| {law} | {controller} | {own[0].usual:.2f} | {' | '.join(f'{e:.2f}' for e in worst)} |\n"
    return text


def _storm(parts: Sequence[Part]) -> str:
    error = np.concatenate([part.error for part in parts])
    judged = [recovery for part in parts for recovery in part.recoveries]
    seconds = np.array([recovery.seconds for recovery in judged])
    rung, status = (np.concatenate([getattr(part.run, name) for part in parts]) for name in ("rung", "status"))
    return _STORM.format(
        samples=len(rung),
        hits=len(judged),
        kinds=", ".join(KINDS),
        median=np.median(error),
        most=np.percentile(error, 99),
        worst=error.max(),
        above=np.mean(error > 5),
        recovered=int(np.isfinite(seconds).sum()),
        judged=len(judged),
        well=WELL,
        fast=np.median(seconds),
        slow=np.percentile(seconds, 99, method="lower"),
        slowest=seconds.max(),
        broken=", ".join(sorted({name for part in parts for name in broken(part.run)})) or "none",
        rungs=", ".join(f"{Rung(r).name} {n}" for r, n in zip(*np.unique(rung, return_counts=True), strict=True)),
        statuses=", ".join(
            f"{PlanStatus(s).name} {n}" for s, n in zip(*np.unique(status, return_counts=True), strict=True)
        ),
        rebuilt=sum(part.rebuilt for part in parts),
    )


def _compared(pairs: Sequence[Compared]) -> str:
    if not pairs:
        return ""
    samples, differing = sum(pair.samples for pair in pairs), sum(pair.differing for pair in pairs)
    return _C.format(samples=samples, differing=differing, away=max(pair.away for pair in pairs))
