"""Report: detection rates, delays, names, and false alarms."""

import csv
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import benchmarks.faults as about
from benchmarks.faults.cases import FAULTS, MOVED
from benchmarks.faults.runs import NAMED_AFTER, Row

VERDICTS = ("right", "group", "wrong")


def save(rows: list[Row], path: Path) -> None:
    """Write one line per run."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow([*rows[0].job._fields, *Row._fields[1:]])
        for job, *found in rows:
            writer.writerow([*job, *(f"{v:.6g}" if isinstance(v, float) else v for v in found)])


def markdown(rows: list[Row], planned: int) -> Iterator[str]:
    """Yield the lines of the report on `rows`, of `planned` runs."""
    assert about.__doc__ is not None
    title, _, rest = about.__doc__.partition("\n\n")
    yield "# " + title.removesuffix(".") + "\n"
    yield rest.replace("`AFTERWARDS` seconds", "5 s").rstrip() + "\n"
    if len(rows) < planned:
        yield f"{len(rows)} of {planned} runs were made, chosen at random.\n"
    yield from _detection([row for row in rows if row.job.fault])
    yield from _false_alarms(rows)
    yield from _names([row for row in rows if row.job.fault])


def _detection(rows: list[Row]) -> Iterator[str]:
    yield "## Detection\n"
    yield "Delays in s: median / 99 % / worst. Names: right / one of a group / wrong, shares of the detected in %.\n"
    heads = "fault", "runs", "detected", "delay from the onset", "from its first effect", "at the alarm"
    yield "| " + " | ".join(heads) + f" | {NAMED_AFTER:g} s later |"
    yield "|---" * 7 + "|"
    there = {row.job.fault for row in rows}
    for fault in (*(name for name in FAULTS if name in there), ""):
        own = [row for row in rows if row.job.fault == fault or not fault]
        seen = [row for row in own if row.at_once]
        cells = [fault or "all", str(len(own)), f"{100 * len(seen) / len(own):.1f} %"]
        cells += [_delays([getattr(row, name) for row in seen]) for name in ("delay", "late")]
        cells += [_shares([getattr(row, name) for row in seen]) for name in ("at_once", "after_all")]
        yield "| " + " | ".join(cells) + " |"
    yield ""
    for trajectory in MOVED:
        own = [row for row in rows if row.job.trajectory == trajectory]
        missed = [f"{r.job.fault} from {r.job.onset:g} s on ({r.job.plant})" for r in own if not r.at_once]
        yield f"* Not detected in {trajectory}: {_counted(missed) or 'nothing'}."
    yield ""


def _delays(values: list[float]) -> str:
    if not values:
        return ""
    return " / ".join(f"{v:.2f}" for v in (np.median(values), np.percentile(values, 99), np.max(values)))


def _shares(verdicts: list[str]) -> str:
    if not verdicts:
        return ""
    return " / ".join(f"{100 * np.mean([v == verdict for v in verdicts]):.0f}" for verdict in VERDICTS)


def _counted(names: list[str]) -> str:
    return "; ".join(f"{names.count(name)} × {name}" for name in dict.fromkeys(names))


def _false_alarms(rows: list[Row]) -> Iterator[str]:
    yield "## False alarms\n"
    sound = [row for row in rows if not row.job.fault]
    hours = sum(row.seconds for row in sound) / 3600
    alarms = sum(row.false_alarms for row in sound)
    yield f"{alarms} in {hours:.2f} h of motion without a fault: {_rate(alarms, hours)}.\n"
    yield "| plant | hours | false alarms | first of them |"
    yield "|---" * 4 + "|"
    for plant in dict.fromkeys(row.job.plant for row in sound):
        own = [row for row in sound if row.job.plant == plant]
        first = next((f"{r.job.trajectory}, {r.job.load:g} N·m: {r.first_false}" for r in own if r.false_alarms), "")
        yield f"| {plant} | {sum(r.seconds for r in own) / 3600:.2f} | {sum(r.false_alarms for r in own)} | {first} |"
    faulty = [row for row in rows if row.job.fault]
    early = sum(row.false_alarms for row in faulty)
    yield f"\nBefore the onset in the runs with a fault: {early} in {sum(r.seconds for r in faulty) / 3600:.2f} h.\n"


def _rate(alarms: int, hours: float) -> str:
    """Return the rate per hour, and its upper bound if alarms are a Poisson process."""
    from scipy.stats import chi2

    return (
        f"{alarms / hours:.2f} per hour, with 95 % confidence at most {chi2.ppf(0.95, 2 * alarms + 2) / 2 / hours:.2f}"
    )


def _names(rows: list[Row]) -> Iterator[str]:
    yield "## Findings\n"
    yield f"{NAMED_AFTER:g} s after the alarm, without the time, with the number of runs.\n"
    for fault in FAULTS:
        said = [row.said.split(":")[0] for row in rows if row.job.fault == fault and row.at_once]
        plain = ["; ".join(part.partition(" since")[0] for part in sentence.split("; ")) for sentence in said]
        ordered = sorted(dict.fromkeys(plain), key=plain.count, reverse=True)
        yield f"* {fault}: " + (", ".join(f"{name} ({plain.count(name)})" for name in ordered) or "nothing") + "."
    yield ""
