"""Runs of the campaign: Python's loop in a storm of wrong readings, and the exported C on the same readings."""

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.robustness.campaign import DT, Hit, loop, reference, storms
from mpc import RealPlant, Rung, simulate
from mpc.export import export
from mpc.trials.simulation import Run
from tests.rigs import toolchain as tools
from tests.rigs.replay import CONTROL, CONTROL_COLUMNS, record, replayed

WELL = 2.0  # [°] of error: recovered when below it for CALM
CALM, LATEST = 0.1, 3.0  # [s]
_SAID = [CONTROL_COLUMNS.index(name) for name in ("status", "rung", "verdict_theta", "verdict_P1", "verdict_P2")]
SANITISED = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover")


class Recovery(NamedTuple):
    """Effect of a fault."""

    hit: Hit
    worst: float  # [°] until it was over for half a second
    seconds: float  # from its end until the error stays below WELL; inf: not within LATEST, or before the next fault


class Part(NamedTuple):
    """Part of the campaign."""

    run: Run
    recoveries: list[Recovery]
    rebuilt: int  # number of restarts of the observer

    @property
    def error(self) -> np.ndarray:
        """Return |θ - θ*| [°]."""
        return np.abs(self.run.theta - self.run.theta_ref) / DEG


def driven(samples: int, parts: int, seed: int) -> Iterator[Part]:
    """Return the part driven by Python."""
    controller, observer = loop(RealPlant.standard())
    followed = reference(samples // parts)
    for plant, own in storms(samples, parts, seed):
        run = simulate(plant, controller, followed, observer=observer, seed=own)
        yield Part(run, recoveries(run, plant.hits), observer.rebuilt)


def recoveries(run: Run, hits: tuple[Hit, ...]) -> list[Recovery]:
    """Return the recoveries from faults, except those followed too soon by another."""
    error, found, calm = np.abs(run.theta - run.theta_ref) / DEG, [], round(CALM / DT)
    ends = [*(hit.begin for hit in hits[1:]), len(error)]
    for hit, end in zip(hits, ends, strict=True):
        after = error[hit.end : min(end, hit.end + round(LATEST / DT))]
        well = np.convolve(after <= WELL, np.ones(calm), "valid") >= calm if len(after) >= calm else np.zeros(1, bool)
        if well.any():
            found.append(Recovery(hit, float(error[hit.begin : hit.end + 50].max()), DT * int(well.argmax())))
        elif end - hit.end >= round(LATEST / DT):
            found.append(Recovery(hit, float(error[hit.begin : hit.end + 50].max()), np.inf))
    return found


class Compared(NamedTuple):
    """Comparison of Python's answers with those of the exported C."""

    samples: int
    differing: int  # in status, rung or one of the verdicts
    away: float  # [Pa] greatest distance of the commands


def compared(samples: int, parts: int, seed: int) -> Iterator[Compared]:
    """Run Python and C, with the address and undefined-behaviour sanitizers."""
    controller, observer = loop(RealPlant.standard())
    followed = reference(samples // parts)
    with TemporaryDirectory() as directory:
        out = export(Path(directory) / "c", controller=controller, observer=observer)
        program = tools.compiled(out, CONTROL, "storm", *SANITISED)
        for plant, own in storms(samples, parts, seed):
            done = record(plant, controller, observer, followed, seed=own)
            got, wanted = replayed(program, done.samples), done.answers
            differing = (got[:, _SAID] != wanted[:, _SAID]).any(axis=1)
            yield Compared(len(wanted), int(differing.sum()), float(np.abs(got[:, :2] - wanted[:, :2]).max()))


def broken(run: Run) -> list[str]:
    """Return the hard limits broken by commands, and the names of nonfinite values."""
    low, high = run.plant.joint.pressure_limits
    change = np.abs(np.diff(run.u, axis=0))
    return [
        name
        for name, wrong in {
            "not finite": not (np.isfinite(run.u).all() and np.isfinite(run.x).all()),
            "supply": bool(((run.u < low) | (run.u > high)).any()),
            "slew": bool((change > run.plant.slew * run.dt * (1 + 1e-9)).any()),
            "called optimal": bool((run.rung[run.status == 0] != Rung.QP).any()),
        }.items()
        if wrong
    ]
