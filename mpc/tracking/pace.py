"""A controller has to keep the pace of its samples, which is measured when it is built."""

from collections.abc import Callable
from math import inf
from time import thread_time

from allocator.notices import notice
from mpc.model.experiment import RESOLUTION
from mpc.model.machine import Machine

_TRIES = 5
_STIFF = 20  # steps of integration in a sample that ordinary plants do not need


class LongStep(UserWarning):
    """A controller's step takes longer than its sample: its commands come late, unless time is only simulated."""


def check_pace(step: Callable[[], object], plant: Machine, dt: float, N: int) -> None:
    """Warn with `LongStep` where even the quickest of some calls of `step` takes longer than `dt` [s].

    What other programs take of the processor is not the step's: the thread's own time counts. One call, if quick.
    """
    took = inf
    for _ in range(_TRIES):
        began = thread_time()
        step()
        took = min(took, thread_time() - began)
        if took <= dt:
            return
    said = f"a step takes {1e3 * took:.3g} ms, longer than its sample dt = {1e3 * dt:g} ms: {_way_out(plant, dt, N)}"
    notice(said, LongStep)


def _way_out(plant: Machine, dt: float, N: int) -> str:
    substeps = plant.substeps(dt, RESOLUTION)
    if substeps > _STIFF:
        return (
            f"the plant moves within {1 / plant.fastest_rate:.2g} s, so that every sample takes {substeps} steps of "
            f"integration; check {plant.summary}"
        )
    return f"a horizon shorter than N = {N}, longer blocks or a longer dt take less"
