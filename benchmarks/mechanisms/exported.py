"""The exported C against Python, for muscles that are not affine: the same pressures, statuses and proofs?

    python -m benchmarks.mechanisms.exported [--targets 100] [--mechanism leg37]

Random targets, within reach and beyond it, with and without limits on forces and steps, both priorities. Needs gcc;
what needs arm-none-eabi-gcc and qemu-system-arm is left out without them.
"""

import argparse
import shutil
import subprocess
import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, ClassVar

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.mechanism import Link, Mechanism, MechanismStatus, Pulleys, Sites, allocate_mechanism, machines
from allocator.muscles import Andrikopoulos2016, Muscle, TonduLopez2000, Wickramatunge2010
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N
from allocator.units import BAR, DEG
from mpc.export.mechanism.entry import export_mechanism
from tests.rigs import toolchain as tools

MAIN = Path(tools.__file__).parent / "c" / "replay" / "mechanism.c"
_TIMES = Path(__file__).with_name("exported_times.c")
TONDU = TONDU_DMSP_20_400N
LOPEZ = TonduLopez2000(0.01, 25 * DEG, 1.2, 0.5, 1 * BAR)
ANDRIKOPOULOS = Andrikopoulos2016(0.01, 25 * DEG, 1.5, 2.0, 1 * BAR, 0.8)
KINKED = Wickramatunge2010(0.4, 0.29, 2e3, 1e5, 0.03, 2e-8, 1e-8, 2.5 * BAR)
FAILED = MechanismStatus.SOLVER_FAILED


def sites(muscles: Muscle | Sequence[Muscle]) -> Mechanism:
    """An arm of two links whose six muscles run between sites: bends count."""
    links = [Link(), Link(0, origin=(0.0, 0.3))]
    paths = [[(-1, (0.0, -0.3)), (0, (side * 0.03, 0.0))] for side in (-1, 1)]
    paths += [[(0, (0.0, 0.0)), (1, (side * 0.03, 0.0))] for side in (-1, 1)]
    paths += [[(-1, (0.0, -0.3)), (0, (side * 0.03, 0.0)), (1, (side * 0.02, 0.0))] for side in (-1, 1)]
    routes = Sites(0.4, links, paths, cable=[-0.0435] * 4 + [0.2565] * 2)
    return Mechanism(routes, muscles, angle_limits=((-0.5, 0.5), (-0.4, 0.4)))


MECHANISMS = {
    "one joint": Mechanism(Pulleys(0.4, [(0.02,), (-0.02,)], 0.1375), TONDU),
    "Tondu2021": machines.arm26().with_muscles(TONDU),
    "bends, five laws": sites((LOPEZ, ANDRIKOPOULOS, KINKED, TONDU, SAROSI_DMSP_20_400N, TONDU)),
    "leg37": machines.leg37().with_muscles(TONDU),
}
CASES = [
    ("torque", 0.0, np.inf, False, False),
    ("stiffness", 0.0, np.inf, True, True),
    ("torque", 40.0, 350.0, False, False),
    ("torque", 0.0, np.inf, True, True),
    ("stiffness", 0.0, np.inf, False, False),
]


