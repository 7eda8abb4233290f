"""Fit of a muscle model to the measured equilibria of a joint."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.identification.joint.problem import FITTED_GRAVITY, MOST_ZERO, JointProblem
from allocator.identification.joint.result import JointFit, first_search, solved
from allocator.identification.joint.samples import Geometries, JointSamples, SlackReadings
from allocator.identification.joint.search import starting_muscle
from allocator.joint.gravity import NO_GRAVITY, Gravity
from allocator.muscles import MODELS, Muscle, Recipe
from allocator.units import BAR, DEG

DEAD_BAND = 0.5 * BAR  # below it a muscle has little effect [Pa]
SLACK_NOISE = 0.1 * BAR  # standard deviation of the pressures of a sag test [Pa]
_EXTRA = {"log_ratio": (-1.2, 1.2), "zero": (-MOST_ZERO, MOST_ZERO), "friction": (-0.5, 0.8)}
_EXTRA |= dict.fromkeys(FITTED_GRAVITY, (-1e3, 1e3))  # [N·m]
_MOST_SAMPLES = 1000  # more are averaged over cells
_ONE_LEVEL = 0.03  # of the mean co-contraction


def fit_joint(
    theta: ArrayLike,
    P1: ArrayLike,
    P2: ArrayLike,
    *,
    geometry: Geometries,
    torque: ArrayLike | None = None,
    direction: ArrayLike | None = None,
    group: ArrayLike | None = None,
    model: str | type[Muscle] | Muscle = "Sarosi2012",
    friction: bool = True,
    ratio: bool = True,
    zero: float | None = None,
    gravity: Gravity | None = NO_GRAVITY,
    average: bool = False,
    dead_band: float = DEAD_BAND,
    taut_min: float = 0.02,
    hold: Mapping[str, float] | None = None,
    start: Muscle | None = None,
    slack: ArrayLike | None = None,
    slack_noise: float = SLACK_NOISE,
    prior: Muscle | None = None,
    leave_one_out: bool = True,
    choices: bool = True,
) -> JointFit:
    """Fit the muscles of a joint to equilibria: angles [rad] at pressures (P1, P2) [Pa, gauge], arrays that broadcast.

    More than 1000 samples are averaged over cells of 0.05 bar, or wider if necessary; see `JointSamples.binned`.
    Samples at which the force law cannot be evaluated are left out and counted, as are samples at rest on an end stop,
    see `allocator.identification.outliers`, and outliers among angles at similar pressures, see
    `allocator.identification.outliers`.

    Parameters
    ----------
    geometry
        The measured mechanism, or one for each label in `group`. It is not fitted: angles cannot distinguish it from
        forces.
    torque
        Of a known weight at each sample [N·m], positive if it pulls θ down; 0 or None: no weight. Without a weight the
        force scale, hence absolute stiffness, is unknown and stays None.
    direction
        +1 if θ rose into the equilibrium, -1 if it fell, 0 if unknown: it determines friction.
    group
        A label for each sample, e.g. the muscle length: errors are reported, and left out in turn, by group.
    model
        Name or class of a muscle model, or a muscle of which only ratio, zero and friction are fitted.
    friction, ratio
        Whether μ of `AntagonistJoint.friction_torque` and the strength of the antagonist relative to the agonist are
        fitted. Friction needs directions; the report notes their absence.
    zero
        The known encoder reading [rad] at θ = 0; None: it is fitted.
    gravity
        The known gravity of the link, no part of the fitted muscles nor of their stiffness; it acts as a known weight.
        None: its amplitude and hanging angle are fitted, which needs a known `torque`. Without gravity, as by default,
        the muscles contain that of the link.
    average
        Fit the mean of the rising and falling samples at the same pressures instead of both.
    dead_band
        Samples with a pressure below [Pa] are dropped, and counted.
    taut_min
        Least force of both muscles, as a share of the mean, which taut equilibria on a pulley do not determine.
    hold, start
        As for `fit`: parameters of the muscle not to be fitted, a muscle to start from.
    slack
        Rows of a sag test: 1 if P1 was lowered until the cable of the agonist just went slack, 2 likewise for P2 and
        the antagonist, 3 both, 0 an equilibrium. Such a row states only F_i = 0 at its angle and pressure, with the
        joint held or at rest; it determines the force common to both muscles, which equilibria do not.
    slack_noise
        Standard deviation of the pressures at which a cable was found to go slack [Pa].
    prior
        A muscle of the same type, from the catalogue or fitted to forces (`fit(…).muscle`), that gives the common
        force, with its covariance, if the data do not. Its strength does not matter.
    leave_one_out
        Whether each group is also predicted from the others.
    choices
        Whether fits with greater dead bands and other laws are also made and reported. They do not change the
        covariance, which allows for a smooth error of the law, see `allocator.identification.joint.doubt.discrepancy`.

    Raises
    ------
    InvalidInput
        For invalid data, or data that cannot determine the unknowns.
    """
    samples = JointSamples.checked(
        theta, P1, P2, geometry=geometry, torque=torque, direction=direction, group=group, zero=zero or 0.0
    )
    samples, sag = _parted(samples, slack, slack_noise)
    dead = checks.not_negative("dead_band", checks.pressure("dead_band", dead_band), "Pa")
    low = np.minimum(samples.P1, samples.P2) < dead
    samples = samples.without(low, f"a pressure below the dead band of {dead / BAR:g} bar").without_stops()
    _check_data(samples, friction and not average)
    samples = samples.without_outliers().binned(_MOST_SAMPLES)
    samples = samples.averaged() if average else samples
    used = {"log_ratio": ratio, "zero": zero is None, "friction": friction and samples.direction.any()}
    used |= dict.fromkeys(FITTED_GRAVITY, gravity is None)
    if gravity is None and not samples.loaded:
        raise InvalidInput("to fit the link's gravity, hang a known weight at some rests: without it no force is known")
    extra = tuple(name for name, fitted in used.items() if fitted)
    for _ in range(1 + (zero is None)):  # contractions need the zero, which the second search takes from the first
        prototype, recipe, free = _prototype(model, samples, hold or {}, start)
        used_here = _within(samples, prototype)
        problem = replace(_problem(prototype, recipe, used_here, free, extra, taut_min, gravity or NO_GRAVITY), sag=sag)
        x = first_search(problem, recipe)
        samples = replace(samples, zero=problem.unknowns(x).zero)
    return solved(problem, x, leave_one_out, prior, choices)


def _parted(samples: JointSamples, slack: ArrayLike | None, noise: float) -> tuple[JointSamples, SlackReadings | None]:
    if slack is None:
        return samples, None
    (which,) = checks.broadcast(slack=checks.real("slack", slack, "0, 1, 2 or 3"))
    if not np.isin(which, (0, 1, 2, 3)).all() or which.size not in (1, samples.n):
        raise InvalidInput(
            "slack has to be 0 (an equilibrium), 1 (agonist), 2 (antagonist) or 3 (both) for each of the "
            f"{samples.n} samples"
        )
    error = checks.positive("slack_noise", checks.pressure("slack_noise", noise), "Pa")
    codes = np.broadcast_to(which.ravel(), samples.n).astype(np.intp)
    return samples.where(codes == 0), SlackReadings.of(samples, codes, error)


def _prototype(
    model: str | type[Muscle] | Muscle, samples: JointSamples, hold: Mapping[str, float], start: Muscle | None
) -> tuple[Muscle, Recipe[Muscle], tuple[str, ...]]:
    """Return the initial muscle, the model's recipe, and the names of the fitted parameters."""
    if isinstance(model, Muscle):
        return model, Recipe(), ()
    if isinstance(model, str):
        if model not in MODELS:
            raise MissingBackend("model", model, MODELS)
        model = MODELS[model]
    P, eps = samples.muscles()
    recipe = model.recipe(eps, P, np.ones(P.size))
    projected = recipe.starts[0] if recipe.linear and not hold else None
    prototype = start or projected or starting_muscle(model, samples, hold)
    prototype = replace(prototype.with_parameters(hold), covariance=None, measured=None)
    return prototype, recipe, recipe.free(prototype.parameters, hold)


