"""Metrics say how well a run of an arm went: errors, limits broken and by how much, time taken, rungs used."""

from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from mpc.arm.trials.simulation import ArmRun
from mpc.tracking.plan import Rung

_ROUNDING = 1e-9  # of the limit: less is arithmetic


@dataclass(frozen=True, eq=False)
class ArmMetrics:
    """Metrics are figures of a run, in the units they are read in; over all samples."""

    angle_rms: Array  # (n,) [°]
    angle_worst: Array  # (n,) [°]
    K_rms: Array  # (n, n) [N·m/rad]
    K_worst: Array  # (n, n) [N·m/rad]
    violations: dict[str, tuple[float, str]]  # limit: greatest excess (0 where it was kept), unit
    step_median: float  # [ms]
    step_p99: float  # [ms]
    rungs: dict[str, int]  # steps answered by each rung

    @property
    def limits_kept(self) -> bool:
        """Return whether no limit was broken."""
        return not any(excess for excess, _ in self.violations.values())


def arm_metrics(run: ArmRun) -> ArmMetrics:
    """Return the figures of `run`."""
    error, K = (run.q - run.q_ref) / DEG, run.K - run.K_ref
    names, counts = np.unique(run.rung, return_counts=True)
    median, p99 = 1e3 * np.quantile(run.step_time, (0.5, 0.99))
    return ArmMetrics(
        np.sqrt(np.mean(error**2, axis=0)),
        np.abs(error).max(axis=0),
        np.sqrt(np.mean(K**2, axis=0)),
        np.abs(K).max(axis=0),
        _violations(run),
        float(median),
        float(p99),
        {Rung(int(name)).name: int(count) for name, count in zip(names, counts, strict=True)},
    )


def _violations(run: ArmRun) -> dict[str, tuple[float, str]]:
    (low, high), (left, right) = run.arm.mechanism.pressure_limits, run.arm.angle_limits
    step = run.arm.slew * run.dt
    supply = max(float((low - run.u).max()), float((run.u - high).max()))
    slew = float(np.abs(np.diff(run.u, axis=0, prepend=run.P[:1])).max()) - step * (1 + _ROUNDING)
    ranges = max(float((left - run.q).max()), float((run.q - right).max()))
    return {
        "supply": (max(supply, 0.0) / BAR, "bar"),
        "slew of the commands": (max(slew, 0.0) / run.dt / BAR, "bar/s"),
        "joint ranges": (max(ranges, 0.0) / DEG, "°"),
        "taut muscles": (float(np.mean(run.forces <= 0.0)), "of the samples slack"),
    }
