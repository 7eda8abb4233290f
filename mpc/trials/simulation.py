"""Closed-loop simulation of controller and plant, sample by sample, for a joint or an arm.

By default the plant starts at rest, in equilibrium at the reference's first point with the stiffness there. If the
reference starts in motion, the controller has to catch up, and these errors count. Commands are held over each sample
(zero-order hold) while the plant is integrated in fine steps. An observer between sensors and controller estimates the
state and a disturbance torque from the readings; the default one only differentiates the angles if the velocity is not
measured.
"""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any, Protocol, TypeAlias, TypeVar, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.joint.felt import Loop
from allocator.presentation.progress import counted
from allocator.presentation.tables import html_table, number
from allocator.units import BAR, DEG
from mpc.model.experiment import Experiment
from mpc.model.machine import Machine
from mpc.model.plant import NX, Plant
from mpc.observer.base import Differentiator, Observer, check_observer
from mpc.tracking.plan import Moved, Plan
from mpc.trials.motions.reference import Reference

T = TypeVar("T")
Load: TypeAlias = Callable[[float], ArrayLike]  # time [s] ↦ external torque [N·m], (n,) for an arm


@runtime_checkable
class Controller(Protocol):
    """Interface of controllers for `simulate`: dt, ahead, reset and step."""

    dt: float

    @property
    def ahead(self) -> int:
        """Samples of preview after the present one."""

    def reset(self) -> None:
        """Forget the past samples."""

    def step(self, x: ArrayLike, theta_ref: ArrayLike, K_ref: ArrayLike, d: ArrayLike = 0.0) -> Plan:
        """Return the plan from the state `x` for the previews (ahead + 1, …) under the disturbance torque `d` [N·m]."""


@runtime_checkable
class Process(Protocol):
    """Interface of plants for `simulate`, of `Plant`, `RealPlant`, `Arm` and `MujocoPlant`."""

    @property
    def nominal(self) -> Machine:
        """Plant without unmodelled effects."""

    def at_rest(self, theta: Any, K: Any) -> Array:
        """Return the initial state (2n + m,)."""

    def begin(self, dt: float, x0: Array, seed: int) -> Experiment:
        """Begin an experiment from `x0` (2n + m,)."""

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the true stiffness (M, …), of the nominal plant's kind, and muscle forces (M, m) [N] in the states `x`
        (M, 2n + m).
        """


@dataclass(frozen=True, eq=False)
class Run:
    """Record of M closed-loop steps; time is the first axis."""

    plant: Any  # the nominal one, a `Plant` or an `Arm`
    dt: float  # [s]
    t: Array  # (M+1,) [s]
    x: Array  # (M+1, 2n + m) true states
    estimate: Array  # (M, 3n + m) inputs of the controller: the state and the disturbance torque [N·m]
    u: Array  # (M, m) commands, u[k] sent at t[k] [Pa]
    theta_ref: Array  # (M+1,) [rad], (M+1, n) for an arm
    K_ref: Array  # (M+1,) [N·m/rad], tracked (M+1, k, k) for an arm: of the joints, or of the endpoint [N/m]
    K: Array  # (M+1, …) stiffness of the plant like K_ref, isobaric unless the plant has another `frequency`
    forces: Array  # (M+1, m) muscle forces [N]; negative: slack
    step_time: Array  # (M,) duration of the controller's step [s]; NaN if the whole loop was compiled
    rung: NDArray[np.int64]  # (M,) Rung
    status: NDArray[np.int64]  # (M,) PlanStatus
    slack: Array  # (M,) predicted excursion from the joint range [rad]
    slack_force: Array  # (M,) predicted lack of muscle force [N]
    moved: Array  # (M, 3) distances by which the references were moved, a `Moved` per sample; NaN if unreported
    implementation: str  # of the controller's step, "compiled" or "readable"; "" for a controller with only one

    @property
    def theta(self) -> Array:
        """Joint angle (M+1,) [rad], (M+1, n) for an arm."""
        return np.asarray(self.plant.angles(self.x))

    @property
    def P(self) -> Array:
        """Pressures (M+1, m) [Pa]."""
        return self.x[:, 2 * self.plant.n :]

    def felt(self, amplitude: float, loop: Loop | None = None) -> Array:
        """Return the stiffness (M+1,) [N·m/rad] against pushes by ±`amplitude` [rad]   (S3)

        It is `K` plus the secant of the hysteresis `loop`, by default that of the joint in the controller's model,
        under the load of the muscles. Raises `InvalidInput` for an arm, whose joints have no hysteresis, and without an
        amplitude.
        """
        if not isinstance(self.plant, Plant):
            raise InvalidInput("a felt stiffness is that of a single joint; an arm has no hysteresis of its own")
        secant = (self.plant.joint.loop if loop is None else loop).secant(amplitude)
        x = self.x.T
        return np.asarray(self.K + secant.added(self.plant.isobaric(x), self.plant.pull(x), x[2] + x[3]))

    @property
    def assumed(self) -> str:
        """Sentence listing the assumptions behind the plant's forces that the data could not confirm, or ""."""
        return str(self.plant.assumed(self.x))

    def to_dict(self) -> dict[str, Array | NDArray[np.int64]]:
        """Return the run as columns (M+1,), those of the CSV of `track`, for `pandas.DataFrame`.

        Time in s, stiffness in N·m/rad, of an endpoint in N/m, forces in N; the other names carry their units. The
        commands and rungs of a line hold until the next, the last line repeats them.
        """
        names, n = self.plant.labels, self.plant.n
        entries = np.triu_indices(self.K.shape[-1]) if self.K.ndim > 1 else None
        K, K_ref = (a[:, None] if entries is None else a[:, *entries] for a in (self.K, self.K_ref))
        rows = np.size(self.theta[0])
        kinds = [
            ([f"{name}_deg" for name in names.angles], self.theta.reshape(-1, rows) / DEG),
            ([f"{name}_ref_deg" for name in names.angles], self.theta_ref.reshape(-1, rows) / DEG),
            ([f"{name}_deg_per_s" for name in names.speeds], self.x[:, n : 2 * n] / DEG),
            (names.stiffness, K),
            ([f"{name}_ref" for name in names.stiffness], K_ref),
            ([f"{name}_bar" for name in names.pressures], self.P / BAR),
            ([f"{name}_command_bar" for name in names.pressures], np.vstack([self.u, self.u[-1:]]) / BAR),
            (names.forces, self.forces),
        ]
        columns = {name.replace(" ", "_"): a[:, i] for named, a in kinds for i, name in enumerate(named)}
        return {"t": self.t, **columns, "rung": np.append(self.rung, self.rung[-1:])}

    def __repr__(self) -> str:
        """Return a summary of the errors, the limits and the durations of steps."""
        errors, *others = (f"{name} {value}" for name, value in self._figures().items())
        return f"Run of {self._length()}: {errors}, {others[0]}\n  " + "; ".join(others[1:])

    def _repr_html_(self) -> str:
        """Return a summary of the errors as a table for notebooks."""
        return html_table(f"Run of {self._length()}", self._figures().items())

    def _length(self) -> str:
        return f"{self.u.shape[0]} steps, {number(self.t[-1] - self.t[0])} s in steps of {number(1e3 * self.dt)} ms"

    def _figures(self) -> dict[str, str]:
        from mpc.trials.metrics import metrics

        m = metrics(self)
        broken = [f"{name} by {number(by, 2)} {unit}" for name, (by, unit) in m.violations.items() if by]
        later = m.after_rest
        unit = m.K_unit
        rested = {
            f"after the first rest of {number(m.rest)} s, angle error": _worst(later.theta_rms, later.theta_worst, "°"),
            "stiffness error then": _worst(later.K_rms, later.K_worst, f" {unit}"),
        }
        return {
            "angle error": _worst(m.theta_rms, m.theta_worst, "°"),
            "stiffness error": _worst(m.K_rms, m.K_worst, f" {unit}"),
            **(rested if m.rest else {}),
            "limits broken": ", ".join(broken) or "none",
            "steps answered by": ", ".join(f"{rung} {n}" for rung, n in m.rungs.items() if n),
            "time of a step": f"{number(m.step_median, 2)} ms median, {number(m.step_p99, 2)} ms for 99 %",
            **({"assumed": self.assumed} if self.assumed else {}),
        }


