"""All models side by side on the same samples."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from allocator.errors import InvalidInput
from allocator.identification.fitting import fit
from allocator.identification.result import Fit
from allocator.identification.samples import Samples
from allocator.muscles import MODELS, Muscle


@dataclass(frozen=True)
class Ranking:
    """Fits from the best to the worst cross-validated error, and why other models have none."""

    fits: tuple[Fit[Any], ...]
    failures: Mapping[str, str]  # model name → sentence

    @property
    def best(self) -> Fit[Any] | None:
        """The best of those that keep [M] and have a closed-form inverse; else that keep [M]; else of all."""
        kept = [f for f in self.fits if f.monotone]
        choice = [f for f in kept if f.closed_form] or kept or self.fits
        return choice[0] if choice else None


def rank_models(
    samples: Samples,
    models: Iterable[type[Muscle]] = tuple(MODELS.values()),
    *,
    hold: Mapping[str, float] | None = None,
    progress: Callable[[Iterable[type[Muscle]]], Iterable[type[Muscle]]] = lambda models: models,
    **options: Any,
) -> Ranking:
    """Fit every model to `samples`; `hold` applies where a model has the parameter, `options` go to `fit`."""
    fits, failures = [], {}
    for model in progress(models):
        try:
            fits.append(_fit(model, samples, hold or {}, options))
        except InvalidInput as error:
            failures[model.__name__] = str(error)
    return Ranking(tuple(sorted(fits, key=_error)), failures)


def _fit(model: type[Muscle], samples: Samples, hold: Mapping[str, float], options: dict[str, Any]) -> Fit[Any]:
    fields = model.parameter_fields()
    held = {name: value for name, value in hold.items() if name.partition("[")[0] in fields}
    return fit(
        model, samples.contraction, samples.pressure, samples.force, weights=samples.weights, hold=held, **options
    )


def _error(fit: Fit[Any]) -> float:
    return fit.rms if np.isnan(fit.cross_validated) else fit.cross_validated


__all__ = ["Ranking", "rank_models"]
