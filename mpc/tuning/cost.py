"""Closed-loop cost of a loop on draws of real plants, and its margins.

    cost of a draw = mean RMS error over the legs of the tour [°] + CHATTER · mean |u'| at rest [bar/s]
                     + STIFFNESS · RMS error of K over K
    objective      = mean of that over the draws, subject to M_s ≤ 2 on the model and ≤ 3 on the draws, and to an
                     inertia margin on the model of 3, or that of the defaults if it is less

For an arm the errors are those of the worst joint, and the Frobenius norm of the error of K over that of K.

M_s on the model is the greatest over the postures of the tour, less `SLACK`, since the defaults meet the limit at one
of them; M_s on the draws is their 80 % quantile. The limit of the draws is `OF_DRAWS` times that of the model: M_s = 2
on the model is a margin kept for machines that differ from it. On identified joints of other structures, loops tuned
with M_s ≤ 2 on the draws and for the 80 % quantile of the cost had errors 1.1 to 1.5 times those of the defaults.

The payload of the tour is a torque without inertia; the inertia margin stands for its inertia. Without that limit a
tuned loop became unstable when a joint of another structure took up its payload. With five times the `CHATTER` slower
loops were chosen for quieter commands, which rest mode quiets anyway; on such joints their errors were up to three
times those of the defaults.

A loop that exceeds a limit x > 1 times is charged `BEYOND` (1 - 1/x), which makes it worse than any useful loop
within the limits and grows with the excess. Far beyond, the tour is not simulated, and its error counts as `THROWN`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import inf
from typing import Any, NamedTuple, Self
from uuid import uuid4

import numpy as np

from allocator import checks
from allocator.calculus import Array, Value
from allocator.units import BAR, DEG
from mpc.model.real import Real
from mpc.trials.loops import Settings
from mpc.trials.many.entry import Compiled, Loop, runs
from mpc.trials.margins import ROBUST, SLACK, Margins
from mpc.trials.simulation import Run
from mpc.trials.tuned import Tuning
from mpc.tuning.draws import Spreads, draws, payloads
from mpc.tuning.robustness import Listening, quick_loop
from mpc.tuning.tour import Tour

QUANTILE = 0.8  # of M_s over the draws
CHATTER = 0.02  # [°] per bar/s
STIFFNESS = 2.0  # [°] per 100 % of K
OF_DRAWS = 1.5  # limit of M_s on draws, over that on the model
BEARS = 3.0  # least inertia margin on the model [-], unless that of the defaults is less
BEYOND = 50.0  # [°]
FAR = 1.5  # ratio to a limit from which a loop is not simulated
THROWN = 45.0  # [°] greatest cost of a leg, for a joint that is thrown about


class Figures(NamedTuple):
    """Figures of one draw."""

    rms: Mapping[str, float]  # of each leg [°]
    chatter: float  # at rest [bar/s]
    K_error: float  # RMS over K [-]

    @property
    def cost(self) -> float:
        """The cost of the draw [°]."""
        return float(np.mean([*self.rms.values()]) + CHATTER * self.chatter + STIFFNESS * self.K_error)


class Evaluation(NamedTuple):
    """Figures of a tuning over all draws."""

    tuning: Tuning
    draws: tuple[Figures, ...]  # none of a loop far beyond the limits
    nominal: tuple[Margins, ...]  # by posture
    peaks: tuple[float, ...]  # M_s of each draw
    limit: float  # of M_s on the model
    bears: float  # limit of the inertia margin

    @property
    def error(self) -> float:
        """The mean cost of the draws [°]."""
        return float(np.mean([one.cost for one in self.draws])) if self.draws else THROWN

    @property
    def sensitivity_peak(self) -> float:
        """M_s, the greatest on the model."""
        return max(m.sensitivity_peak for m in self.nominal)

    @property
    def peak_of_draws(self) -> float:
        """The 80 % quantile of M_s over the draws."""
        return float(np.quantile(self.peaks, QUANTILE, method="higher"))

    @property
    def excess(self) -> float:
        """The greatest ratio to a limit [-]: of M_s on the model and on the draws, and of the inertia margin."""
        peak = max(self.sensitivity_peak - SLACK, self.peak_of_draws / OF_DRAWS) / self.limit
        return max(peak, self.bears / self.inertia_margin)

    @property
    def inertia_margin(self) -> float:
        """The least inertia margin on the model [-]."""
        return min(m.inertia_margin for m in self.nominal)

    @property
    def delay_margin(self) -> float:
        """The least delay margin on the model [s]."""
        return min(m.delay_margin for m in self.nominal)

    @property
    def robust(self) -> bool:
        """Whether the loop keeps the limits."""
        return self.excess <= 1

    @property
    def objective(self) -> float:
        """The objective to minimise [°]."""
        return self.error + BEYOND * max(0.0, 1 - 1 / self.excess)

    def rms(self, leg: str) -> float:
        """Return the RMS error of a leg [°], the mean of the draws."""
        return float(np.mean([one.rms[leg] for one in self.draws]))

    @property
    def chatter(self) -> float:
        """Mean motion of the commands at rest [bar/s]."""
        return float(np.mean([one.chatter for one in self.draws]))

    @property
    def K_error(self) -> float:
        """Mean stiffness error [-]."""
        return float(np.mean([one.K_error for one in self.draws]))


@dataclass(frozen=True, eq=False)
class Problem:
    """A loop to be tuned: its default settings, and the draws on which it is evaluated."""

    controller: str
    settings: Settings
    draws: tuple[Real, ...]
    payloads: tuple[Value, ...]  # [N·m], of each draw; (n,) for an arm
    tour: Tour
    spreads: Spreads  # of the draws
    limit: float = ROBUST  # of M_s on the model
    seed: int = 0
    key: str = field(default_factory=lambda: uuid4().hex)  # identifies the problem in another process

    @classmethod
    def of(
        cls, controller: str, settings: Settings, tour: Tour, n: int, seed: int, spreads: Spreads, limit: float
    ) -> Self:
        """Return the problem with `n` draws of the `seed` about the plant of the settings."""
        plants = draws(settings.plant, settings.compensation, n, seed, spreads)
        loads = payloads(n, seed, tour.K, spreads)
        return cls(controller, settings, plants, loads, tour, spreads, limit, seed)

    def redrawn(self, seed: int) -> Self:
        """Return the same problem with as many draws of another seed."""
        parts = self.controller, self.settings, self.tour, len(self.draws)
        return self.of(*parts, checks.count("seed", seed, least=0), self.spreads, self.limit)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Problem) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    @cached_property
    def plants(self) -> tuple[Real, ...]:
        """The draws with their payloads."""
        at, pairs = self.tour.loaded, zip(self.draws, self.payloads, strict=True)
        loads: list[tuple[Real, Any]] = [(draw, ((at, T),)) for draw, T in pairs]
        return tuple(replace(draw, torque_profile=profile) for draw, profile in loads)

    def __getstate__(self) -> dict[str, object]:
        """Leave out compiled functions."""
        made = "plants", "_made", "_listening"
        return {name: value for name, value in self.__dict__.items() if name not in made}

    @cached_property
    def _made(self) -> Compiled:
        return Compiled()

    @cached_property
    def _listening(self) -> Listening:
        return Listening(self.settings, self.draws, self.tour)

    @cached_property
    def _bears(self) -> float:
        """Limit of the inertia margin [-]."""
        usual, _ = self._listening.margins(self.controller, self.settings)
        return min(BEARS, *(m.inertia_margin for m in usual))

    def evaluated(self, tuning: Tuning, always: bool = False) -> Evaluation:
        """Return the evaluation of a tuning; `always` also simulates loops far beyond the limits."""
        settings = tuning.applied(self.settings)
        nominal, peaks = self._listening.margins(self.controller, settings)
        margins = Evaluation(tuning, (), nominal, peaks, self.limit, self._bears)
        if margins.excess > FAR and not always:
            return margins
        controller, observer = quick_loop(self.controller, settings)
        loops = [
            Loop(i, plant, controller, self.tour.reference, observer, None, self.seed + i)
            for i, plant in enumerate(self.plants)
        ]
        return margins._replace(draws=tuple(figures(run, self.tour) for run, _ in runs(loops, self._made.for_others())))


def figures(run: Run, tour: Tour) -> Figures:
    """Return the figures of a run along a tour."""
    error = (run.theta - run.theta_ref)[:-1] / DEG
    rms = {name: _rms(error[leg]) for name, leg in tour.legs.items()}
    moving = [np.abs(np.diff(run.u[rest], axis=0)).mean() / run.dt / BAR for rest in tour.rests]
    from_first = slice(min(leg.start for leg in tour.legs.values()), None)
    missed, wanted = (K[from_first].reshape(len(K[from_first]), -1) for K in (run.K - run.K_ref, run.K_ref))
    K_error = np.linalg.norm(missed, axis=1) / np.linalg.norm(wanted, axis=1)
    return Figures(rms, float(np.mean(moving)), _rms(K_error))


def _rms(error: Array) -> float:
    """Return the root mean square of `error` (M, …), of the worst joint, or `THROWN` if greater or not finite."""
    value = float(np.sqrt(np.mean(error**2, axis=0)).max())
    return min(value, THROWN) if value < inf else THROWN
