"""QPs of closed loops, recorded at the controller's structured solver."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from benchmarks.speed.steps.loop import DT, LOAD, reference
from benchmarks.speed.steps.whole_sample import TimedController
from mpc import KalmanObserver, Plant, RealPlant, TrackingMPC, simulate
from mpc.tracking.compiled.structured_qp.structured import StructuredQP
from mpc.tracking.feedforward import FeedForward
from mpc.tracking.linearise import Linearisation
from mpc.tracking.plan import Moved
from mpc.tracking.qp.condense import TrackingProblem

NOT_MOVED = Moved(0.0, 0.0, 0.0)  # shifts of the reference are not needed


class RecordedQP(NamedTuple):
    """QP before its solution."""

    model: Linearisation
    feed: FeedForward
    u_last: Array  # (2,) previous command [Pa]
    u_star_last: Array  # (2,) its feed-forward [Pa]
    arrays: tuple[Array, Array]  # the same in the flat arrays of the structured QP
    guess: NDArray[np.int8]  # of the bounds that bind


class Recording(NamedTuple):
    """QPs of one loop, and their structured solver."""

    structured: StructuredQP
    qps: list[RecordedQP]

    @property
    def problem(self) -> TrackingProblem:
        """Problem of all QPs."""
        return self.structured.problem

    def set(self, qp: RecordedQP) -> None:
        """Load a QP and its guess into the structured solver."""
        for array, recorded in zip(self.structured.arrays[2:], qp.arrays, strict=True):
            array[:] = recorded
        self.structured.guess[:] = qp.guess


def bare(N: int, duration: float) -> Recording:
    """Return the QPs of the loop in which the bare step is timed."""
    plant = Plant()
    return _recorded(TrackingMPC(plant, DT, N), RealPlant(plant, torque_profile=LOAD), duration)


def real(N: int, duration: float) -> Recording:
    """Return the QPs of the loop on the standard real plant, with identifiable effects in the controller's model."""
    plant = RealPlant.standard()
    return _recorded(TrackingMPC(plant.nominal, DT, N, compensation=plant.known()), plant, duration)


LOOPS = {"bare loop": bare, "real plant": real}


def _recorded(controller: TrackingMPC, plant: RealPlant, duration: float) -> Recording:
    observer = KalmanObserver(controller.plant, DT, compensation=controller.compensation)
    structured: StructuredQP = controller._qp_step.structured
    with _recording(structured) as qps:
        simulate(plant, TimedController(controller, staged=True), reference(duration), observer=observer)
    return Recording(structured, qps)


@contextmanager
def _recording(structured: StructuredQP) -> Iterator[list[RecordedQP]]:
    """Yield a list to which every QP is added before it is solved."""
    qps: list[RecordedQP] = []
    solve: Any = structured.solved

    def solved(exchanges: float) -> bool:
        given, flat = structured.given, structured.arrays[2:]
        feed = FeedForward(*(array.copy() for array in given.reference), NOT_MOVED)
        last = given.last.copy()
        arrays = flat[0].copy(), flat[1].copy()
        qps.append(RecordedQP(structured.model, feed, last[0], last[1], arrays, structured.guess.copy()))
        return bool(solve(exchanges))

    vars(structured)["solved"] = solved
    try:
        yield qps
    finally:
        del vars(structured)["solved"]