def _within(samples: JointSamples, muscle: Muscle) -> JointSamples:
    """Return the samples at which the law has a force for both muscles; `fit` begins at the same least contraction."""
    P, eps = samples.muscles()
    name, least = type(muscle).__name__, muscle.min_contraction
    short = np.logical_or(*np.split(eps < least, 2))
    with np.errstate(all="ignore"):
        F = np.add(*np.split(muscle.force(P, eps), 2))
    kept = samples.without(short, f"a contraction below {least:.4g}, where {name} ends")
    kept = kept.without(~np.isfinite(F[~short]), f"a contraction or pressure for which {name} has no force")
    if not kept.n:
        raise InvalidInput(f"no equilibrium is left that {name} can be fitted to ({_reasons(kept)})")
    return kept


def _reasons(samples: JointSamples) -> str:
    """Return how many samples were left out, and why."""
    return "; ".join(f"{n} with {reason}" for reason, n in samples.dropped.items())


def _problem(
    prototype: Muscle,
    recipe: Recipe[Muscle],
    samples: JointSamples,
    free: tuple[str, ...],
    extra: tuple[str, ...],
    taut_min: float,
    gravity: Gravity,
) -> JointProblem:
    lower, upper = (
        np.append(limits, [_EXTRA[name][end] for name in extra]) for end, limits in enumerate(recipe.limits(free))
    )
    conventional = bool(free) and not samples.loaded and not gravity.torque
    problem = JointProblem(prototype, free, extra, lower, upper, samples, taut_min, conventional, gravity=gravity)
    if samples.n < len(problem.names) + 1:
        left_out = f"; left out were {reasons}" if (reasons := _reasons(samples)) else ""
        raise InvalidInput(
            f"{samples.n} equilibria cannot determine the {len(problem.names)} unknowns {', '.join(problem.names)}"
            f"{left_out}"
        )
    return problem


