"""Exported C against Python: time of a step and of an allocation, worst case, code and memory on a Cortex-M4F.

    python -m benchmarks.speed.exported [--machine arm26] [--steps 1000] [--horizon 10] [--out benchmarks/results]

The test set is a closed loop on a joint, or an arm, with faults; C must give Python's commands on it before anything is
timed. In single precision it rounds what it is given, and must give the commands of double precision for the exact or
for the rounded numbers: a reference's second difference is its acceleration, which magnifies rounding, and decisions at
a threshold go either way. Needs gcc; without arm-none-eabi-gcc and qemu-system-arm their figures are missing, and the
report notes it.
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

from allocator import allocate, warm_up
from allocator.calculus import Array
from allocator.units import BAR, DEG
from benchmarks.allocators.machine import machine
from mpc import Arm, Compensation, KalmanObserver, RealPlant, TrackingMPC, Weights, sine
from mpc.export import export
from mpc.model.faults import FrozenSensors, SilentSensors, StuckValve, SupplyDrop
from mpc.model.friction.dahl import Friction
from mpc.model.machine import Machine
from mpc.model.real import RealArm
from mpc.observer.filter import CALM_NOISE
from mpc.trials.motions.arm_trajectories import circle
from tests.rigs import toolchain as tools
from tests.rigs.replay import CONTROL, Record, record, replayed

RESULTS = Path(__file__).parents[1] / "results"
_TIMES = Path(__file__).with_name("exported_times.c")
_HORIZONS, _STEPS, _PRECISIONS = (10, 20), 1000, ("double", "single")
_AGREE = {"double": 1e-8, "single": 1e-3}  # of the supply
_ON_CHIPS, _ON_CHIPS_ARM = 1000, 100  # steps: QEMU takes a second for one of an arm in software floats


class Row(NamedTuple):
    """One horizon and precision; times in s, sizes in bytes, NaN or 0: not measured."""

    horizon: int
    precision: str
    error: float  # greatest difference of the commands, of the supply
    python_step: float  # median
    c_step: float
    c_step_worst: float
    uncompiled_allocation: float  # in Python before `warm_up`
    python_allocation: float  # and after it
    c_allocation: float
    qp_exchanges_worst: int
    m4f_instructions: float  # of a step, median
    m4f_instructions_worst: float
    m4f_code: int
    m4f_memory: int
    m4f_allocator_code: int
    m7_instructions: float
    m7_instructions_worst: float


class Disagreement(Exception):
    """C and Python gave different commands."""


def loop(horizon: int, steps: int, machine: str = "") -> tuple[TrackingMPC, KalmanObserver, Record]:
    return _arm_loop(Arm.machine(machine), horizon, steps) if machine else _joint_loop(horizon, steps)


def _arm_loop(arm: Arm, horizon: int, steps: int) -> tuple[TrackingMPC, KalmanObserver, Record]:
    sizes = {"joints": arm.n, "muscles": arm.m}
    faults = SilentSensors(1.0, 1.4, (0,), **sizes), FrozenSensors(2.0, 2.4, (2 * arm.n,), **sizes)
    known = Compensation(Friction.of_width(arm, 2 * DEG), dead_time=0.02, dead_band=0.05 * BAR)
    process = RealArm.of(arm, known, encoder=0.02 * DEG, pressure_noise=0.02 * BAR, faults=faults)
    controller = TrackingMPC(arm, N=horizon, compensation=known, weights=Weights.calm())
    observer = KalmanObserver(arm, controller.dt, CALM_NOISE, known)
    asked = circle(arm, turns=0.5 * controller.dt * steps)
    return controller, observer, record(process, controller, observer, asked)


def _joint_loop(horizon: int, steps: int) -> tuple[TrackingMPC, KalmanObserver, Record]:
    faults = SilentSensors(1.0, 1.4, (0,)), FrozenSensors(2.0, 2.4, (2,)), StuckValve(4.0, 4.5, 1), SupplyDrop(6.0, 6.3)
    process = replace(RealPlant.standard(torque_profile=((3.0, 1.0),)), faults=faults)
    known = process.known()
    controller = TrackingMPC(process.nominal, N=horizon, compensation=known, weights=Weights.calm())
    observer = KalmanObserver(process.nominal, controller.dt, compensation=known)
    reference = sine(K=5.5, duration=controller.dt * steps, ramp=1.0)
    return controller, observer, record(process, controller, observer, reference)


def measure(steps: int, horizons: Sequence[int], machine: str = "") -> Iterator[Row]:
    """Yield a row for every horizon and precision. Raises `Disagreement`."""
    uncompiled_and_compiled: tuple[float, ...] = ()
    for horizon in horizons:
        controller, observer, done = loop(horizon, steps, machine)
        uncompiled_and_compiled = uncompiled_and_compiled or _allocation_times(controller.plant)
        wanted, rounded = [done.answers], done.samples.astype(np.float32).astype(float)
        for precision in _PRECISIONS:
            with TemporaryDirectory() as folder:
                made = export(Path(folder) / "c", controller=controller, observer=observer, precision=precision)
                replay = partial(replayed, tools.compiled(made, CONTROL, "replay"), columns=done.answers.shape[1])
                error = _error(replay(done.samples), wanted, controller.plant.m, precision)
                wanted.append(replay(rounded))
                times = _times(tools.compiled(made, _TIMES, "times"), done.samples)
                yield Row(
                    horizon,
                    precision,
                    error,
                    float(np.median(done.seconds)),
                    *(float(f(times[:, 0])) for f in (np.median, np.max)),
                    *uncompiled_and_compiled,
                    float(np.median(times[:, 1])),
                    int(times[:, 2].max()),
                    *_on_chips(made, done.samples[: steps_on_chips(steps, machine)]),
                )


def _error(got: Array, wanted: Sequence[Array], muscles: int, precision: str) -> float:
    """Return the greatest difference of the commands from the nearest `wanted` ones, of the supply.

    Raises `Disagreement`.
    """
    apart = [np.abs(got - each)[:, :muscles].max(axis=1) / (5 * BAR) for each in wanted]
    if not (error := np.min(apart, axis=0).max()) < _AGREE[precision]:
        raise Disagreement(f"C in {precision} precision is off by {error:.1e} of the supply")
    return float(error)


def _times(program: Path, samples: Array, runner: tools.Runner = tools.run) -> Array:
    return replayed(program, samples, ("step", "allocation", "exchanges"), runner)


def steps_on_chips(steps: int, machine: str) -> int:
    """Return the number of a loop's `steps` whose instructions are counted."""
    return min(steps, _ON_CHIPS_ARM if machine else _ON_CHIPS)