def _worst(rms: ArrayLike, worst: ArrayLike, unit: str) -> str:
    """Return the errors of a joint, or the greatest of an arm, in words."""
    return f"{number(np.max(rms), 2)}{unit} RMS, {number(np.max(worst), 2)}{unit} at worst"


def simulate(
    plant: Process,
    controller: Controller,
    reference: Reference,
    *,
    x0: ArrayLike | None = None,
    observer: Observer | None = None,
    seed: int = 0,
    progress: bool = False,
    load: Load | None = None,
    watch: Callable[[], None] | None = None,
) -> Run:
    """Simulate `plant` under `controller` along `reference` from its first to its last sample, see the module's
    docstring.

    `load(t)` is an unmodelled external torque [N·m], (n,) for an arm; `watch` is called after every sample.
    """
    if not (watch is None or callable(watch)):
        raise InvalidInput(f"watch = {checks.brief(watch)} has to be a function or None")
    loop = ClosedLoop(plant, controller, reference, x0, observer, seed, load)
    steps = range(loop.steps)
    for k in counted(steps, "simulating") if progress else steps:
        loop.sample(k)
        if watch is not None:
            watch()
    return loop.run()


def in_motion(plant: Machine, reference: Reference) -> Array:
    """Return the state (2n + m,) of `plant` at the beginning of `reference`, including its motion, as an `x0`."""
    from scipy.interpolate import CubicSpline

    motion, begin = CubicSpline(reference.t, reference.theta), reference.t[:1]
    theta, omega, alpha = (motion(begin, order) for order in range(3))
    held = plant.held(theta, reference.K[:1], plant.torque_for(theta, omega, alpha), 0.0)
    return np.concatenate([theta.ravel(), omega.ravel(), held.P[0]])


