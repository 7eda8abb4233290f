"""All models are compared side by side on the same samples.

The law of some models ends where a muscle is stretched, and such a model leaves those samples out. Each model is fitted
to all it takes, but all are judged alike: by cross-validation within the samples that every model takes, in the same
parts. A model that leaves out more than a tenth of the samples is never called the best if another does not.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from allocator import checks
from allocator.errors import InvalidInput
from allocator.identification.muscle.fit import EVERYTHING, Range, build_problem, conclude, prepared
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
    pressure_range: Range = EVERYTHING,
    contraction_range: Range = EVERYTHING,
    zero_noise: float | None = None,
    progress: Callable[[Iterable[type[Muscle]]], Iterable[type[Muscle]]] = lambda models: models,
) -> Ranking:
    """Fit every model to `samples`; `hold` applies where a model has the parameter, other options are those of `fit`.

    Raises `InvalidInput` if no samples are left, and for a parameter to hold that no model has.
    """
    models = tuple(models)
    _check_held(models, hold or {})
    samples = prepared(samples, pressure_range, contraction_range, zero_noise, taut_only=taut_only)
    built, failures = {}, {}
    for model in models:
        held = {name: value for name, value in (hold or {}).items() if among(name, model.parameter_fields())}
        try:
            built[model] = build_problem(model, samples, held, taut_only=taut_only)
        except InvalidInput as error:
            failures[model.__name__] = str(error)
    common = np.logical_and.reduce([np.ones(samples.n, bool), *(takes for *_, takes in built.values())])
    fits = []
    for model in progress(models):
        if model not in built:
            continue
        problem, starts, takes = built[model]
        try:
            fits.append(conclude(model, problem, folds, starts, common[takes]))
        except InvalidInput as error:
            failures[model.__name__] = str(error)
    judged = samples.where(common)
    errors = np.array([fit.cross_validated for fit in fits])
    if np.isnan(errors).any():  # by the weighted squares at the taut ones of the samples that all models take
        left = [f.muscle.law(judged.pressure, judged.contraction) - judged.force for f in fits]
        errors = np.array([judged.weights @ np.where(judged.slack, 0.0, error) ** 2 for error in left])
    ranked = tuple(fits[i] for i in np.argsort(errors, kind="stable"))
    return Ranking(ranked, failures, samples.n, judged.n)


def _check_held(models: Iterable[type[Muscle]], hold: Mapping[str, float]) -> None:
    known = {name: None for model in models for name in model.parameter_fields()}
    for name, value in hold.items():
        if not among(name, known):
            raise InvalidInput(f"hold: there is no parameter {name!r} to hold; there are {', '.join(known)}")
        checks.real(f"hold: {name}", value, "SI units")
