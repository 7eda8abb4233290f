"""Fit of one muscle model to measured forces, and a ranking of all models on the same samples.

Some models are not defined for stretched muscles and are fitted without those samples. Models are ranked by
cross-validation within the samples common to all, in the same parts. A model that leaves out more than a tenth of the
samples is never the best if another does not.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.least_squares import Determination, at_bound, determine, rms
from allocator.identification.muscle.load_cell import hysteresis, weighted, zeroed
from allocator.identification.muscle.problem import MuscleProblem, Solution
from allocator.identification.muscle.result import Fit, Level
from allocator.identification.muscle.samples import Samples, joined, thinned
from allocator.muscles import MODELS, Muscle, Recipe, monotonicity_failure
from allocator.muscles.base import AffineMuscle, Covariance
from allocator.muscles.measured import MeasuredRegion
from allocator.muscles.monotonicity import FAILS
from allocator.muscles.recipe import among
from allocator.units import BAR

M = TypeVar("M", bound=Muscle)
Range = tuple[float, float]

EVERYTHING: Range = (-np.inf, np.inf)
_MOST_LEVELS = 40  # more distinct pressures are grouped into classes
_CLASSES = 10
_PULLS = 0.02  # of full scale: a modelled pull of a slack muscle that is reported


def fit(
    model: type[M],
    contraction: ArrayLike,
    pressure: ArrayLike,
    force: ArrayLike,
    *,
    weights: ArrayLike | None = None,
    hold: Mapping[str, float] | None = None,
    start: M | None = None,
    pressure_range: Range = EVERYTHING,
    contraction_range: Range = EVERYTHING,
    folds: int = 5,
    zero_noise: float | None = None,
    file: ArrayLike | None = None,
) -> Fit[M]:
    """Fit `model` to forces [N] measured at contractions [-] and gauge pressures [Pa], arrays that broadcast.

    Forces distinguishable from zero are equations; the others mean slack: inequalities F ≤ 0 (see `Samples.residual`).
    Logs of more than 2000 rows are averaged over cells first (see `thinning`), and the load cell's sign and offset are
    corrected if the slack readings show them (see `load_cell`), with a note in `samples.notes`. Outliers are left out
    (see `outliers`) and listed in `samples.dropped`.

    Parameters
    ----------
    weights
        Relative weights of the squared residuals; by default 1.
    hold
        Parameters (by the names of `Muscle.parameters`) that are not fitted, e.g. ``{"r0": 0.0109}``. Those that only
        set a scale (P_max, rest lengths) are always held, by default at a usual value.
    start
        Initial muscle, required for a custom model without a `recipe`.
    pressure_range, contraction_range
        Samples outside [Pa], [-] are dropped, and counted.
    folds
        Number of parts for cross-validation: each part is predicted from the others; 0: none.
    zero_noise
        Standard deviation of the load cell's readings at no force [N]; by default estimated from the slack ones. If it
        is not zero, samples are weighted by the variance of their readings.
    file
        Label of the file, or the experiment, of each sample: sign and zero of the load cell, outliers and hysteresis
        are determined separately in each, and errors are reported for each (`Fit.files`). One muscle is fitted to all.

    Raises
    ------
    InvalidInput
        For samples that are invalid, fewer than the parameters, or at one pressure only, and if no muscle of this kind
        fits them.
    """
    samples = Samples.checked(contraction, pressure, force, weights, file)
    samples = prepared(samples, pressure_range, contraction_range, zero_noise)
    problem, starts, _ = build_problem(model, samples, hold, start)
    return conclude(model, problem, folds, starts)


def prepared(
    samples: Samples,
    pressure_range: Range = EVERYTHING,
    contraction_range: Range = EVERYTHING,
    zero_noise: float | None = None,
) -> Samples:
    """Return the samples for all models: within the ranges, thinned, corrected for the load cell, without outliers.

    Each file has its own zero, outliers and hysteresis.
    """
    if zero_noise is not None:
        zero_noise = checks.not_negative("zero_noise", zero_noise, "N")
    ranges = (("pressure", pressure_range, BAR, " bar"), ("contraction", contraction_range, 1.0, ""))
    for name, (low, high), unit, suffix in ranges:
        samples = samples.without(getattr(samples, name) < low, f"{name} below {low / unit:g}{suffix}")
        samples = samples.without(getattr(samples, name) > high, f"{name} above {high / unit:g}{suffix}")
    if not samples.n:
        raise InvalidInput("no samples are left to fit")
    told = joined({name: _zeroed(part, zero_noise) for name, part in samples.parts.items()})
    if samples.file is not None:
        told = replace(told, dropped={**samples.dropped, **told.dropped}, notes=(*samples.notes, *told.notes))
    return weighted(thinned(told))


def _zeroed(samples: Samples, zero_noise: float | None) -> Samples:
    samples = zeroed(samples.without_outliers(), zero_noise)
    for branches in hysteresis(samples):
        samples = samples.noted(str(branches))
    return samples


def build_problem(
    model: type[M],
    samples: Samples,
    hold: Mapping[str, float] | None = None,
    start: M | None = None,
) -> tuple[MuscleProblem, tuple[Muscle, ...], Mask]:
    """Build the fit of `model` to the prepared samples in its domain.

    Returns the problem, its starts, and the mask (n,) of samples in the domain.
    """
    recipe = _recipe(model, samples, start, hold or {})
    least = max(s.min_contraction for s in recipe.starts)
    takes = samples.contraction >= least
    inside = samples.without(~takes, f"contraction below {least:g}, where {model.__name__} ends")
    prototype = recipe.starts[0]
    free = recipe.free(prototype.parameters, hold or {})
    linear = tuple(n for n in free if among(n, recipe.linear))
    problem = MuscleProblem(prototype, free, linear, *recipe.limits(free), inside, inside.slack)
    _check_sufficient(problem)
    return problem, recipe.starts, takes


def _recipe(model: type[M], samples: Samples, start: M | None, hold: Mapping[str, float]) -> Recipe[M]:
    """Return the model's recipe, from `start` if given, with the held values."""
    recipe = model.recipe(samples.contraction, samples.pressure, np.where(samples.slack, 0.0, samples.force))
    if start is not None:
        recipe = replace(recipe, starts=(replace(start, measured=None),))  # the formula is fitted, not its continuation
    if not recipe.starts:
        raise InvalidInput(f"{model.__name__} does not say from where to search; pass start=")
    return replace(recipe, starts=tuple(s.with_parameters(hold) for s in recipe.starts))


