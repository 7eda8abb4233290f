"""Closed-loop runs on strangers, and their error figures."""

from itertools import product
from typing import NamedTuple

import numpy as np

from allocator.units import DEG
from benchmarks.closed_loop.runs import LEAD, STEADY, UNSTABLE
from benchmarks.strangers.identified import Model, data_sheet, identified
from benchmarks.strangers.plants import Stranger, drawn
from benchmarks.strangers.tuned import tuned
from mpc import Reference, simulate
from mpc.trials.loops import Settings, loop, robust
from mpc.trials.motions.reference import min_jerk
from mpc.trials.motions.trajectories import point_to_point, rested_sine, steps

CONTROLLERS = ("mpc", "lqr", "predictive-pid", "pid", "pi", "feedforward")
MODELS = {
    "data sheet": (data_sheet, False),
    "identified": (identified, False),
    "identified and tuned": (identified, True),
}
PAYLOAD = 1.0  # [N·m]
K = 5.0  # [N·m/rad]
DT = 0.01  # [s]


class Case(NamedTuple):
    """A trajectory, and when the payload comes."""

    reference: Reference
    loaded: float  # [s]


def standing(theta: float = 15 * DEG, time: float = 1.0, rest: float = 8.0) -> Reference:
    """Return one movement of least jerk to `theta`, and a long rest there."""
    t = DT * np.arange(round((LEAD + time + rest) / DT) + 1)
    return Reference(t, theta * min_jerk((t - LEAD) / time), np.full_like(t, K))


CASES = {
    "sine": Case(rested_sine(K), 9.0),
    "min-jerk": Case(point_to_point(K), 7.0),
    "steps": Case(steps(K), LEAD + 4.8),
    "rest": Case(standing(), LEAD + 4.0),
}


class Figures(NamedTuple):
    """Error figures of a run."""

    before: float  # RMS error before the payload [°]
    after: float  # and with it [°]
    standing: float  # |mean error| in the last second [°], meaningful for the case `rest`
    swing: float  # peak to peak there [°]
    K_rms: float  # [N·m/rad] of the true stiffness
    moving: float  # mean |change of the commands| in the last second [bar/s]

    @property
    def unstable(self) -> bool:
        """Return whether the joint was thrown about."""
        return not self.after <= UNSTABLE


def figures(stranger: Stranger, model: Model, controller: str, case: Case, payload: float = PAYLOAD) -> Figures:
    """Return those of one run."""
    settings = Settings(model.plant, DT, compensation=model.told)
    if model.tuned:
        name = f"{stranger.structure}-{stranger.seed}"
        settings = tuned(name, controller, settings, model.spreads, K, case.reference)
    else:
        settings = robust(controller, settings, case.reference)
    control, observer = loop(controller, settings)
    loaded = stranger.loaded(payload, case.loaded)
    x0 = model.plant.at_rest(case.reference.theta[0], case.reference.K[0])
    run = simulate(loaded, control, case.reference, x0=x0, observer=observer, seed=stranger.seed)
    error, last = (run.theta - run.theta_ref) / DEG, round(STEADY / DT)
    begin, end = round(LEAD / DT), round(case.loaded / DT)
    return Figures(
        rms(error[begin:end]),
        rms(error[end:]),
        abs(float(error[-last:].mean())),
        float(np.ptp(error[-last:])),
        rms((run.K - run.K_ref)[begin:]),
        float(np.abs(np.diff(run.u[-last:], axis=0)).mean() / DT / 1e5),
    )


def rms(error: np.ndarray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(error**2)))


class Row(NamedTuple):
    """One run."""

    structure: str
    seed: int
    model: str
    controller: str
    case: str
    figures: Figures


def rows_of(structure: str, seed: int, models: tuple[str, ...], controllers: tuple[str, ...]) -> list[Row]:
    """Return the runs of one stranger with these models of it."""
    stranger = drawn(structure, seed)
    made = {make: make(stranger) for make in dict.fromkeys(MODELS[model][0] for model in models)}
    told = {model: made[MODELS[model][0]]._replace(tuned=MODELS[model][1]) for model in models}
    return [
        Row(structure, seed, model, name, case, figures(stranger, told[model], name, CASES[case]))
        for model, name, case in product(models, controllers, CASES)
    ]
