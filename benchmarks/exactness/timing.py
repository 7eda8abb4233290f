"""Times of one joint in a new process without compiled code: `python -m benchmarks.exactness.timing`.

Called with a muscle and a geometry; prints one line of JSON, a list of `Time`.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from allocator import allocate, warm_up
from tests.exact_everywhere.curves import image
from tests.exact_everywhere.joints import joint_of
from tests.exact_everywhere.judge import PRIORITIES, WEIGHTS
from tests.exact_everywhere.targets import random_targets

BATCH, ROUNDS = 10_000, 3
PATIENCE = 0.3  # [s] after which measurements and single calls are not repeated


@dataclass(frozen=True)
class Time:
    """Processor times [µs] of one joint with one priority, per target."""

    muscle: str
    geometry: str
    priority: str
    scalar_before: float  # warm_up
    scalar_after: float
    batch: float  # of BATCH random targets in one call, including the box


def times(muscle: str, geometry: str) -> list[Time]:
    """Return times measured in a new process."""
    command = [sys.executable, "-m", "benchmarks.exactness.timing", muscle, geometry]
    done = subprocess.run(command, cwd=Path(__file__).parents[2], capture_output=True, text=True, check=True)
    return [Time(**record) for record in json.loads(done.stdout)]


def measured(muscle: str, geometry: str) -> list[Time]:
    """Return times measured in this process."""
    joint, rng = joint_of(muscle, geometry), np.random.default_rng(1)
    left, right = joint.angle_range
    reach = image(joint, rng.uniform(left, right, 100))
    targets = random_targets(reach, -(-BATCH // reach.theta.size), rng)
    rows = np.stack([reach.theta[targets.row], targets.K, targets.T], axis=1)
    rows = rng.permutation(rows)[:BATCH]

    def ask(priority: str, *question: object) -> None:
        weights = WEIGHTS if priority == "weighted" else None
        allocate(*question, joint=joint, priority=priority, weights=weights)

    def single(priority: str) -> float:
        return float(np.median(_seconds(ask, ((priority, *row) for row in rows.tolist()))))

    before = {priority: single(priority) for priority in PRIORITIES}
    for priority in PRIORITIES:
        warm_up(joint=joint, priority=priority)
    found = []
    for priority in PRIORITIES:
        batch = min(_seconds(ask, [(priority, *rows.T)] * (ROUNDS + 1))[-ROUNDS:]) / len(rows)
        seconds = before[priority], single(priority), batch
        found.append(Time(muscle, geometry, priority, *(round(1e6 * s, 3) for s in seconds)))
    return found


def _seconds(work: Callable[..., object], calls: Iterable[tuple[object, ...]]) -> list[float]:
    """Return the time of every call, until PATIENCE is over."""
    found: list[float] = []
    for call in calls:
        start = time.process_time()
        work(*call)
        found.append(time.process_time() - start)
        if sum(found) > PATIENCE:
            break
    return found


if __name__ == "__main__":
    print(json.dumps([asdict(t) for t in measured(*sys.argv[1:])]))