def _check_sufficient(problem: MuscleProblem) -> None:
    name, taut = type(problem.prototype).__name__, ~problem.slack
    n, m = int(taut.sum()), len(problem.free)
    if n < m:
        names = ", ".join(problem.free)
        raise InvalidInput(f"{n} taut samples cannot determine the {m} parameters of {name} ({names})")
    P = problem.samples.pressure[taut]
    if np.ptp(P) <= 0.01 * np.abs(P).max():
        raise InvalidInput(
            f"all taut samples are at one pressure, {P.mean() / BAR:.4g} bar; the effect of pressure needs two or more"
        )


def conclude(
    model: type[M], problem: MuscleProblem, folds: int, starts: tuple[Muscle, ...], common: Mask | None = None
) -> Fit[M]:
    """Solve the problem and return the fit, cross-validated on the samples `common` (default: all)."""
    solution = problem.solve(starts)
    samples, slack, x = problem.samples, problem.slack, solution.x
    try:
        muscle = replace(problem.muscle(x))  # checks the parameters
    except InvalidInput as error:
        raise InvalidInput(f"the best {model.__name__} makes no sense as a muscle: {error}") from None
    inside = ~at_bound(x, problem.lower, problem.upper, 1e-6, 1e-3)
    determined = _determination(problem, x, inside)
    region = MeasuredRegion.of(samples.contraction, samples.pressure)
    muscle = replace(muscle, covariance=_embedded(problem, determined.covariance, inside), measured=region)
    pulls = muscle.law(samples.pressure, samples.contraction)
    residual = (pulls - samples.force)[~slack]
    eps = max(0.0, float(samples.contraction.min())), float(samples.contraction.max())
    failure = monotonicity_failure(muscle, float(samples.pressure.max()), eps)
    return Fit(
        muscle=muscle,  # type: ignore[arg-type]  # the prototype is a `model`, which MuscleProblem does not say
        samples=samples,
        slack=slack,
        free=problem.free,
        rank=determined.rank,
        rms=rms(residual),
        max_error=float(np.abs(residual).max()),
        cross_validated=_cross_validated(problem, starts, muscle, folds, common),
        levels=_levels(samples.pressure[~slack], residual),
        collinear=determined.collinear,
        monotone=not failure,
        warnings=tuple(_warnings(problem, solution, inside, determined.collinear, failure, pulls[slack])),
    )


