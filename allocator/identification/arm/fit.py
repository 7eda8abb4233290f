"""Model of a whole arm from its own log, with bands for its predictions.

First, muscles are assigned to joints. For every joint the acceleration of the moving rows is regressed on all
pressures, the state and the sign of the speed,

    v'_j = Σ_i b_ij p_i + c·(q, v, sign v) + e

and a linear assignment of muscles to the sides of joints maximises the sum of the signed t-statistics b_ij/std(b_ij).
(The slopes b themselves mislead: light distal joints accelerate with every muscle.) Then the parameters of each joint's
law minimise the error of its free run q̂, its neighbours as measured,

    minimise  Σ (q̂_t - q_t)²/deg²  +  λ² w Σ_i ((x_i - x_i⁰)/s_i)²        over x, all windows w and steps t

where the second term keeps parameters that the log does not determine. Derivatives are differences of simultaneous free
runs, because the motion of a sticking joint is not differentiable. Optional terms of the law are kept if they improve
the prediction of left-out episodes.

Finally every joint is fitted five times, each time without a fifth of the episodes. A prediction is the median of the
five free runs, in which all joints are predicted. The errors of each model on its unseen episodes give the bands: their
95 % quantile by step of the horizon and by how far the joint is predicted to move.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.arm.episodes import Episode, Windows
from allocator.identification.arm.law import TERMS, JointLaw, run
from allocator.identification.least_squares import rms
from allocator.units import DEG

_MOVING = 0.05  # [rad/s]: slower rows stick, and contain no information on forces


@dataclass(frozen=True)
class Assignment:
    """Muscles of each joint, and the evidence for them."""

    pairs: tuple[tuple[int, int], ...]  # the muscles that raise and lower the angle of each joint
    t_statistics: Array  # (m, k): evidence that a muscle accelerates a joint
    margin: float  # excess of the sum over the best assignment with one muscle changed

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Muscles whose own evidence is below two standard deviations."""
        sides = [(j, i, sign) for j, pair in enumerate(self.pairs) for i, sign in zip(pair, (1, -1), strict=True)]
        return tuple(i for j, i, sign in sides if sign * self.t_statistics[j, i] < 2)


def assign_muscles(episodes: Sequence[Episode]) -> Assignment:
    """Return the muscles that raise and lower the angle of each joint.

    Raises `InvalidInput` for a joint that hardly moves.
    """
    from scipy.optimize import linear_sum_assignment

    t = np.stack([_t_statistics(episodes, j) for j in range(episodes[0].q.shape[1])])
    gain = np.concatenate([t, -t])  # (2 m, k): the sides that raise, then those that lower
    sides, muscles = linear_sum_assignment(-gain)
    best = float(gain[sides, muscles].sum())
    others = []
    for side, muscle in zip(sides, muscles, strict=True):
        without = gain.copy()
        without[side, muscle] = -1e6
        others.append(float(without[linear_sum_assignment(-without)].sum()))
    muscle_of = dict(zip(sides.tolist(), muscles.tolist(), strict=True))
    m = len(t)
    return Assignment(tuple((muscle_of[j], muscle_of[m + j]) for j in range(m)), t, best - max(others))


def _t_statistics(episodes: Sequence[Episode], joint: int) -> Array:
    """Return b_ij/std(b_ij) (k,) of one joint."""
    rows, accelerations = [], []
    for e in episodes:
        q, v, p = e.q[1:-1], e.v[1:-1], e.p[1:-1]
        moving = np.abs(v[:, joint]) > _MOVING
        rows.append(np.concatenate([p, q, v, np.sign(v)], axis=1)[moving])
        accelerations.append(((e.v[2:, joint] - e.v[:-2, joint]) / (2 * e.step))[moving])
    X, y = np.concatenate(rows), np.concatenate(accelerations)
    if len(y) < 10 * X.shape[1]:
        raise InvalidInput(f"joint {joint + 1} moves in {len(y)} rows only, too few to tell which muscles pull it")
    X, y = X - X.mean(axis=0), y - y.mean()
    inverse = np.linalg.pinv(X.T @ X)
    b = inverse @ X.T @ y
    error = y - X @ b
    std = np.sqrt(np.diag(inverse) * (error @ error) / (len(y) - X.shape[1]))
    return np.asarray((b / std)[: episodes[0].p.shape[1]])


