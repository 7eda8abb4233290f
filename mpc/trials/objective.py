"""What a run has cost by the controllers' own objective, so that controllers can be compared in its currency.

Of the cost in `mpc.tracking.controller` every stage is charged once, as it happened: at sample k the command against
the feed-forward of the preview of that sample, at sample k + 1 the state against what that preview wanted there; the
slacks by the worst of the whole run. There is no terminal cost: a run has an end.
"""

from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from mpc.tracking.feedforward import FeedForwardLaw
from mpc.tracking.limits import Limits
from mpc.tracking.weights import Weights
from mpc.trials.reference import Reference
from mpc.trials.simulation import Run


class Cost(NamedTuple):
    """Where the cost of a run comes from."""

    theta: float
    omega: float
    K: float
    u: float  # commands away from the feed-forward
    rate: float  # their rate
    slack: float  # joint range left
    slack_force: float  # muscles less taut than they have to be

    @property
    def total(self) -> float:
        """All of it."""
        return sum(self)


def closed_loop_cost(run: Run, weights: Weights, N: int = 20, min_force: float = 0.0) -> Cost:
    """The cost of `run` for a controller that looks `N` samples ahead and has no `Compensation`."""
    wanted, u_star = _wanted(run, N, min_force)
    e = run.u - u_star
    e_first = run.estimate[0, 2:4] - u_star[0]  # the command before the first is the pressure measured
    rate = np.diff(e, axis=0, prepend=e_first[None]) / run.dt
    limits, w = Limits.of(run.plant, run.dt, min_force), weights
    s, s_F = limits.excursion(run.theta[1:]), limits.slackening(run.forces[1:])
    theta, omega, K = (wanted - np.stack([run.theta, run.x[:, 1], run.K], axis=1)[1:]).T
    return Cost(
        _half(w.theta, theta),
        _half(w.omega, omega),
        _half(w.K, K),
        _half(w.u, e),
        _half(w.rate, rate),
        w.slack * s + w.slack_square / 2 * s**2,
        w.slack_force * s_F + w.slack_force_square / 2 * s_F**2,
    )


def _wanted(run: Run, N: int, min_force: float) -> tuple[Array, Array]:
    """θ*, θ*', K* (M, 3) for the samples after the first, and u* (M, 2) [Pa]."""
    law = FeedForwardLaw(run.plant, run.dt, N, min_force)
    reference = Reference(run.t, run.theta_ref, run.K_ref)
    wanted, u_star = np.empty((len(run.u), 3)), np.empty_like(run.u)
    for k, d in enumerate(run.estimate[:, 4]):
        feed = law(*reference.preview(k, N), d)
        wanted[k], u_star[k] = (feed.theta[1], feed.omega[1], feed.K[1]), feed.u[0]
    return wanted, u_star


def _half(weight: float, errors: Array) -> float:
    return float(weight / 2 * np.sum(errors**2))


__all__ = ["Cost", "closed_loop_cost"]