def _determination(problem: MuscleProblem, x: Array, inside: Mask) -> Determination:
    names = tuple(name for name, i in zip(problem.free, inside, strict=True) if i)
    J, r = problem.jacobian(x)[:, inside], problem.residual(x)
    tell = (J != 0).any(axis=1)
    cost = r[tell] @ r[tell]
    if problem.samples.scatter is not None:
        cost += (problem.samples.weights * problem.samples.scatter**2)[tell].sum()
    return determine(J, float(cost), names, x[inside])


def _embedded(problem: MuscleProblem, covariance: Array, inside: Mask) -> Covariance:
    """Return the covariance among all parameters of the muscle, zero for those not fitted."""
    every = [*problem.prototype.parameters]
    places = [every.index(name) for name, i in zip(problem.free, inside, strict=True) if i]
    full = np.zeros((len(every), len(every)))
    full[np.ix_(places, places)] = covariance
    return tuple(map(tuple, full.tolist()))


def _warnings(
    problem: MuscleProblem, solution: Solution, inside: Mask, collinear: tuple[str, ...], failure: str, pulls: Array
) -> Iterator[str]:
    """Yield the caveats of a fit; `pulls` are the model's forces [N] at slack samples."""
    for name, value, free in zip(problem.free, solution.x, inside, strict=True):
        if not free:
            yield f"{name} ended at the limit of its search, {value:g}"
    if not solution.converged:
        yield "the search stopped before it converged"
    yield from (f"collinear: {direction} changes no force" for direction in collinear)
    if failure:
        yield f"{FAILS}: {failure}"
    if (wrong := pulls > _PULLS * problem.samples.full_scale).any():
        yield f"pulls up to {pulls.max():.3g} N at {wrong.sum()} of the slack samples"


def _cross_validated(
    problem: MuscleProblem, starts: tuple[Muscle, ...], muscle: Muscle, folds: int, common: Mask | None
) -> float:
    """Return the weighted RMS error of taut samples predicted from fits to the other parts of the `common` samples.

    It is NaN if there are too few.
    """
    if common is not None and not common.all():
        problem = problem.on(common)
        muscle = problem.muscle(problem.solve(starts).x)
    taut = np.flatnonzero(~problem.slack)
    if folds < 2 or taut.size - taut.size // folds < len(problem.free) + 1:
        return float("nan")
    part = np.random.default_rng(0).permutation(np.arange(taut.size) % folds)
    error = np.zeros(problem.samples.n)
    for i in range(folds):
        left_out = taut[part == i]
        kept = np.ones(problem.samples.n, bool)
        kept[left_out] = False
        predicted = problem.force(problem.on(kept).solve((muscle,)).x)
        error[left_out] = (predicted - problem.samples.force)[left_out]
    return float(np.sqrt(np.average(error[taut] ** 2, weights=problem.samples.weights[taut])))