# --- one joint --------------------------------------------------------------------------------------------------------


_HELD = 0.3  # λ [°/°]
_DIFFERENCE = 3e-4  # of a usual size
_ITERATIONS = 40
_BETTER = 0.98  # of the error on left-out episodes, required of a further term
_FOLDS = 3
_PIECES = 3  # of a log with few episodes, for each fit


def fit_law(law: JointLaw, windows: Windows) -> Array:
    """Return the parameters (n,) of a joint with the best prediction of the windows."""
    from scipy.optimize import least_squares

    first, size = (np.array([getattr(p, part) for p in law.parameters]) for part in ("start", "size"))
    measured, held = windows.future[..., law.joint], _HELD * np.sqrt(len(windows.q)) / size

    def predicted(x: Array) -> Array:
        return run({law.joint: (law, x)}, windows)[law.joint]

    def residual(x: Array) -> Array:
        return np.concatenate([((predicted(x[None])[0] - measured) / DEG).ravel(), held * (x - first)])

    def jacobian(x: Array) -> Array:
        change, n = np.diag(_DIFFERENCE * size), x.size
        rows = predicted(np.concatenate([x + change, x - change])).reshape(2 * n, -1) / DEG
        slope = (rows[:n] - rows[n:]) / (2 * _DIFFERENCE * size[:, None])
        return np.concatenate([slope.T, np.diag(held)])

    fitted = least_squares(residual, first, jacobian, x_scale=size, max_nfev=_ITERATIONS, ftol=1e-4)
    return np.asarray(fitted.x)


def joint_error(law: JointLaw, x: Array, windows: Windows) -> float:
    """Return the RMS error [rad] of the joint's free runs, its neighbours as measured."""
    return rms(run({law.joint: (law, x[None])}, windows)[law.joint][0] - windows.future[..., law.joint])


def folds(windows: Windows, count: int) -> list[NDArray[np.bool_]]:
    """Return the windows (w,) left out of each of `count` fits: whole episodes in turn, or pieces if they are few."""
    names = list(dict.fromkeys(windows.episode.tolist()))
    if len(names) < 2 * count:
        which = np.arange(len(windows.q)) * _PIECES * count // len(windows.q)
    else:
        which = np.array([names.index(name) for name in windows.episode.tolist()])
    return [which % count == i for i in range(count)]


def choose_terms(law: JointLaw, windows: Windows, tell: Callable[[str], object]) -> JointLaw:
    """Return the law with the terms that improve the prediction of left-out episodes, one by one, the best first."""

    def error(law: JointLaw) -> float:
        parts = [(windows.only(~out), windows.only(out)) for out in folds(windows, _FOLDS)]
        return rms([joint_error(law, fit_law(law, seen), unseen) for seen, unseen in parts])

    best, left = error(law), list(TERMS)
    while left:
        tried = {term: error(replace(law, terms=(*law.terms, term))) for term in left}
        term = min(tried, key=lambda name: tried[name])
        tell(f"joint {law.joint + 1}: {term} {tried[term] / DEG:.2f}° after {best / DEG:.2f}°")
        if tried[term] > _BETTER * best:
            break
        law, best = replace(law, terms=(*law.terms, term)), tried[term]
        left.remove(term)
    return law


# --- models of the arm ------------------------------------------------------------------------------------------------


_MEMBERS = 5
_MOVES = (0.5 * DEG, 5 * DEG)  # between a joint that rests, one that moves, and one that moves far
_COVERED = 0.95
_NOTHING = 1e-6  # weight of a step without errors
_FEWER = 2  # every so many windows choose the terms


@dataclass(frozen=True)
class Bands:
    """Half widths of the bands [rad], by joint, predicted move and step (m, moves, h)."""

    widths: Array

    @classmethod
    def of(cls, predicted: Array, start: Array, error: Array) -> "Bands":
        """Return the quantiles of errors (w, h, m) of free runs (w, h, m) from angles (w, m), all in rad.

        Widths do not decrease along a run: they are the isotonic regression of the quantiles of each step.
        """
        from scipy.optimize import isotonic_regression

        kind, (_, h, m) = _kind(predicted, start), error.shape
        widths = np.zeros((m, len(_MOVES) + 1, h))
        for j in range(m):
            for move in range(len(_MOVES) + 1):
                steps = [slice(max(t - 2, 0), t + 3) for t in range(h)]
                near = [np.abs(error[:, step, j])[kind[:, step, j] == move] for step in steps]
                quantiles = [np.quantile(errors, _COVERED) if errors.size else 0.0 for errors in near]
                weights = [max(errors.size, _NOTHING) for errors in near]
                widths[j, move] = isotonic_regression(quantiles, weights=weights).x
        return cls(widths)

    def around(self, predicted: Array, start: Array) -> Array:
        """Return the half widths (w, h, m) [rad] of these free runs."""
        kind = _kind(predicted, start)
        t = np.arange(predicted.shape[1])
        return np.stack([self.widths[j][kind[..., j], t[None]] for j in range(predicted.shape[2])], axis=-1)