def _on_chips(made: Path, samples: Array) -> tuple[float, ...]:
    """Return the last fields of a `Row`."""
    if not shutil.which(tools.ARM_GCC):
        return np.nan, np.nan, 0, 0, 0, np.nan, np.nan
    sizes, whole = tools.sizes(made), tools.linked_size(made)
    alone = sum(size.code for name, size in sizes.items() if name in ("allocate.c", "exact.c", "kernel.c"))
    if not shutil.which(tools.QEMU):
        return np.nan, np.nan, *whole, alone, np.nan, np.nan
    return *_counted(made, samples, tools.M4F), *whole, alone, *_counted(made, samples, tools.M7)


def _counted(made: Path, samples: Array, core: tools.Core) -> tuple[float, float]:
    """Return instructions of a step, median and worst."""
    program = tools.compiled_for_cortex(made, _TIMES, "times.elf", core)
    runner = partial(tools.run_on_cortex, options=("-icount", "shift=0"), core=core)
    counted = _times(program, samples, runner)[:, 0]
    return float(np.median(counted)), float(counted.max())


def _allocation_times(plant: Machine) -> tuple[float, float]:
    """Return the times of an allocation in Python, before and after `warm_up`.

    The object is a copy, which nothing has warmed up.
    """
    if isinstance(plant, Arm):
        joint, q, P = replace(plant.mechanism), plant.middle, np.full(plant.m, 2 * BAR)
        work = partial(allocate, q, joint.stiffness(q, P), joint.torque(q, P), joint=joint)
    else:
        joint = replace(plant.joint)
        work = partial(allocate, 0.3, 5.5, 0.05, joint=joint)
    uncompiled = _median_time(work)
    warm_up(joint=joint)
    return uncompiled, _median_time(work)


def _median_time(work, rounds: int = 7, repeats: int = 50) -> float:
    def once() -> float:
        began = time.process_time()
        for _ in range(repeats):
            work()
        return (time.process_time() - began) / repeats

    work()
    return float(np.median([once() for _ in range(rounds)]))


