"""The closed loop is controller and plant against each other, sample by sample.

The plant starts at rest, in equilibrium at the reference's first point with the stiffness asked there, unless another
state is given: a reference that starts in motion has to be caught up with, and the errors of that count. Commands are
held over each sample (zero-order hold) while the plant is integrated in fine steps. Between sensors and controller
stands an observer, which makes a state and a disturbance torque of what is measured; the default one takes the
difference of the angles where the velocity is not measured, and nothing else.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.assumption import assumptions
from allocator.presentation.tables import html_table, number
from allocator.units import BAR, DEG
from mpc.model.experiment import Experiment
from mpc.model.plant import NU, NX, Plant
from mpc.observer.base import Differentiator, Observer
from mpc.tracking.plan import Moved, Plan
from mpc.trials.reference import Reference

T = TypeVar("T")


@runtime_checkable
class Controller(Protocol):
    """A controller has what `simulate` asks of it: dt, ahead, reset and step."""

    dt: float

    @property
    def ahead(self) -> int:
        """Return the samples of preview that it wants after the present one."""

    def reset(self) -> None:
        """Forget the past."""

    def step(self, x: Any, theta_ref: Any, K_ref: Any, d: float = 0.0) -> Plan:
        """Return the plan from the state `x` for the previews (ahead + 1,) under the disturbance torque `d` [N·m]."""


@runtime_checkable
class Process(Protocol):
    """A process has what `simulate` asks of a plant: `Plant` and `RealPlant` have it."""

    @property
    def nominal(self) -> Plant:
        """Return the plant without the effects that its model does not know."""

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the state (4,) to begin from."""

    def begin(self, dt: float, x0: Array, seed: int) -> Experiment:
        """Begin an experiment from `x0` (4,)."""

    def stiffness(self, x: Any) -> Any:
        """Return the true stiffness [N·m/rad] in the states `x` [4, ...], of the nominal plant's kind."""

    def forces(self, x: Any) -> tuple[Any, Any]:
        """Return the true muscle forces [N] in the states `x` [4, ...]."""


@dataclass(frozen=True, eq=False)
class Run:
    """A run is what happened in M steps; time runs along the first axis."""

    plant: Plant  # the nominal one
    dt: float  # [s]
    t: Array  # (M+1,) [s]
    x: Array  # (M+1, 4) true states
    estimate: Array  # (M, 5) what the controller was told: the state and the disturbance torque [N·m]
    u: Array  # (M, 2) commands, u[k] sent at t[k] [Pa]
    theta_ref: Array  # (M+1,) [rad]
    K_ref: Array  # (M+1,) [N·m/rad]
    K: Array  # (M+1,) stiffness of the plant [N·m/rad], isobaric unless the plant says another `frequency`
    forces: Array  # (M+1, 2) muscle forces [N]; negative: slack
    step_time: Array  # (M,) time that the controller took [s]; NaN where the whole loop was compiled
    rung: NDArray[np.int64]  # (M,) Rung
    status: NDArray[np.int64]  # (M,) PlanStatus
    slack: Array  # (M,) predicted excursion from the joint range [rad]
    slack_force: Array  # (M,) predicted lack of muscle force [N]
    moved: Array  # (M, 3) how far what was asked was moved, a `Moved` per sample; NaN from a controller that is silent
    implementation: str  # of the controller's step, "compiled" or "readable"; "" from a controller that has but one

    @property
    def theta(self) -> Array:
        """Return the joint angle (M+1,) [rad]."""
        return self.x[:, 0]

    @property
    def P(self) -> Array:
        """Return the pressures (M+1, 2) [Pa]."""
        return self.x[:, 2:]

    @property
    def assumed(self) -> str:
        """Sentence listing the assumptions behind the plant's forces that the data could not confirm, or ""."""
        return assumptions(self.plant.joint, self.theta, self.P[:, 0], self.P[:, 1])

    def to_dict(self) -> dict[str, NDArray[Any]]:
        """Return the run as columns (M+1,), those of the CSV that `track` writes: what `pandas.DataFrame` takes.

        Time in s, stiffness in N·m/rad, forces in N; the other names carry their units. The commands and rungs of a
        line hold until the next, the last line repeats them.
        """
        commands, rungs = np.vstack([self.u, self.u[-1:]]), np.append(self.rung, self.rung[-1:])
        return {
            "t": self.t,
            "theta_deg": self.theta / DEG,
            "theta_ref_deg": self.theta_ref / DEG,
            "omega_deg_per_s": self.x[:, 1] / DEG,
            "stiffness": self.K,
            "stiffness_ref": self.K_ref,
            "P1_bar": self.P[:, 0] / BAR,
            "P2_bar": self.P[:, 1] / BAR,
            "P1_command_bar": commands[:, 0] / BAR,
            "P2_command_bar": commands[:, 1] / BAR,
            "F1": self.forces[:, 0],
            "F2": self.forces[:, 1],
            "rung": rungs,
        }

    def __repr__(self) -> str:
        """Say how well the reference was followed, whether the limits were kept, and how long the controller took."""
        errors, *others = (f"{name} {value}" for name, value in self._figures().items())
        return f"Run of {self._length()}: {errors}, {others[0]}\n  " + "; ".join(others[1:])

    def _repr_html_(self) -> str:
        """Return how well the reference was followed as a table for notebooks."""
        return html_table(f"Run of {self._length()}", self._figures().items())

    def _length(self) -> str:
        return f"{self.u.shape[0]} steps, {number(self.t[-1] - self.t[0])} s in steps of {number(1e3 * self.dt)} ms"

    def _figures(self) -> dict[str, str]:
        from mpc.trials.metrics import metrics

        m = metrics(self)
        broken = [f"{name} by {number(by, 2)} {unit}" for name, (by, unit) in m.violations.items() if by]
        later = m.after_rest
        rested = {
            f"after the first rest of {number(m.rest)} s, angle error": _angle(later.theta_rms, later.theta_worst),
            "stiffness error then": _stiffness(later.K_rms, later.K_worst),
        }
        return {
            "angle error": _angle(m.theta_rms, m.theta_worst),
            "stiffness error": _stiffness(m.K_rms, m.K_worst),
            **(rested if m.rest else {}),
            "limits broken": ", ".join(broken) or "none",
            "steps answered by": ", ".join(f"{rung} {n}" for rung, n in m.rungs.items() if n),
            "time of a step": f"{number(m.step_median, 2)} ms median, {number(m.step_p99, 2)} ms for 99 %",
            **({"assumed": self.assumed} if self.assumed else {}),
        }


