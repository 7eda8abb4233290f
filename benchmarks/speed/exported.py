"""Exported C against Python: time of a step and of an allocation, worst case, code and memory on a Cortex-M4F.

    python -m benchmarks.speed.exported [--steps 1000] [--horizon 10 --horizon 20] [--out benchmarks/results]

The test set is a closed loop on the benchmark's real plant with faults; C must give Python's commands on it before
anything is timed. Needs gcc; without arm-none-eabi-gcc and qemu-system-arm their figures are missing, and the report
notes it.
"""

import argparse
import csv
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from allocator import allocate
from allocator.calculus import Array
from allocator.units import BAR
from benchmarks.allocators.machine import machine
from mpc import KalmanObserver, RealPlant, TrackingMPC, Weights, sine
from mpc.export import export
from mpc.model.faults import FrozenSensors, SilentSensors, StuckValve, SupplyDrop
from tests.rigs import toolchain as tools
from tests.rigs.replay import CONTROL, Record, record, replayed

RESULTS = Path(__file__).parents[1] / "results"
_TIMES = Path(__file__).with_name("exported_times.c")
_HORIZONS, _PRECISIONS = (10, 20), ("double", "single")
_AGREE = {"double": 1e-8, "single": 1e-3}  # of the supply
_ON_M4F = 100  # steps


class Row(NamedTuple):
    """One horizon and precision; times in s, sizes in bytes, NaN or 0: not measured."""

    horizon: int
    precision: str
    python_step: float  # median
    c_step: float
    c_step_worst: float
    python_allocation: float
    c_allocation: float
    qp_exchanges_worst: int
    m4f_instructions: float  # of a step, median
    m4f_instructions_worst: float
    m4f_code: int
    m4f_memory: int
    m4f_allocator_code: int


class Disagreement(Exception):
    """C and Python gave different commands."""


def loop(horizon: int, steps: int) -> tuple[TrackingMPC, KalmanObserver, Record]:
    faults = SilentSensors(1.0, 1.4, (0,)), FrozenSensors(2.0, 2.4, (2,)), StuckValve(4.0, 4.5, 1), SupplyDrop(6.0, 6.3)
    process = replace(RealPlant.standard(torque_profile=((3.0, 1.0),)), faults=faults)
    known = process.known()
    controller = TrackingMPC(process.nominal, N=horizon, compensation=known, weights=Weights.calm())
    observer = KalmanObserver(process.nominal, controller.dt, compensation=known)
    reference = sine(K=5.5, duration=controller.dt * steps, ramp=1.0)
    return controller, observer, record(process, controller, observer, reference)


def measure(steps: int, horizons: Sequence[int]) -> Iterator[Row]:
    """Yield a row for every horizon and precision."""
    for horizon in horizons:
        controller, observer, done = loop(horizon, steps)
        for precision in _PRECISIONS:
            with TemporaryDirectory() as folder:
                made = export(Path(folder) / "c", controller=controller, observer=observer, precision=precision)
                _check(made, done, precision)
                times = _times(tools.compiled(made, _TIMES, "times"), done.samples)
                m4f = _m4f(made, done.samples)
                joint = controller.plant.joint
                yield Row(
                    horizon,
                    precision,
                    float(np.median(done.seconds)),
                    *(float(f(times[:, 0])) for f in (np.median, np.max)),
                    _median_time(lambda: allocate(0.3, 5.5, 0.05, joint=joint)),  # noqa: B023  # called at once
                    float(np.median(times[:, 1])),
                    int(times[:, 2].max()),
                    *m4f,
                )


def _check(made: Path, done: Record, precision: str) -> None:
    got = replayed(tools.compiled(made, CONTROL, "replay"), done.samples)
    if not (error := np.abs(got - done.answers)[:, :2].max() / (5 * BAR)) < _AGREE[precision]:
        raise Disagreement(f"C in {precision} precision is off by {error:.1e} of the supply")


def _times(program: Path, samples: Array, runner: tools.Runner = tools.run) -> Array:
    return replayed(program, samples, ("step", "allocation", "exchanges"), runner)