@dataclass(frozen=True)
class Questions:
    """Rows for C, and what Python says: pressures, torques, stiffnesses, costs of both levels, status, gap, bounds."""

    mechanism: Mechanism
    rows: Array
    P: Array
    y: Array
    status: Array
    seconds: float  # of processor time that Python took for all
    PARTS: ClassVar = ("P", "y", "residual", "status", "nodes", "gap", "bounds")

    def of_c(self, printed: Array) -> dict[str, Array]:
        """What C prints, by name."""
        n, m = self.mechanism.n, self.mechanism.m
        ends = np.cumsum([m, n + n * (n + 1) // 2, 1, 1, 1, 1])
        parts = dict(zip(self.PARTS, np.split(printed, ends, axis=1), strict=True))
        return {name: part if part.shape[1] > 1 else part[:, 0] for name, part in parts.items()}

    def costs(self, y: Array) -> Array:
        """The squared errors (N, 2) of both levels, in the order of the priority."""
        n, m = self.mechanism.n, self.mechanism.m
        rows, columns = self.mechanism.upper_triangle
        asked = self.rows[:, n : n + y.shape[1]]
        squares = np.nan_to_num((y - asked) ** 2) * np.concatenate([np.ones(n), 1.0 + (rows != columns)])
        torque, stiffness = squares[:, :n].sum(axis=1), squares[:, n:].sum(axis=1)
        second = self.rows[:, -1:] == 1
        assert self.rows.shape[1] == n + y.shape[1] + 2 + m + 4
        return np.where(second, np.stack([stiffness, torque], 1), np.stack([torque, stiffness], 1))


@cache
def questions(mechanism: Mechanism, N: int, seed: int = 0, dtype: Any = float) -> Questions:
    """Targets within reach and beyond it, with torques up to four and stiffnesses from 0.3 to 3 times what there is."""
    rng = np.random.default_rng(seed)
    n, m = mechanism.n, mechanism.m
    rows, found, began = [], [], time.process_time()
    for priority, least, greatest, slew, diagonal in CASES:
        q = rng.uniform(-0.3, 0.3, n).astype(dtype).astype(float)
        P = rng.uniform(*mechanism.pressure_box(q), (N, m))
        far, stiff = rng.choice([1.0, 1.0, 2.5], N), rng.choice([0.3, 1.0, 1.0, 1.7, 3.0], N)
        T = (mechanism.torque(q, P) * far[:, None]).astype(dtype).astype(float)
        K = (mechanism.stiffness(q, P) * stiff[:, None, None]).astype(dtype).astype(float)
        T, K, P = (a[np.linalg.eigvalsh(K)[:, 0] > 0.05] for a in (T, K, P))  # others are none to ask for
        now = np.clip((P + rng.uniform(-1, 1, P.shape) * BAR).astype(dtype).astype(float), 0, 5 * BAR)
        triangle = K[:, *mechanism.upper_triangle]
        if diagonal:
            triangle[:, mechanism.upper_triangle[0] != mechanism.upper_triangle[1]] = np.nan
        limits = {"min_force": least, "max_force": None if np.isinf(greatest) else greatest, "priority": priority}
        for i in range(len(T)):
            moved = {"previous": now[i], "max_step": 0.3 * BAR} if slew else {}
            try:
                a = allocate_mechanism(mechanism, q, np.diag(K[i]) if diagonal else K[i], T[i], **limits, **moved)
            except InvalidInput as error:
                if "does not rise" not in str(error):
                    raise
                continue  # a law falls within the limits: Python refuses, and C has no proof
            tail = [0.3 * BAR if slew else np.inf, slew, 0, priority != "torque"]
            rows.append([*q, *T[i], *triangle[i], least, greatest, *now[i], *tail])
            found.append((a.P, [*a.T, *a.K[mechanism.upper_triangle]], int(a.status)))
    P, y, status = zip(*found, strict=True)
    seconds = time.process_time() - began
    return Questions(mechanism, np.array(rows, float), np.array(P), np.array(y), np.array(status), seconds)


def answered(program: Path, rows: Sequence[Any], *arguments: str) -> Array:
    """What the replay of C says of the rows."""
    text = "\n".join(" ".join(f"{value:.17g}" for value in row) for row in rows)
    done = subprocess.run([program, *arguments], input=text, capture_output=True, text=True, check=True)
    return np.array([[float(value) for value in line.split()] for line in done.stdout.splitlines()])


def compared(name: str, precision: str, targets: int) -> str:
    """Return a line about so many targets, and a few more, of a mechanism."""
    dtype, each = (np.float32 if precision == "single" else float), 4
    with TemporaryDirectory() as folder:
        out = export_mechanism(Path(folder) / "c", MECHANISMS[name], precision=precision)
        program = tools.compiled(out, MAIN, "replay")
        total, same, open_c, open_python, off, worse, above, nodes, seconds = 0, 0, 0, 0, [], 0.0, 0.0, [], 0.0
        rows: list[Any] = []
        while total < targets:
            asked = questions(MECHANISMS[name], each, total, dtype)
            made = asked.of_c(answered(program, asked.rows))
            given, expected = asked.costs(made["y"]), asked.costs(asked.y)
            proved = (made["status"] != FAILED) & (asked.status != FAILED)
            total, same = total + len(asked.rows), same + int((made["status"] == asked.status).sum())
            open_c += int((made["status"] == FAILED).sum())
            open_python += int((asked.status == FAILED).sum())
            worse = max(worse, float(np.abs((given - expected) / (1 + expected))[proved].max(initial=0.0)))
            above = max(above, float(((made["bounds"] - expected) / (1 + expected)).max()))
            off += (np.abs(made["P"] - asked.P).max(axis=1) / (5 * BAR)).tolist()
            nodes += made["nodes"].tolist()
            rows += asked.rows.tolist()[::4]
            seconds += asked.seconds
        times = float(answered(program, rows, "timed")[0, 0]), 1e3 * seconds / total
        counted = _on_m4f(out) if precision == "single" else ""
    return (
        f"{name}, {precision}: {total} targets, {same} statuses equal, not proved {open_c} in C and {open_python} in "
        f"Python; squared errors differ by {worse:.0e} of 1 + cost at most, bounds exceed them by {max(above, 0.0):.0e}"
        f"; pressures by {np.median(off):.0e} of the supply (99 %: {np.quantile(off, 0.99):.0e}); nodes "
        f"{np.median(nodes):.0f}, most {max(nodes):.0f}; {times[0]:.0f} µs in C, {times[1]:.0f} ms in Python{counted}"
    )


def _on_m4f(out: Path) -> str:
    """What a Cortex-M4F takes, as far as it can be found here."""
    if not shutil.which(tools.ARM_GCC) or not shutil.which(tools.QEMU):
        return ""
    program = tools.compiled_for_cortex_m4f(out, _TIMES, "times.elf")
    lines = tools.run_on_cortex_m4f(program, options=("-icount", "shift=0")).splitlines()
    *instructions, (memory, _) = ([int(value) for value in line.split()] for line in lines)
    anew, followed = (np.median(values) / 1e6 for values in zip(*instructions, strict=True))
    code = sum(size.code for size in tools.sizes(out).values())
    return (
        f"; Cortex-M4F: {anew:.1f} million instructions, {followed:.1f} where targets follow each other, "
        f"{code / 1024:.0f} KiB of code, {memory / 1024:.1f} KiB of memory"
    )


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m benchmarks.mechanisms.exported", description=__doc__)
    parser.add_argument("--targets", type=int, default=100, help="of each mechanism and precision")
    parser.add_argument("--mechanism", choices=MECHANISMS, action="append", help="all without it")
    arguments = parser.parse_args()
    for name in arguments.mechanism or MECHANISMS:
        for precision in ("double", "single"):
            print(compared(name, precision, arguments.targets), flush=True)


if __name__ == "__main__":
    main()