def report(rows: Sequence[Row], steps: int, name: str = "") -> str:
    horizons = tuple(dict.fromkeys(row.horizon for row in rows))
    command = "python -m benchmarks.speed.exported" + f" --machine {name}" * bool(name)
    command += f" --steps {steps}" * (steps != _STEPS)
    command += "".join(f" --horizon {horizon}" for horizon in horizons if horizons != _HORIZONS)
    process = f"a simulated {name} with friction, faults" if name else "the real plant with faults"
    counted = steps_on_chips(steps, name)
    double, single = (max(r.error for r in rows if r.precision == precision) for precision in _PRECISIONS)
    lines = [
        "# Exported C against Python\n",
        f"Written by `{command}`; the figures are also in the CSV file beside it.\n",
        f"A closed loop of {steps} samples on {process} and an observer. Before anything was timed, C gave",
        f"Python's commands to {double:.1e} of the supply in double precision, and those for the exact or for the",
        f"rounded numbers to {single:.1e} in single precision; {' and '.join(map(str, _AGREE.values()))} are allowed.",
        "Processor time of this machine; a step includes observer, feed-forward and QP. `allocate` is one target in",
        "Python, before and after `warm_up`; QP exchanges are the most of a step.\n",
        "| N | precision | Python step | C step | worst | times faster | `allocate` | compiled | C | QP exchanges |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.horizon} | {r.precision} | {r.python_step * 1e3:.2f} ms | {r.c_step * 1e6:.0f} µs "
        f"| {r.c_step_worst * 1e6:.0f} µs | {r.python_step / r.c_step:.0f} | {r.uncompiled_allocation * 1e6:.0f} µs "
        f"| {r.python_allocation * 1e6:.1f} µs | {r.c_allocation * 1e9:.0f} ns | {r.qp_exchanges_worst} |"
        for r in rows
    ]
    lines += [
        "\nOn a Cortex-M4F (`arm-none-eabi-gcc -Os`, FPU for single precision); all with newlib-nano; memory",
        f"with reference and plan; instructions as QEMU's mps2-an386 (M7: an500) counts them over {counted} steps:\n",
        "| N | precision | instructions a step | worst | on an M7 | worst | code | static memory | of the allocator |",
        "|--:|---|--:|--:|--:|--:|--:|--:|--:|",
    ]
    lines += [
        f"| {r.horizon} | {r.precision} | {_million(r.m4f_instructions)} | {_million(r.m4f_instructions_worst)} "
        f"| {_million(r.m7_instructions)} | {_million(r.m7_instructions_worst)} "
        f"| {_kib(r.m4f_code)} | {_kib(r.m4f_memory)} | {_kib(r.m4f_allocator_code)} |"
        for r in rows
    ]
    lines += ["\n## Limitations\n", *(f"* {sentence}" for sentence in LIMITATIONS), f"\n{machine()}."]
    return "\n".join(lines) + "\n"


LIMITATIONS = (
    "Times are those of one, shared, virtual machine; the worst case of a test set is no bound. The bounds of all "
    "loops are in the README of the exported files.",
    "QEMU counts instructions, not cycles: flash wait states and multi-cycle instructions come on top.",
    "In double precision the Cortex-M4F computes in software; the M7 has an FPU for it.",
)


def _million(instructions: float) -> str:
    return "not measured" if np.isnan(instructions) else f"{instructions / 1e6:.2f} million"


def _kib(size: int) -> str:
    return f"{size / 1024:.1f} KiB" if size else "not measured"


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed.exported", description=__doc__)
    parser.add_argument("--machine", default="", help="a ready-made arm; by default a joint")
    parser.add_argument("--steps", type=int, default=_STEPS, help="samples of the closed loop")
    parser.add_argument("--horizon", type=int, action="append", help="samples; may be repeated")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of the report and its CSV file")
    arguments = parser.parse_args()
    rows = []
    for row in measure(arguments.steps, arguments.horizon or _HORIZONS, arguments.machine):
        rows.append(row)
        print(row, flush=True)
    arguments.out.mkdir(parents=True, exist_ok=True)
    name = "exported" + f"_{arguments.machine}" * bool(arguments.machine)
    (arguments.out / f"{name}.md").write_text(report(rows, arguments.steps, arguments.machine), encoding="utf-8")
    with (arguments.out / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([Row._fields, *rows])


if __name__ == "__main__":
    main()