def _m4f(made: Path, samples: Array) -> tuple[float, float, int, int, int]:
    """Return instructions of a step (median, worst), code, memory, code of the allocator alone."""
    if not shutil.which(tools.ARM_GCC):
        return np.nan, np.nan, 0, 0, 0
    sizes, whole = tools.sizes(made), tools.linked_size(made)
    alone = sum(sizes[name].code for name in ("allocate.c", "exact.c", "kernel.c"))
    if not shutil.which(tools.QEMU):
        return np.nan, np.nan, *whole, alone
    program = tools.compiled_for_cortex_m4f(made, _TIMES, "times.elf")
    counted = _times(program, samples[:_ON_M4F], partial(tools.run_on_cortex_m4f, options=("-icount", "shift=0")))
    return float(np.median(counted[:, 0])), float(counted[:, 0].max()), *whole, alone


def _median_time(work, rounds: int = 7, repeats: int = 50) -> float:
    def once() -> float:
        began = time.process_time()
        for _ in range(repeats):
            work()
        return (time.process_time() - began) / repeats

    work()
    return float(np.median([once() for _ in range(rounds)]))


def report(rows: Sequence[Row], steps: int) -> str:
    lines = [
        "# Exported C against Python\n",
        "Written by `python -m benchmarks.speed.exported`; the figures are also in `exported.csv`.\n",
        f"A closed loop of {steps} samples on the real plant with faults and an observer; C gave Python's commands to",
        f"{_AGREE['double']:g} (double) and {_AGREE['single']:g} (single) of the supply before anything was timed.",
        "Processor time of this machine; a step includes observer, feed-forward and QP.\n",
        "| N | precision | Python step | C step | worst | times faster | Python `allocate` | C | most QP exchanges |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.horizon} | {r.precision} | {r.python_step * 1e3:.2f} ms | {r.c_step * 1e6:.0f} µs "
        f"| {r.c_step_worst * 1e6:.0f} µs | {r.python_step / r.c_step:.0f} | {r.python_allocation * 1e6:.0f} µs "
        f"| {r.c_allocation * 1e9:.0f} ns | {r.qp_exchanges_worst} |"
        for r in rows
    ]
    lines += [
        "\nOn a Cortex-M4F (`arm-none-eabi-gcc -Os`, FPU for single precision); all with newlib-nano; memory",
        f"with reference and plan; instructions as QEMU's mps2-an386 counts them over {_ON_M4F} steps:\n",
        "| N | precision | instructions a step | worst | code, whole | static memory | code of the allocator |",
        "|--:|---|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.horizon} | {r.precision} | {_million(r.m4f_instructions)} | {_million(r.m4f_instructions_worst)} "
        f"| {_kib(r.m4f_code)} | {_kib(r.m4f_memory)} | {_kib(r.m4f_allocator_code)} |"
        for r in rows
    ]
    lines += ["\n## Limitations\n", *(f"* {sentence}" for sentence in LIMITATIONS), f"\n{machine()}."]
    return "\n".join(lines) + "\n"


LIMITATIONS = (
    "Times are those of one, shared, virtual machine; the worst case of a test set is no bound. The bounds of all "
    "loops are in the README of the exported files.",
    "QEMU counts instructions, not cycles: flash wait states and multi-cycle instructions come on top.",
    "In double precision the Cortex-M4F computes in software.",
)


def _million(instructions: float) -> str:
    return "not measured" if np.isnan(instructions) else f"{instructions / 1e6:.2f} million"


def _kib(size: int) -> str:
    return f"{size / 1024:.1f} KiB" if size else "not measured"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.exported", description=__doc__)
    parser.add_argument("--steps", type=int, default=1000, help="samples of the closed loop")
    parser.add_argument("--horizon", type=int, action="append", help="samples; may be repeated")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of exported.md and exported.csv")
    arguments = parser.parse_args()
    rows = []
    for row in measure(arguments.steps, arguments.horizon or _HORIZONS):
        rows.append(row)
        print(row, flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    (arguments.out / "exported.md").write_text(report(rows, arguments.steps), encoding="utf-8")
    with (arguments.out / "exported.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Row._fields, *rows])


if __name__ == "__main__":
    main()