class ClosedLoop:
    """Simulation in progress: its parts, and the record of its `steps` samples so far."""

    def __init__(
        self,
        plant: Process,
        controller: Controller,
        reference: Reference,
        x0: ArrayLike | None,
        observer: Observer | None,
        seed: int,
        load: Load | None = None,
    ) -> None:
        _check_process(plant, load)
        check_parts(plant.nominal, controller, reference)
        if observer is not None:
            check_observer(observer, controller.dt)
        dt, nominal = controller.dt, plant.nominal
        self.plant, self.controller, self.wanted, self._load = plant, controller, reference.resampled(dt), load
        self.steps = steps = self.wanted.samples(dt)
        self.size, n, m = nominal.size, nominal.n, nominal.m
        self.x, self.estimate = np.empty((steps + 1, self.size)), np.empty((steps, self.size + n))
        first = self.wanted.theta[0], self.wanted.K[0]
        self.x[0] = plant.at_rest(*first) if x0 is None else state(x0, self.size, n)
        self.u, self.took, self.slack = np.empty((steps, m)), np.full(steps, np.nan), np.empty(steps)
        self.rung, self.status = np.empty(steps, int), np.empty(steps, int)
        self.slack_force, self.moved = np.empty(steps), np.full((steps, len(Moved._fields)), np.nan)
        self.experiment = plant.begin(dt, self.x[0], checks.count("seed", seed, least=0))
        self.observer = Differentiator(dt, n) if observer is None else observer
        self.observer.reset()
        controller.reset()

    def sample(self, k: int) -> None:
        """Simulate the sample `k`."""
        measured = self.experiment.measure()
        began = perf_counter()
        estimated, d = self.observer.estimate(measured, self.u[k - 1] if k else self.x[0, -self.u.shape[1] :])
        plan = self.controller.step(estimated, *self.wanted.preview(k, self.controller.ahead), d)
        self.took[k] = perf_counter() - began
        self.estimate[k, : self.size], self.estimate[k, self.size :] = estimated, d
        self.u[k], self.rung[k], self.status[k], self.slack[k] = plan.u[0], plan.rung, plan.status, plan.slack
        self.slack_force[k] = plan.slack_force
        if plan.moved is not None:
            self.moved[k] = plan.moved
        if self._load is None:
            self.experiment.advance(self.u[k])
        else:
            self.experiment.advance(self.u[k], self._torque(k * self.controller.dt))
        self.x[k + 1] = self.experiment.x

    def _torque(self, t: float) -> Array:
        """Return the load at `t` [s]. Raises `InvalidInput` unless it is numeric, with one entry per joint."""
        assert self._load is not None
        torque, shape = checks.real(f"load({t:g})", self._load(t), "N·m"), self.plant.nominal.angle_shape
        if torque.shape not in ((), shape):
            each = f", or n = {shape[0]} of them" if shape else ""
            raise InvalidInput(f"load({t:g}) has the shape {torque.shape}; give one torque [N·m]{each}")
        return torque

    def run(self) -> Run:
        """Return the run after all samples."""
        plant, x, wanted, all_of = self.plant, self.x, self.wanted, slice(self.steps + 1)
        K, forces = plant.along(x)
        t, theta, K_ref = wanted.t[all_of], wanted.theta[all_of], wanted.K[all_of]
        return Run(
            plant.nominal, self.controller.dt, t, x, self.estimate, self.u, theta, K_ref, K, forces,
            self.took, self.rung, self.status, self.slack, self.slack_force, self.moved,
            getattr(self.controller, "implementation", ""),
        )  # fmt: skip


def _check_process(plant: Process, load: Load | None) -> None:
    checks.instance("plant", plant, Process, "a Plant, a RealPlant, an Arm or a MujocoPlant")
    if load is not None and not callable(load):
        raise InvalidInput(f"load = {checks.brief(load)} has to be a function of the time [s] or None")


def check_parts(machine: Machine, controller: Controller, reference: Reference) -> None:
    """Raise `InvalidInput` unless `controller` and `reference` are parts of a loop that controls `machine`."""
    checks.instance("controller", controller, Controller, "a controller, such as a TrackingMPC")
    checks.instance("reference", reference, Reference, "a Reference")
    n, pair = machine.n, isinstance(machine, Plant)
    if reference.theta.shape[1:] != (() if pair else (n,)):
        wanted_shape = "(M,)" if pair else f"(M, {n})"
        raise InvalidInput(f"reference: theta has the shape {reference.theta.shape}; this plant takes {wanted_shape}")


def state(x0: ArrayLike, size: int = NX, n: int = 1) -> Array:
    """Return `x0` as an initial state (size,) of `n` joints. Raises `InvalidInput`."""
    x = checks.floats("x0", x0, "rad, rad/s, Pa")
    if x.shape != (size,) or not np.isfinite(x).all():
        parts = "theta [rad], omega [rad/s], P1 [Pa], P2 [Pa]" if size == NX else "angles, velocities, pressures"
        raise InvalidInput(f"x0 = {checks.brief(x0)} has to be {size} finite numbers ({parts})")
    checks.angle("angles of x0: q", x[:n])
    checks.pressure("pressures of x0: P", x[2 * n :])
    return x
