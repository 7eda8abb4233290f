"""Metrics of a run: errors, violations of limits, step times, rungs."""

from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np

from allocator.calculus import Array
from allocator.presentation.tables import number, span
from allocator.units import BAR, DEG, PERCENT
from mpc.tracking.limits import Limits
from mpc.tracking.plan import Moved, PlanStatus, Rung
from mpc.trials.simulation import Run

Figure: TypeAlias = Any  # a number for a joint, an array for an arm

_ROUNDING = 1e-9  # [-] of the limit, or of a constant value: less is rounding
_NEGLIGIBLE = 1e-6  # in the unit of a figure: less is not shown
_SHORTEST_REST = 0.1  # [s]: a smooth motion seems to rest in its first samples
_AT_LIMIT = 1e-3  # [-] of the slew limit: commands this near count as at the limit, for QP solvers that stop inside


class Errors(NamedTuple):
    """Errors of angle and stiffness against their references."""

    theta_rms: Figure  # [°], (n,) of an arm
    theta_worst: Figure  # [°]
    K_rms: Figure  # [`K_unit`], (k, k) of an arm
    K_worst: Figure  # [`K_unit`]


@dataclass(frozen=True)
class Metrics:
    """Figures of a run over all samples, in degrees, percent and ms.

    A reference that begins with a rest gives a controller time to identify the error of its model; `after_rest` are the
    errors from the last sample on at which angle and stiffness were still those of the first one. A reference that
    begins in motion, within a tenth of a second, or never moves has no first rest: then they are the errors over all
    samples.
    """

    theta_rms: Figure  # [°], (n,) of an arm
    theta_worst: Figure  # [°]
    K_rms: Figure  # [`K_unit`], (k, k) of an arm
    K_worst: Figure  # [`K_unit`]
    K_unit: str  # "%" of a joint's reference; of an arm's entries, which may be 0, "N·m/rad" or "N/m"
    rest: float  # [s], duration of the first rest
    after_rest: Errors
    violations: dict[str, tuple[float, str]]  # limit: greatest excess (0 if it was kept), unit
    step_median: float  # [ms]
    step_p99: float  # [ms]
    rungs: dict[str, int]  # steps by each rung; REST: by constant commands, with the joint at its reference
    out_of_reach: float  # [% of the samples] whose reference no controller can follow
    at_slew_limit: float  # [% of the samples] at which a command changed at the slew limit
    moved: dict[str, tuple[float, str]]  # by reference: greatest move by the controller (NaN: unreported), unit

    @property
    def limits_kept(self) -> bool:
        """Whether all limits were kept."""
        return not any(excess for excess, _ in self.violations.values())

    def __repr__(self) -> str:
        """Return the errors, the exceeded limits, the moved references and the steps, one line each."""
        lines = [f"Metrics: {_in_words(self, self.K_unit)}"]
        if self.rest:
            lines.append(f"after the first {self.rest:.3g} s of rest: {_in_words(self.after_rest, self.K_unit)}")
        exceeded = _listed(self.violations)
        lines.append(f"limits exceeded: {exceeded}" if exceeded else "limits kept")
        if moved := _listed(self.moved):
            lines.append(f"references moved: {moved}")
        if self.out_of_reach or self.at_slew_limit:
            slew = f"commands at the slew limit in {self.at_slew_limit:.3g} %"
            lines.append(f"references out of reach in {self.out_of_reach:.3g} % of the samples, {slew}")
        rungs = ", ".join(f"{count} {rung}" for rung, count in self.rungs.items() if count)
        lines.append(f"steps: {rungs}; {self.step_median:.3g} ms in the median, {self.step_p99:.3g} ms in 99 %")
        return "\n  ".join(lines)


def metrics(run: Run) -> Metrics:
    """Return the figures of `run`."""
    moves = _rested(run)
    return Metrics(
        **_errors(run, 0)._asdict(),
        K_unit="%" if run.K.ndim == 1 else run.plant.stiffness_unit,
        rest=moves * run.dt,
        after_rest=_errors(run, moves),
        violations=_violations(run),
        step_median=float(np.median(run.step_time)) * 1e3,
        step_p99=float(np.percentile(run.step_time, 99)) * 1e3,
        rungs=_rungs(run),
        out_of_reach=out_of_reach(run.plant, run.theta_ref, run.K_ref, run.dt),
        at_slew_limit=float(np.mean((_changes(run) >= (1 - _AT_LIMIT) * run.plant.slew * run.dt).any(axis=1)))
        / PERCENT,
        moved=_moved(run),
    )


def out_of_reach(plant: Any, theta_ref: Array, K_ref: Array, dt: float) -> float:
    """Return the share [%] of a reference every `dt` [s] at which no pressures give its stiffness and the torque of its
    motion: angles (M,) or (M, n) [rad] and stiffnesses of a `Plant` or an `Arm`.
    """
    omega = np.gradient(theta_ref, dt, axis=0)
    T = plant.torque_for(theta_ref, omega, np.gradient(omega, dt, axis=0))
    return float(np.mean(~np.asarray(plant.reachable(theta_ref, K_ref, T)))) / PERCENT