def _check_data(samples: JointSamples, friction: bool) -> None:
    """Refuse slack joints, swapped muscles, one co-contraction only; with `friction` one direction of motion only."""
    if not samples.n:
        raise InvalidInput(f"no equilibrium is left in which both muscles can be taut ({_reasons(samples)})")
    _check_signs(samples)
    total = samples.P1 + samples.P2
    if np.ptp(total) <= _ONE_LEVEL * np.abs(total).mean():
        raise InvalidInput(
            f"all equilibria are at one co-contraction, P1 + P2 = {total.mean() / BAR:.3g} bar: they cannot tell how "
            "stiffness grows with pressure; repeat the sweep at two other sums"
        )
    moving = samples.direction[samples.direction != 0]
    if friction and moving.size and np.ptp(moving) == 0:
        way = "rising" if moving[0] > 0 else "falling"
        raise InvalidInput(
            f"all equilibria were reached with {way} θ: friction cannot be told from the force laws; add the sweep the "
            "other way, or pass friction=False and take the hysteresis as error"
        )


def _check_signs(samples: JointSamples) -> None:
    """Refuse data in which P1 does not raise θ or P2 does not lower it."""
    groups = np.eye(len(samples.groups))[samples.group]
    columns = np.column_stack([samples.P1 / BAR, samples.P2 / BAR, samples.torque, groups])
    if np.ptp(samples.P1) == 0 or np.ptp(samples.P2) == 0:
        held = "P1" if np.ptp(samples.P1) == 0 else "P2"
        raise InvalidInput(f"{held} was never changed: both pressures have to be swept")
    rise1, rise2 = np.linalg.lstsq(columns, samples.theta)[0][:2]
    if rise1 < 0 < rise2:
        raise InvalidInput(
            f"θ falls with P1 ({rise1 / DEG:.2g} deg/bar) and rises with P2 ({rise2 / DEG:.2g} deg/bar): the muscles "
            "are swapped, or the angle has the other sign"
        )
    if not rise1 > 0 > rise2:
        raise InvalidInput(
            f"θ changes by {rise1 / DEG:.2g} deg/bar with P1 and {rise2 / DEG:.2g} deg/bar with P2: in an antagonistic "
            "pair P1 raises and P2 lowers it"
        )
