"""All models are compared side by side on the same samples.

The law of some models ends where a muscle is stretched, and such a model leaves those samples out. Each model is fitted
to all it takes, but all are judged alike: by cross-validation within the samples that every model takes, in the same
parts. A model that leaves out more than a tenth of the samples is never called the best if another does not.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from allocator import checks
from allocator.errors import InvalidInput
from allocator.identification.muscle.fit import build_problem, conclude, prepared
from allocator.identification.muscle.result import Fit
from allocator.identification.muscle.samples import Samples
from allocator.muscles import MODELS, Muscle
from allocator.muscles.recipe import among

_MOST_LEFT_OUT = 0.1  # of the samples, by the best model


@dataclass(frozen=True)
class Ranking:
    """A ranking holds fits from the best to the worst error on the same samples, and why other models have none."""

    fits: tuple[Fit[Muscle], ...]
    failures: Mapping[str, str]  # model name → sentence
    samples: int  # how many there are to fit
    judged: int  # how many of them all models take, on which they are judged

    @property
    def best(self) -> Fit[Muscle] | None:
        """Return the best of those that keep [M] and have a closed-form inverse; else that keep [M]; else of all.

        Only those are considered that leave out at most a tenth of the samples, if there are any.
        """
        wide = [f for f in self.fits if f.samples.n >= (1 - _MOST_LEFT_OUT) * self.samples] or self.fits
        kept = [f for f in wide if f.monotone]
        choice = [f for f in kept if f.closed_form] or kept or wide
        return choice[0] if choice else None


def rank_models(
    samples: Samples,
    models: Iterable[type[Muscle]] = tuple(MODELS.values()),
    *,
    hold: Mapping[str, float] | None = None,
    folds: int = 5,
    taut_only: bool = True,
    progress: Callable[[Iterable[type[Muscle]]], Iterable[type[Muscle]]] = lambda models: models,
    **options: Any,
) -> Ranking:
    """Fit every model to `samples`; `hold` applies where a model has the parameter, `options` are those of `prepared`.

    Raises `InvalidInput` if no samples are left, and for a parameter to hold that no model has.
    """
    models = tuple(models)
    _check_held(models, hold or {})
    samples = prepared(samples, taut_only=taut_only, **options)
    built, failures = {}, {}
    for model in models:
        try:
            built[model] = build_problem(model, samples, _held(model, hold or {}), taut_only=taut_only)
        except InvalidInput as error:
            failures[model.__name__] = str(error)
    common = np.logical_and.reduce([np.ones(samples.n, bool), *(p.takes for p in built.values())])
    fits = []
    for model in progress(models):
        if model not in built:
            continue
        problem, starts, takes = built[model]
        try:
            fits.append(conclude(model, problem, folds, starts, common[takes]))
        except InvalidInput as error:
            failures[model.__name__] = str(error)
    return Ranking(_sorted(fits, samples.where(common)), failures, samples.n, int(common.sum()))


def _check_held(models: Iterable[type[Muscle]], hold: Mapping[str, float]) -> None:
    known = {name: None for model in models for name in model.parameter_fields()}
    for name, value in hold.items():
        if not among(name, known):
            raise InvalidInput(f"hold: there is no parameter {name!r} to hold; there are {', '.join(known)}")
        checks.real(f"hold: {name}", value, "SI units")


def _held(model: type[Muscle], hold: Mapping[str, float]) -> dict[str, float]:
    return {name: value for name, value in hold.items() if among(name, model.parameter_fields())}


def _sorted(fits: list[Fit[Muscle]], common: Samples) -> tuple[Fit[Muscle], ...]:
    """Sort by cross-validated errors; by the errors at the `common` samples if any fit has no cross-validated one."""
    errors = np.array([fit.cross_validated for fit in fits])
    if np.isnan(errors).any():
        errors = np.array([_error(fit.muscle, common) for fit in fits])
    return tuple(fits[i] for i in np.argsort(errors, kind="stable"))


def _error(muscle: Muscle, samples: Samples) -> float:
    error = muscle.law(samples.pressure, samples.contraction) - samples.force
    return float(samples.weights @ np.where(samples.slack, 0.0, error) ** 2)
