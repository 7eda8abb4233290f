"""Results of many runs: arrays over runs, the figures of each, and whole runs if they were kept."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.presentation.tables import html_table, number
from mpc.tracking.plan import PlanStatus, Rung
from mpc.trials.metrics import Metrics, metrics
from mpc.trials.simulation import Run

STATUSES = tuple(PlanStatus)
_SPREAD = 5, 95  # [%] of the runs below the shown values


@dataclass(frozen=True, eq=False)
class Runs:
    """Results of n closed loops, along the first axis in the order of the request.

    `runs[i]` is the whole `Run`, if it was kept.
    """

    seeds: NDArray[np.int64]  # (n,) of the sensors' noise
    metrics: tuple[Metrics, ...]  # all figures of each run
    statuses: NDArray[np.int64]  # (n, 10) samples with each status, in the order of `PlanStatus`
    rungs: NDArray[np.int64]  # (n, 5) samples answered by each rung, in the order of `Rung`
    implementation: tuple[str, ...]  # of each loop, "compiled" or "readable"
    kept: tuple[Run, ...]  # the runs themselves; empty unless requested

    @classmethod
    def of(cls, seeds: Sequence[int], found: Sequence["Outcome"]) -> "Runs":
        """Return the runs with these `seeds` from their outcomes."""
        return cls(
            np.array(seeds),
            tuple(one.metrics for one in found),
            np.array([one.statuses for one in found]),
            np.array([one.rungs for one in found]),
            tuple(one.implementation for one in found),
            tuple(one.run for one in found if one.run is not None),
        )

    @property
    def theta_rms(self) -> Array:
        """RMS error of the angle (n,) [°]."""
        return self.column("theta_rms")

    @property
    def K_rms(self) -> Array:
        """RMS error of the stiffness (n,) [% of the reference]."""
        return self.column("K_rms")

    @property
    def limits_kept(self) -> Mask:
        """Whether all limits were kept (n,)."""
        return np.array([one.limits_kept for one in self.metrics])

    def column(self, name: str) -> Array:
        """Return a figure of all runs (n,): a field of `Metrics` by its name, or a limit's greatest excess.

        Names and units of limits are those of `Metrics.violations`; "after_rest.theta_rms" etc. are the errors after
        the first rest. Raises `InvalidInput` for other names.
        """
        rows = [_numbers(one) for one in self.metrics]
        if name not in rows[0]:
            raise InvalidInput(f"runs have no column {name!r}; they have {', '.join(rows[0])}")
        return np.array([row[name] for row in rows])

    def to_dict(self) -> dict[str, Array | NDArray[np.int64]]:
        """Return all figures as columns (n,), which pandas takes: seeds, errors, excesses, samples with each status."""
        rows = [_numbers(one) for one in self.metrics]
        counts = {f"status {status.name}": self.statuses[:, i] for i, status in enumerate(STATUSES)}
        return {"seed": self.seeds} | {name: np.array([row[name] for row in rows]) for name in rows[0]} | counts

    def __len__(self) -> int:
        return len(self.metrics)

    def __getitem__(self, i: int) -> Run:
        """Return a run. Raises `InvalidInput` if runs were not kept."""
        if not self.kept:
            raise InvalidInput(f"runs[{i}]: only figures were kept of these {len(self)} runs; say keep=True")
        return self.kept[i]

    def __repr__(self) -> str:
        """Return a summary of the errors and of the limits."""
        return f"{self._title()}: " + "; ".join(f"{name} {value}" for name, value in self._figures().items())

    def _repr_html_(self) -> str:
        """Return a summary of the errors as a table for notebooks."""
        return html_table(self._title(), self._figures().items())

    def _title(self) -> str:
        return f"{len(self)} run{'s' * (len(self) != 1)}"

    def _figures(self) -> dict[str, str]:
        broken, last = int((~self.limits_kept).sum()), self.statuses.sum(axis=0)
        said = [f"{status.name} {count}" for status, count in zip(STATUSES, last.tolist(), strict=True) if count]
        return {
            "RMS angle error": _spread(self.theta_rms, "°"),
            "RMS stiffness error": _spread(self.K_rms, " %"),
            "runs with a limit broken": str(broken),
            "steps": ", ".join(said),
        }


@dataclass(frozen=True)
class Outcome:
    """Stored results of one run."""

    metrics: Metrics
    statuses: NDArray[np.int64]  # (10,)
    rungs: NDArray[np.int64]  # (5,)
    implementation: str
    run: Run | None

    @classmethod
    def of(cls, run: Run, implementation: str, keep: bool) -> "Outcome":
        """Return the outcome of `run`, including the run if it is to be kept."""
        statuses = np.array([np.count_nonzero(run.status == status) for status in STATUSES])
        rungs = np.array([np.count_nonzero(run.rung == rung) for rung in Rung])
        return cls(metrics(run), statuses, rungs, implementation, run if keep else None)


def _numbers(of: Metrics) -> dict[str, float]:
    """Return the figures of a run by their names."""
    plain = {name: value for name, value in vars(of).items() if isinstance(value, float)}
    later = {f"after_rest.{name}": value for name, value in of.after_rest._asdict().items()}
    return plain | later | {name: excess for name, (excess, _) in of.violations.items()}


def _spread(values: Array, unit: str) -> str:
    low, high = np.percentile(values, _SPREAD)
    least, most = (f"{number(value, 3)}{unit}" for value in (low, high))
    return f"{number(np.median(values), 3)}{unit} in the median, {least} to {most} in 90 % of the runs"