def _levels(P: Array, error: Array) -> tuple[Level, ...]:
    different = np.unique(P)
    group = np.searchsorted(different, P) if different.size <= _MOST_LEVELS else _classes(P)
    return tuple(
        Level(float(P[m].mean()), int(m.sum()), float(error[m].mean()), rms(error[m]))
        for m in (group == g for g in np.unique(group))
    )


def _classes(P: Array) -> NDArray[np.intp]:
    """Return the class (n,) of each pressure: separate clusters, e.g. around setpoints; else equal parts."""
    order = np.argsort(P)
    apart = np.diff(P[order], prepend=P[order[0]]) > np.ptp(P) / (4 * _CLASSES)
    cluster = np.empty(P.size, np.intp)
    cluster[order] = np.cumsum(apart)
    widest = max(float(np.ptp(P[cluster == g])) for g in range(int(cluster.max()) + 1))
    if widest < np.ptp(P) / _CLASSES:
        return cluster
    return np.asarray(np.minimum((P - P.min()) / np.ptp(P) * _CLASSES, _CLASSES - 1), np.intp)


# --- ranking of models ------------------------------------------------------------------------------------------------


_MOST_LEFT_OUT = 0.1  # of the samples, by the best model


@dataclass(frozen=True)
class Ranking:
    """Fits from the least to the greatest error on the same samples, and reasons why other models have none."""

    fits: tuple[Fit[Muscle], ...]
    failures: Mapping[str, str]  # model name → sentence
    samples: int  # number of samples to fit
    judged: int  # number of samples common to all models, used for the ranking

    @property
    def best(self) -> Fit[Muscle] | None:
        """Return the best model that satisfies [M] and has a closed-form inverse; else that satisfies [M]; else of all.

        Only those are considered that leave out at most a tenth of the samples, if there are any.
        """
        kept = [f for f in self._wide if f.monotone]
        choice = [f for f in kept if f.closed_form] or kept or self._wide
        return choice[0] if choice else None

    @property
    def affine(self) -> Fit[Muscle] | None:
        """Return the best model that is affine in the pressure and satisfies [M], among those that `best` considers."""
        return next((f for f in self._wide if isinstance(f.muscle, AffineMuscle) and f.monotone), None)

    @property
    def cost_of_affine(self) -> float:
        """Return the error of `affine` on samples kept from the fit over that of the best model of all [-]; NaN without
        one or without cross-validation.
        """
        return np.nan if self.affine is None else self.affine.cross_validated / self._wide[0].cross_validated

    @property
    def _wide(self) -> Sequence[Fit[Muscle]]:
        """Models that leave out at most a tenth of the samples, or all, if there are none."""
        return [f for f in self.fits if f.samples.n >= (1 - _MOST_LEFT_OUT) * self.samples] or self.fits


def rank_models(
    samples: Samples,
    models: Iterable[type[Muscle]] = tuple(MODELS.values()),
    *,
    hold: Mapping[str, float] | None = None,
    folds: int = 5,
    pressure_range: Range = EVERYTHING,
    contraction_range: Range = EVERYTHING,
    zero_noise: float | None = None,
    progress: Callable[[Iterable[type[Muscle]]], Iterable[type[Muscle]]] = lambda models: models,
) -> Ranking:
    """Fit every model to `samples`; `hold` applies to models with the parameter, other options are those of `fit`.

    Raises `InvalidInput` if no samples are left, and if no model has a parameter to hold.
    """
    models = tuple(models)
    _check_held(models, hold or {})
    samples = prepared(samples, pressure_range, contraction_range, zero_noise)
    built, failures = {}, {}
    for model in models:
        held = {name: value for name, value in (hold or {}).items() if among(name, model.parameter_fields())}
        try:
            built[model] = build_problem(model, samples, held)
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
    if np.isnan(errors).any():  # by the weighted squares at the taut samples common to all models
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
