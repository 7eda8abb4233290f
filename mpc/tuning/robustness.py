"""Margins of one loop on its model and on draws of real plants, by compiled runs where available.

A shorter version of the experiment in `mpc.trials.margins`: the plant rests, one angle reading is disturbed, and S is
the Fourier transform of the change of the readings. Friction and dead bands are left out.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from mpc.model.faults import WrongReadings
from mpc.model.friction.dahl import Friction
from mpc.model.real_plant import RealPlant
from mpc.observer.base import Observer
from mpc.tracking.base import BaseController
from mpc.trials.loops import Settings, loop
from mpc.trials.many.loop import Compiled, Loop, outcomes
from mpc.trials.margins import DELTA, Margins, linear
from mpc.trials.motions.reference import Reference
from mpc.tuning.tour import Tour
from mpc.yardsticks.baselines import Baseline

SETTLE, LISTEN = 1.0, 3.5  # [s] before the disturbed reading and after it
_SILENT = 1e-3  # [Pa] noise, since an observer rejects exactly repeated readings as frozen
_UNEQUAL = 1 + 1e-12  # a force gain of exactly 1 would need a formula compiled separately


class Listening:
    """Runs for the margins of loops on a model and on draws: each plant with and without a disturbed reading."""

    def __init__(self, settings: Settings, draws: Sequence[RealPlant], tour: Tour) -> None:
        plant, self.dt = settings.plant, settings.dt
        self._places = [*tour.postures, *[(0.0, tour.K)] * len(draws)]
        known = replace(settings.compensation, lag_up=None, lag_down=None)
        model = sliding(RealPlant.of(plant, known, force_gains=(_UNEQUAL, _UNEQUAL)))
        nominal = len(self._places) - len(draws)
        plants = [model] * nominal + [sliding(draw) for draw in draws]
        bump = WrongReadings(SETTLE, SETTLE + settings.dt, (0,), DELTA, added=True)
        pairs = {plant: (plant, replace(plant, faults=(bump,))) for plant in plants}
        self._pairs = [pairs[plant] for plant in plants]
        self._nominal = nominal
        self._made = Compiled()

    def margins(self, name: str, settings: Settings) -> tuple[tuple[Margins, ...], tuple[float, ...]]:
        """Return the margins on the model by posture, and M_s of each draw, of the loop called `name`."""
        controller, observer = quick_loop(name, settings._replace(compensation=linear(settings.compensation)))
        controller.rest = False
        samples = round((SETTLE + LISTEN) / self.dt)
        t = np.asarray(self.dt * np.arange(samples + 1), float)
        loops = []
        for (theta, K), pair in zip(self._places, self._pairs, strict=True):
            reference, x0 = Reference(t, np.full_like(t, theta), np.full_like(t, K)), settings.plant.at_rest(theta, K)
            loops += [Loop(0, plant, controller, reference, observer, x0, 0) for plant in pair]
        found = [one.run for _, one in outcomes(loops, True, self._made.for_others()) if one.run is not None]
        first = round(SETTLE / self.dt)
        heard: list[Margins] = []
        for place, (plant, _), quiet, loud in zip(self._places, self._pairs, found[::2], found[1::2], strict=True):
            moved, sample = (loud.theta - quiet.theta)[first:-1] / DELTA, np.arange(samples - first)
            read = np.interp(sample - plant.reading_age / self.dt, sample, moved)  # as old as the readings are
            heard.append(Margins.of(*place, read + (sample == 0), self.dt))
        return tuple(heard[: self._nominal]), tuple(m.sensitivity_peak for m in heard[self._nominal :])


def quick_loop(name: str, settings: Settings) -> tuple[BaseController, Observer]:
    """Return the loop called `name`, compiled as far as it can be."""
    controller, observer = loop(name, settings)
    assert isinstance(controller, BaseController)
    return controller.compile() if isinstance(controller, Baseline) else controller, observer


def sliding(real: RealPlant) -> RealPlant:
    """Return a real plant without nonlinear effects: friction, dead band, steps of the encoder, unequal lags."""
    one, two = (float(np.mean(lags)) for lags in real.lags)
    return replace(
        real, nominal=replace(real.nominal, lag=(one, two)), lag_up=None, lag_down=None, flow=np.inf, dead_band=0.0,
        friction=Friction(), encoder=0.0, pressure_noise=_SILENT, pressure_offset=(0.0, 0.0), torque_profile=(),
    )  # fmt: skip
