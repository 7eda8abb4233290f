"""Margins of one loop on its model and on draws of real plants, by compiled runs where available.

A shorter version of the experiment in `mpc.trials.margins`: the plant rests, one angle reading is disturbed, for an arm
that of each joint in turn, and S is the Fourier transform of the change of the readings. On the model a pulse of torque
then gives the inertia margin. Friction and dead bands are left out.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from typing import Any, TypeVar

import numpy as np

from allocator.calculus import Array, Value
from mpc.model.arm.model import Arm
from mpc.model.faults import WrongReadings
from mpc.model.friction.dahl import Friction
from mpc.model.real import Real, real_of
from mpc.observer.base import Observer
from mpc.tracking.base import BaseController
from mpc.trials.loops import Settings, loop
from mpc.trials.many.entry import Compiled, Loop, runs
from mpc.trials.margins import DELTA, Margins, linear_model, mass_matrix
from mpc.trials.motions.reference import Reference
from mpc.tuning.tour import Tour
from mpc.yardsticks.baselines import Baseline

RealT = TypeVar("RealT", bound=Real)
SETTLE, LISTEN = 1.0, 3.5  # [s] before the disturbed reading and after it
_OF_AN_ARM = 0.5, 2.0  # [s], since its runs take longer
_SILENT = 1e-3  # [Pa] noise, since an observer rejects exactly repeated readings as frozen
_UNEQUAL = 1 + 1e-12  # a force gain of exactly 1 would need a formula compiled separately


class Listening:
    """Runs for the margins of loops on a model and on draws: each plant with and without a disturbed reading, and the
    model with a pulse of torque.
    """

    def __init__(self, settings: Settings, draws: Sequence[Real], tour: Tour) -> None:
        plant, self.dt = settings.plant, settings.dt
        self._settle, self._listen = _OF_AN_ARM if isinstance(plant, Arm) else (SETTLE, LISTEN)
        self._places = [*tour.postures, *[tour.postures[len(tour.postures) // 2]] * len(draws)]
        self._rests = [plant.at_rest(*place) for place in self._places]
        known = replace(settings.compensation, lag_up=None, lag_down=None)
        model: Real = sliding(real_of(plant, known, force_gains=(_UNEQUAL,) * plant.m))
        self._nominal = len(tour.postures)
        plants = [model] * self._nominal + [sliding(draw) for draw in draws]
        window, sizes = (self._settle, self._settle + settings.dt), {"joints": plant.n, "muscles": plant.m}
        bumps = [WrongReadings(*window, (i,), DELTA, added=True, **sizes) for i in range(plant.n)]
        groups = {id(plant): (plant, *(replace(plant, faults=(bump,)) for bump in bumps)) for plant in plants}
        pulses = [_pulsed(model, theta, window) for theta, _ in tour.postures] + [()] * len(draws)
        self._groups = [groups[id(plant)] + more for plant, more in zip(plants, pulses, strict=True)]
        self._made = Compiled()

    def margins(self, name: str, settings: Settings) -> tuple[tuple[Margins, ...], tuple[float, ...]]:
        """Return the margins on the model by posture, and M_s of each draw, of the loop called `name`."""
        controller, observer = quick_loop(name, settings.sliding)
        controller.rest = False
        samples, n = round((self._settle + self._listen) / self.dt), settings.plant.n
        t = np.asarray(self.dt * np.arange(samples + 1), float)
        loops = []
        for (theta, K), x0, group in zip(self._places, self._rests, self._groups, strict=True):
            held = (np.broadcast_to(value, (t.size, *np.shape(value))) for value in (theta, K))
            reference = Reference(t, next(held), next(held))
            loops += [Loop(0, plant, controller, reference, observer, x0, 0) for plant in group]
        angles, heard = (run.theta for run, _ in runs(loops, self._made.for_others())), list[Margins]()
        for place, group in zip(self._places, self._groups, strict=True):
            quiet, *loud = islice(angles, len(group))
            response = self._response(quiet, loud[:n], group[0].reading_age)
            swing = self._moved(quiet, loud[n:]) / (DELTA / self.dt**2) if loud[n:] else None
            heard.append(Margins.of(*place, response if np.ndim(place[0]) else response[:, 0, 0], self.dt, swing))
        return tuple(heard[: self._nominal]), tuple(m.sensitivity_peak for m in heard[self._nominal :])

    def _response(self, quiet: Array, loud: Sequence[Array], reading_age: float) -> Array:
        """Return the readings (samples, n, n) [-] of each joint by the one whose reading is disturbed by 1."""
        moved = self._moved(quiet, loud) / DELTA
        sample = np.arange(len(moved))
        late = sample - reading_age / self.dt  # as old as the readings are
        read = np.apply_along_axis(lambda one: np.interp(late, sample, one), 0, moved)
        read[0] += np.eye(len(loud))
        return np.asarray(read)

    def _moved(self, quiet: Array, loud: Sequence[Array]) -> Array:
        """Return the change (samples, n, n) [rad] of the angles by each disturbance, from its sample on."""
        first = round(self._settle / self.dt)
        return np.stack([(one - quiet)[first:-1].reshape(len(quiet) - 1 - first, -1) for one in loud], axis=-1)


def _pulsed(model: RealT, theta: Value, window: tuple[float, float]) -> tuple[RealT, ...]:
    """Return the model with a pulse of torque during the `window` [s], which would turn one joint by about `DELTA`."""
    start, end = window
    pulses: Any = mass_matrix(model.nominal, theta).T * DELTA / (end - start) ** 2
    torques = pulses if np.ndim(theta) else pulses[:, 0].tolist()
    return tuple(replace(model, torque_profile=((start, torque), (end, 0 * torque))) for torque in torques)


def quick_loop(name: str, settings: Settings) -> tuple[BaseController, Observer]:
    """Return the loop called `name`, compiled as far as it can be."""
    controller, observer = loop(name, settings)
    assert isinstance(controller, BaseController)
    return controller.compile() if isinstance(controller, Baseline) else controller, observer


def sliding(real: RealT) -> RealT:
    """Return a real machine without nonlinear effects: friction, dead band, steps of the encoder, unequal lags."""
    lags = tuple(float(np.mean(lags)) for lags in real.lags)
    effects: dict[str, Any] = {
        "lag_up": None, "lag_down": None, "flow": np.inf, "dead_band": 0.0, "friction": Friction(), "encoder": 0.0,
        "pressure_noise": _SILENT, "pressure_offset": (0.0,) * real.nominal.m, "torque_profile": (),
    }  # fmt: skip
    nominal: Any = real.nominal
    return replace(real, nominal=replace(linear_model(nominal), lag=lags), **effects)
