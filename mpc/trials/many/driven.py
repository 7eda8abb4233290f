"""Template of a loop in which a controller drives a plant while all samples are ordinary.

`mpc.trials.many.driving` replaces the lines below that begin with `FORMULAS` by modules: `process` has the plant under
test, `observer` the compiled sample of the observer, and `joint` the compiled step of the controller.

A sample is ordinary if every reading is believed, all problems are solved and proved, and the state is measured. The
loop returns the first sample that is not, and the run is left to `simulate`.
"""

from typing import Any

import numpy as np

from allocator.calculus import Array
from mpc.codegen.jit import compiled
from mpc.tracking.compiled.records import given_in
from mpc.tracking.compiled.sample.layout import inputs_at
from mpc.tracking.compiled.sample.stages import WHOLE
from mpc.tracking.compiled.sample.views import asked_in, made_in, plan_length
from mpc.trials.many.driving import Answers, Plant

FORMULAS: Any = None
process = observer = joint = FORMULAS

OPTIMAL, CLOSED_FORM, RESTING, QP, ALLOCATION = 0, 5, 9, 0, 3  # of `PlanStatus` and `Rung`


@compiled
def driven(
    first: int, plant: Plant, observed: int, table: int, both: Array, theta: Array, K: Array, answers: Answers
) -> int:
    """Continue from the sample `first`, and return the first one that is not ordinary; M if there is none.

    `observed` and `table` are the addresses of the observer's `Sample` and of the step's `Inputs`, `both` (2, …) has
    the result of the last sample and room for the next. `theta`, `K` (M + ahead,) are the reference.
    """
    i, M, x, y = inputs_at(table), len(answers.u), np.empty(4), np.empty(4)
    asked, N = asked_in(i.asked), given_in(i.given).u.shape[0]
    ahead = asked.theta.size
    sample, what = observer.sample_at(observed), np.int64(WHOLE)  # numba would compile the step again for a constant
    xi, last, out, closed = observer.newest(sample), both[0], both[1], i.closed != 0
    for k in range(first, M):
        process.read(plant.sensors, plant.full, plant.angles, plant.noise[k], y)
        if not observer.filtered(sample, y, answers.u[k - 1]):
            return k
        for j in range(observer.SIZE):
            answers.estimate[k, j] = xi[j]
        for j in range(4):
            x[j] = xi[j]
        now, then = theta[k : k + ahead : 1], K[k : k + ahead : 1]
        asked.d[0] = xi[4]
        if not joint.step(what, table, last, out, x[::1], now, then):
            return k
        made = made_in(out[: plan_length(N)])
        rests = made.rests[0] > 0
        answers.rung[k] = ALLOCATION if rests or closed else QP
        answers.status[k] = RESTING if rests else CLOSED_FORM if closed else OPTIMAL
        for j in range(2):
            answers.u[k, j] = plant.waiting[-1, j] = made.sent[0, j]
        answers.slack[k], answers.slack_force[k] = made.slack[0], made.slack[1]
        for j in range(3):
            answers.moved[k, j] = np.nan if closed else made.moved[j]
        moving = plant.full, plant.waiting, plant.angles
        process.advance(plant.c, plant.durations, plant.steps, *moving, plant.torques[k])
        for j in range(4):
            answers.x[k + 1, j] = plant.full[j]
        last, out = out, last
    return M