def _kind(predicted: Array, start: Array) -> Array:
    moved = np.maximum.accumulate(np.abs(predicted - start[:, None]), axis=1)
    return np.asarray(np.searchsorted(_MOVES, moved))


@dataclass(frozen=True)
class ArmFit:
    """Laws of all joints with the parameters of five fits, and the bands of their median."""

    assignment: Assignment
    laws: tuple[JointLaw, ...]
    members: tuple[Array, ...]  # of each joint (5, n)
    full: float  # pressure that is 1 in the laws
    left_out: Array  # free runs (w, h, m) [rad] of the fitted windows, each by the fit without its episode
    bands: Bands

    def predict(self, windows: Windows) -> tuple[Array, Array]:
        """Return free runs of all joints and half widths of their 95 % bands, both (w, h, m) [rad].

        Of the windows' measured angles only the first two rows are used.
        """
        runs = run(_members(self.laws, self.members), windows._replace(p=windows.p / self.full))
        predicted = np.stack([np.median(runs[j], axis=0) for j in range(len(self.laws))], axis=-1)
        return predicted, self.bands.around(predicted, windows.q[:, 1])


def fit_arm(
    episodes: Sequence[Episode],
    *,
    horizon: int = 40,
    every: int = 10,
    terms: Mapping[int, tuple[str, ...]] | None = None,
    progress: Callable[[str], object] | None = None,
) -> ArmFit:
    """Fit the motion of every joint of an arm to episodes of its log.

    Parameters
    ----------
    episodes
        Stretches of one arm from `Episode.checked`.
    horizon
        Steps of the free runs whose error is minimised.
    every
        Rows between the beginnings of the free runs.
    terms
        Terms of the law of each joint, see `allocator.identification.arm.law`; by default those that improve the
        prediction.
    progress
        Called with a word before each step.

    Raises
    ------
    InvalidInput
        For episodes shorter than a free run, and for joints that hardly move.
    """
    tell = progress or (lambda step: None)
    windows = Windows.cut(episodes, horizon, every)
    assignment = assign_muscles(episodes)
    full = float(np.abs(windows.p).max())
    windows = windows._replace(p=windows.p / full)
    few = windows.only(np.arange(len(windows.q)) % _FEWER == 0)
    laws, members = [], []
    left_out = folds(windows, _MEMBERS)
    for j, pair in enumerate(assignment.pairs):
        ends = float(windows.q[..., j].min()), float(windows.q[..., j].max())
        law = JointLaw(j, pair, len(assignment.pairs), () if terms is None else terms[j], ends)
        law = choose_terms(law, few, tell) if terms is None else law
        laws.append(law)
        tell(f"joint {j + 1}: {', '.join(law.terms) or 'no further terms'}")
        members.append(np.stack([fit_law(law, windows.only(~out)) for out in left_out]))
    predicted = _left_out(laws, members, windows)
    bands = Bands.of(predicted, windows.q[:, 1], predicted - windows.future)
    return ArmFit(assignment, tuple(laws), tuple(members), full, predicted, bands)


def _members(laws: Sequence[JointLaw], members: Sequence[Array]) -> dict[int, tuple[JointLaw, Array]]:
    return {law.joint: (law, x) for law, x in zip(laws, members, strict=True)}


def _left_out(laws: Sequence[JointLaw], members: Sequence[Array], windows: Windows) -> Array:
    predicted = np.empty_like(windows.future)
    for i, out in enumerate(folds(windows, _MEMBERS)):
        runs = run(_members(laws, [x[i : i + 1] for x in members]), windows.only(out))
        predicted[out] = np.stack([runs[j][0] for j in range(len(laws))], axis=-1)
    return predicted
