"""Closed-loop cost of a run by the controllers' own objective, to compare controllers.

Every stage of the cost in `mpc.tracking.cost` counts once, with its true values: at sample k the command against the
feed-forward of the preview of that sample, at sample k + 1 the state against that preview's reference. The slacks are
the greatest of the whole run. There is no terminal cost, since a run ends.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.cost import Rows, Weights, charges
from mpc.tracking.feedforward import InverseDynamics
from mpc.tracking.limits import Limits
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Run


class Cost(NamedTuple):
    """Cost of a run, by its parts."""

    theta: float
    omega: float
    K: float
    u: float  # commands away from the feed-forward
    rate: float  # their rate
    slack: float  # joint range left
    slack_force: float  # forces below the least one

    @property
    def total(self) -> float:
        """Total cost."""
        return sum(self)


def closed_loop_cost(run: Run, weights: Weights, N: int = 20, min_force: float = 0.0) -> Cost:
    """Return the cost of `run` for a controller with a horizon of `N` samples and no `Compensation`."""
    references = _references(run, N, min_force)
    e = run.u - references.u
    e_first = run.estimate[0, 2:4] - references.u[0]  # the command before the first is the measured pressure
    x, y = run.x[1:] - references.x, np.column_stack([run.K, run.forces])[1:] - references.y
    rate = np.diff(e, axis=0, prepend=e_first[None]) / run.dt
    limits, w = Limits.of(run.plant, run.dt, min_force), weights
    s, s_F = limits.excursion(run.theta[1:]), limits.slackening(run.forces[1:])
    return Cost(
        **{name: float(np.sum(charge)) for name, charge in charges(w, Rows(x.T, y.T, e.T, rate.T)).items()},
        slack=w.slack * s + w.slack_square / 2 * s**2,
        slack_force=w.slack_force * s_F + w.slack_force_square / 2 * s_F**2,
    )


class _References(NamedTuple):
    """References of the controller at each of M samples."""

    x: Array  # (M, 4) of the next sample
    y: Array  # (M, 3)
    u: Array  # (M, 2) [Pa]


def _references(run: Run, N: int, min_force: float) -> _References:
    feed_forward = InverseDynamics(run.plant, run.dt, N, min_force)
    reference = Reference(run.t, run.theta_ref, run.K_ref)
    feeds = [feed_forward(*reference.preview(k, N), d) for k, d in enumerate(run.estimate[:, 4])]
    rows = ([feed.x[1] for feed in feeds], [feed.y[1] for feed in feeds], [feed.u[0] for feed in feeds])
    return _References(*map(np.array, rows))
