"""Responses of a closed loop from its reference angles to its actual angles.

The loop at rest is linear if no limit binds. A small smooth bump b(t) of known spectrum is added to the reference. The
spectrum of the joints' response, divided by that of the bump, is

    T(iω) = Θ(iω)/B(iω),      (n, n) of n joints

The controller previews the bump, so the phase of T may lead. A set of responses describes the uncertainty of the loop:
on the model at several postures, and on draws from its posterior.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from mpc.model.real import real_of
from mpc.observer.base import Observer
from mpc.tracking.base import BaseController
from mpc.trials.loops import Settings, loop
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller, Process, simulate
from mpc.tuning.draws import Spreads, draws
from mpc.tuning.robustness import sliding

DRAWS = 4
SETTLE, LISTEN = 1.5, 3.5  # [s] before the bump's middle and after it
BUMP, WIDTH = 1e-5, 0.02  # [rad] height, [s] standard deviation
HIGHEST, STEP = 16.0, 0.1  # [Hz] of the frequencies; the bump has an eighth of its spectrum left there
_PLACES = 0.15, 0.5, 0.85  # of the range of the first joint's angles


@dataclass(frozen=True, eq=False)
class Response:
    """Response of a loop at one posture."""

    frequency: Array  # (f,) [Hz]
    T: NDArray[np.complex128]  # (f, n, n) from reference angles to angles [-]


def response(process: Process, controller: Controller, observer: Observer, theta: Array, K: Array) -> Response:
    """Return the response of a loop at rest at the angles `theta` () or (n,) [rad] with the stiffness `K` [N·m/rad].

    The `process` and the compensation of `controller` and `observer` must have no friction and no dead band.
    `controller` and `observer` are used and reset; rest mode is off meanwhile.
    """
    dt = controller.dt
    t = dt * np.arange(round((SETTLE + LISTEN) / dt) + 1.0)
    bump = BUMP * np.exp(-0.5 * ((t - SETTLE) / WIDTH) ** 2)
    still, stiffness = np.tile(theta, (t.size, *[1] * np.ndim(theta))), np.tile(K, (t.size, *[1] * np.ndim(K)))
    x0 = controller.plant.at_rest(theta, K) if isinstance(controller, BaseController) else None

    def moved(path: Array) -> Array:
        done = simulate(process, controller, Reference(t, path, stiffness), x0=x0, observer=observer)
        return done.theta.reshape(t.size, -1)

    rests = getattr(controller, "rest", False)
    try:
        if isinstance(controller, BaseController):
            controller.rest = False
        quiet = moved(still)
        n = quiet.shape[1]
        loud = [moved(still + np.multiply.outer(bump, np.eye(n)[i] if np.ndim(theta) else 1.0)) for i in range(n)]
    finally:
        if isinstance(controller, BaseController):
            controller.rest = rests
        controller.reset()
        observer.reset()
    answer = np.stack([one - quiet for one in loud], axis=-1)  # (M, n, n), columns by the joint with the bump
    frequency = np.arange(0.0, min(HIGHEST, 0.4 / dt), STEP)
    waves = np.exp(-2j * np.pi * np.outer(frequency, t))  # (f, M)
    return Response(frequency, np.asarray(np.tensordot(waves, answer, 1) / (waves @ bump)[:, None, None], complex))


def responses(
    name: str,
    settings: Settings,
    reference: Reference,
    spreads: Spreads | None = None,
    *,
    observer: bool | None = None,
    n_draws: int = DRAWS,
) -> tuple[Response, ...]:
    """Return the responses of the loop called `name`: at three postures of a reference, and of draws.

    The draws are `n_draws` machines from the posterior that `spreads` describe, by default that of data sheets. `name`
    and `observer` are as for `mpc.trials.loops.loop`. Raises `InvalidInput` for an arm without formulas.
    """
    sliding_loop = settings.sliding
    told = replace(sliding_loop.compensation, lag_up=None, lag_down=None)
    controller, watching = loop(name, sliding_loop._replace(compensation=told), observer)
    places = postures(reference)
    drawn = draws(settings.plant, settings.compensation, n_draws, 0, spreads or Spreads())
    model = sliding(real_of(settings.plant, told))
    asked = [(model, place) for place in places] + [(sliding(draw), places[1]) for draw in drawn]
    return tuple(response(process, controller, watching, *place) for process, place in asked)


def postures(reference: Reference) -> list[tuple[Array, Array]]:
    """Return three samples of a reference, angles and stiffness: low, middle and high in the first joint's range."""
    first = reference.theta.reshape(reference.t.size, -1)[:, 0]
    ends = first.min() + np.ptp(first) * np.array(_PLACES)
    found = [int(np.abs(first - end).argmin()) for end in ends]
    return [(reference.theta[k], reference.K[k]) for k in found]


def doubted(
    given: Iterable[Response], gains: Sequence[float] = (0.85, 1.15), ages: Sequence[float] = (-0.015, 0.015)
) -> tuple[Response, ...]:
    """Return the responses, and variants of each with other gains and with angles delayed by `ages` [s].

    They replace draws if there is no posterior.
    """
    known = tuple(given)
    more = [
        replace(one, T=one.T * gain * np.exp(-2j * np.pi * one.frequency * age)[:, None, None])
        for one in known
        for gain in gains
        for age in ages
    ]
    return (*known, *more)