def _in_words(errors: Errors | Metrics, K_unit: str) -> str:
    """Return the errors in words; of an arm, the least and greatest of its joints and entries."""
    figures = errors.theta_rms, errors.theta_worst, errors.K_rms, errors.K_worst
    shown = [span(figure, digits=3) if np.ndim(figure) else number(figure, 3) for figure in figures]
    return f"angle {shown[0]}° RMS, {shown[1]}° worst; stiffness {shown[2]} {K_unit} RMS, {shown[3]} {K_unit} worst"


def _listed(figures: dict[str, tuple[float, str]]) -> str:
    """Return the figures above 0, with their units."""
    told = {name: (f"{value:.3g}", unit) for name, (value, unit) in figures.items() if value > _NEGLIGIBLE}
    return ", ".join(f"{name} by {value}{'' if unit == '°' else ' '}{unit}" for name, (value, unit) in told.items())


def errors_of(theta: Array, theta_ref: Array, K: Array, K_ref: Array) -> Errors:
    """Return the errors of angles (M,) or (M, n) [rad] and stiffnesses (M,) [N·m/rad] or (M, k, k) of the plant's unit.

    Masked samples do not count; a figure of masked samples only is NaN.
    """
    K_error = (K / K_ref - 1) / PERCENT if K.ndim == 1 else K - K_ref
    figures = (*_rms_and_worst((theta - theta_ref) / DEG), *_rms_and_worst(K_error))
    return Errors(*(float(figure) if figure.ndim == 0 else figure for figure in figures))


def _errors(run: Run, begin: int) -> Errors:
    """Return the errors from the sample `begin` on."""
    return errors_of(*(quantity[begin:] for quantity in (run.theta, run.theta_ref, run.K, run.K_ref)))


def _rested(run: Run) -> int:
    """Return the last sample of the first rest of the reference, of a tenth of a second or more; 0 if there is none."""
    moved = np.zeros(run.t.size, bool)
    for wanted in (run.theta_ref, run.K_ref):
        away = np.abs(wanted - wanted[0]) > _ROUNDING * np.abs(wanted).max()
        moved |= away.reshape(run.t.size, -1).any(axis=1)
    last = int(np.argmax(moved)) - 1
    return last if last * run.dt >= _SHORTEST_REST else 0


def _rungs(run: Run) -> dict[str, int]:
    """Return the number of steps by each rung, with an own entry for the rest mode."""
    resting = run.status == PlanStatus.RESTING
    counts = {rung.name: int(((run.rung == rung) & ~resting).sum()) for rung in Rung}
    return counts | ({"REST": int(resting.sum())} if resting.any() else {})


def _moved(run: Run) -> dict[str, tuple[float, str]]:
    worst, unit = Moved(*run.moved.max(axis=0).tolist()), run.plant.stiffness_unit
    return {"angle": (worst.theta / DEG, "°"), "stiffness": (worst.K, unit), "torque": (worst.T, "N·m")}


def _violations(run: Run) -> dict[str, tuple[float, str]]:
    plant, allowed = run.plant, run.plant.slew * run.dt
    (low, high), (left, right) = plant.pressure_limits, plant.angle_limits
    return {
        "commanded pressure": (_excess(run.u, low, high, high) / BAR, "bar"),
        "pressure": (_excess(run.P, low, high, high) / BAR, "bar"),
        "pressure slew": (_excess(_changes(run), 0.0, allowed, allowed) / run.dt / BAR, "bar/s"),
        "joint range": (_excess(run.theta, left, right, right - left) / DEG, "°"),
        "slack muscle": (max(0.0, -float(run.forces.min())), "N"),
    }


def _changes(run: Run) -> Array:
    """Return the change (M, m) [Pa] of each command from the previous one; of the first, from the measured pressures,
    made `Limits.commandable`.
    """
    plant, n, m = run.plant, run.plant.n, run.plant.m
    limits = Limits(plant.pressure_limits, plant.slew * run.dt, plant.angle_limits, 0.0)
    return np.abs(np.diff(run.u, axis=0, prepend=limits.commandable(run.estimate[:1, 2 * n : 2 * n + m])))


def _excess(values: Array, low: float | Array, high: float | Array, scale: float | Array) -> float:
    """Return the greatest excess of `values` over [low, high]; 0 within rounding."""
    excess = float(max((low - values).max(), (values - high).max()))
    return excess if excess > _ROUNDING * np.max(scale) else 0.0


def _rms_and_worst(error: Array) -> tuple[Array, Array]:
    """Return both (…) of errors (M, …)."""
    rms, worst = np.sqrt(np.mean(error**2, axis=0)), np.abs(error).max(axis=0)
    return np.ma.filled(rms, np.nan), np.ma.filled(worst, np.nan)
