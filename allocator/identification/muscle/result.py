"""Result of a muscle's fit."""

from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from allocator.calculus import Array, Mask
from allocator.identification.least_squares import rms
from allocator.identification.muscle.samples import Samples
from allocator.muscles import AffineMuscle, Muscle, Tondu2021
from allocator.presentation.tables import first_of, html_table, number

M_co = TypeVar("M_co", bound=Muscle, covariant=True)


class Level(NamedTuple):
    """Residuals F_model - F_measured of the taut samples in a range of pressures (one level if there are few)."""

    pressure: float  # mean [Pa]
    samples: int  # number of samples
    mean: float  # [N]
    rms: float  # [N]


class FileError(NamedTuple):
    """Residuals F_model - F_measured of the taut samples of one file."""

    name: str
    samples: int  # number of samples
    mean: float  # [N]
    rms: float  # [N]


@dataclass(frozen=True)
class Fit(Generic[M_co]):
    """Fitted muscle with its uncertainties. Errors are over the taut samples."""

    muscle: M_co  # carries its covariance
    samples: Samples  # those used; `samples.dropped` counts those left out by reason
    slack: Mask  # (n,) samples treated as inequalities F ≤ 0, not distinguishable from zero
    free: tuple[str, ...]  # names of the fitted parameters
    rank: int  # number of combinations of them that the samples determine
    rms: float  # [N]
    max_error: float  # greatest |F_model - F_measured| [N]
    cross_validated: float  # RMS error [N], weighted as the fit, of left-out samples; NaN if not requested
    levels: tuple[Level, ...]
    collinear: tuple[str, ...]  # changes of parameters that change no force
    monotone: bool  # [M] holds on the taut domain of the data
    warnings: tuple[str, ...]

    @property
    def model(self) -> str:
        """Return the name of the model."""
        return type(self.muscle).__name__

    @property
    def covariance(self) -> Array:
        """Return the covariance of all parameters (m, m) in the order of `muscle.parameters`; 0 for held ones."""
        return np.array(self.muscle.covariance)

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Return the standard deviation of every parameter, of its determined part if it is collinear with others."""
        return dict(zip(self.muscle.parameters, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    @property
    def rms_percent(self) -> float:
        """Return the RMS error in percent of full scale, the greatest force measured."""
        return 100 * self.rms / self.samples.full_scale

    @property
    def max_error_percent(self) -> float:
        """Return the greatest error in percent of full scale."""
        return 100 * self.max_error / self.samples.full_scale

    @property
    def closed_form(self) -> bool:
        """Return whether a joint with this muscle has a closed-form inverse."""
        return has_closed_form_inverse(self.muscle)

    @property
    def n_taut(self) -> int:
        """Return the number of samples that are equations."""
        return int((~self.slack).sum())

    @property
    def files(self) -> tuple[FileError, ...]:
        """Return the errors of each file; empty for a single file."""
        if self.samples.file is None:
            return ()
        error = self.residuals()
        taut = [(name, error[~self.slack & (self.samples.file == i)]) for i, name in enumerate(self.samples.files)]
        return tuple(FileError(name, e.size, float(e.mean()), rms(e)) for name, e in taut if e.size)

    def residuals(self) -> Array:
        """Return F_model - F_measured (n,) [N]; if model and muscle are slack, the cell's reading alone."""
        F = self.muscle.law(self.samples.pressure, self.samples.contraction)
        return self.samples.residual(F, self.slack)

    def to_dict(self) -> dict[str, object]:
        """Return the fit in one row of a table, ``pandas.DataFrame([f.to_dict() for f in fits])``.

        Parameters are in SI units.
        """
        return {
            "model": self.model,
            "taut_samples": self.n_taut,
            "slack_samples": self.samples.n - self.n_taut,
            "rms_error_N": self.rms,
            "rms_error_percent": self.rms_percent,
            "max_error_N": self.max_error,
            "cross_validated_N": self.cross_validated,
            "parameters_fitted": len(self.free),
            "parameters_determined": self.rank,
            "monotone": self.monotone,
            "closed_form_inverse": self.closed_form,
            **self.muscle.parameters,
            **{f"{name}_std": std for name, std in self.standard_deviations.items()},
        }

    def __repr__(self) -> str:
        """Return the errors of the law and the first warning."""
        return f"Fit of {self.model}: {self._errors()}\n  {self._counts()}" + first_of(self.warnings)

    def _repr_html_(self) -> str:
        """Return the errors of the fit for notebooks, and a table of parameters (SI units) and standard deviations."""
        std, muscle = self.standard_deviations, self.muscle.parameters
        rows = [(name, f"{value:.5g}", f"{std[name]:.2g}") for name, value in muscle.items()]
        return html_table(f"{self.model}: {self._errors()}; {self._counts()}", rows, ("parameter", "value", "± std"))

    def _errors(self) -> str:
        unseen = "" if np.isnan(self.cross_validated) else f", {number(self.cross_validated)} N cross-validated"
        return (
            f"RMS {number(self.rms)} N ({number(self.rms_percent, 2)} % of full scale){unseen}, "
            f"greatest {number(self.max_error)} N"
        )

    def _counts(self) -> str:
        return (
            f"{self.n_taut} taut and {self.samples.n - self.n_taut} slack samples determine {self.rank} of "
            f"{len(self.free)} parameters"
        )

    def save(self, path: str | PathLike[str], source: Mapping[str, str | float] | None = None) -> None:
        """Write the muscle with its covariance as TOML, noting the errors of the fit."""
        noted = {"taut_samples": self.n_taut, "rms_error_N": round(self.rms, 4), **(source or {})}
        self.muscle.save(path, noted)


def has_closed_form_inverse(muscle: Muscle) -> bool:
    """Return whether (T, K) → (P1, P2) is in closed form: affine muscles that stiffen with pressure, and Tondu2021."""
    return isinstance(muscle, AffineMuscle | Tondu2021) and not muscle.limitation