def _angle(rms: float, worst: float) -> str:
    return f"{number(rms, 2)}° RMS, {number(worst, 2)}° at worst"


def _stiffness(rms: float, worst: float) -> str:
    return f"{number(rms, 2)} % RMS, {number(worst, 2)} % at worst"


def simulate(
    plant: Process,
    controller: Controller,
    reference: Reference,
    *,
    x0: Any = None,
    observer: Observer | None = None,
    seed: int = 0,
    progress: bool = False,
) -> Run:
    """Let `controller` drive `plant` along `reference` from its first sample to its last; see the module's text."""
    loop = ClosedLoop(plant, controller, reference, x0, observer, seed)
    for k in tracked(range(loop.steps), loop.steps, progress):
        loop.sample(k)
    return loop.run()


class ClosedLoop:
    """A closed loop is a run under way: what takes part in it, and what happened in its `steps` samples so far."""

    def __init__(
        self,
        plant: Process,
        controller: Controller,
        reference: Reference,
        x0: Any,
        observer: Observer | None,
        seed: int,
    ) -> None:
        dt = controller.dt
        self.plant, self.controller, self.wanted = plant, controller, reference.resampled(dt)
        self.steps = steps = self.wanted.t.size - 1
        self.x, self.estimate = np.empty((steps + 1, NX)), np.empty((steps, NX + 1))
        first = float(self.wanted.theta[0]), float(self.wanted.K[0])
        self.x[0] = plant.at_rest(*first) if x0 is None else state(x0)
        self.u, self.took, self.slack = np.empty((steps, NU)), np.full(steps, np.nan), np.empty(steps)
        self.rung, self.status = np.empty(steps, int), np.empty(steps, int)
        self.slack_force, self.moved = np.empty(steps), np.full((steps, len(Moved._fields)), np.nan)
        self.experiment = plant.begin(dt, self.x[0], checks.count("seed", seed, least=0))
        self.observer = Differentiator(dt) if observer is None else observer
        self.observer.reset()
        controller.reset()

    def sample(self, k: int) -> None:
        """Go on by the sample `k`."""
        measured = self.experiment.measure()
        began = perf_counter()
        estimated, d = self.observer.estimate(measured, self.u[k - 1] if k else self.x[0, 2:])
        plan = self.controller.step(estimated, *self.wanted.preview(k, self.controller.ahead), d)
        self.took[k] = perf_counter() - began
        self.estimate[k] = *estimated, d
        self.u[k], self.rung[k], self.status[k], self.slack[k] = plan.u[0], plan.rung, plan.status, plan.slack
        self.slack_force[k] = plan.slack_force
        if plan.moved is not None:
            self.moved[k] = plan.moved
        self.experiment.advance(self.u[k])
        self.x[k + 1] = self.experiment.x

    def run(self) -> Run:
        """Return the run, when all samples are done."""
        plant, x, wanted = self.plant, self.x, self.wanted
        K, forces = plant.stiffness(x.T), np.stack(plant.forces(x.T), axis=1)
        return Run(
            plant.nominal, self.controller.dt, wanted.t, x, self.estimate, self.u, wanted.theta, wanted.K, K, forces,
            self.took, self.rung, self.status, self.slack, self.slack_force, self.moved,
            getattr(self.controller, "implementation", ""),
        )  # fmt: skip


def state(x0: Any) -> Array:
    """Return `x0` as a state (4,) to begin from. Raises `InvalidInput`."""
    x = np.asarray(x0, float)
    if x.shape != (NX,) or not np.isfinite(x).all():
        raise InvalidInput(f"x0 = {x0!r} has to be 4 finite numbers (theta [rad], omega [rad/s], P1 [Pa], P2 [Pa])")
    return x


def tracked(items: Iterable[T], total: int, progress: bool) -> Iterator[T]:
    """Yield the items, with a bar that counts them up to their `total`, if `progress` and there is a terminal."""
    if not progress:
        yield from items
        return
    from rich.console import Console
    from rich.progress import track

    console = Console(stderr=True)
    shown: Any = {"console": console, "transient": True, "disable": not console.is_terminal}
    yield from track(items, "simulating", total, **shown)
