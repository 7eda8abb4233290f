"""Model of a whole arm from its own log, with bands for its predictions.

Muscles are assigned to joints (`assign_muscles`), every joint gets the law whose terms show on left-out episodes
(`choose_terms`), and its parameters are fitted five times, each time without a fifth of the episodes. A prediction is
the median of the five free runs, in which all joints are predicted. The errors of each model on the episodes that it
has not seen give the bands: their 95 % quantile by step of the horizon and by how far the joint is predicted to move.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.assignment import Assignment, assign_muscles
from allocator.identification.arm.episodes import Episode, Windows
from allocator.identification.arm.law import JointLaw, run
from allocator.identification.arm.search import choose_terms, fit_law, folds
from allocator.units import DEG

_MEMBERS = 5
_MOVES = (0.5 * DEG, 5 * DEG)  # between a joint that rests, one that moves, and one that moves far
_COVERED = 0.95
_FEWER = 2  # every so many windows decide which terms show


@dataclass(frozen=True)
class Bands:
    """Half widths of the bands [rad], by joint, predicted move and step (m, moves, h)."""

    widths: Array

    @classmethod
    def of(cls, predicted: Array, start: Array, error: Array) -> "Bands":
        """Return the quantiles of errors (w, h, m) of free runs (w, h, m) from angles (w, m), all in rad."""
        kind, (_, h, m) = _kind(predicted, start), error.shape
        widths = np.zeros((m, len(_MOVES) + 1, h))
        for j in range(m):
            for move in range(len(_MOVES) + 1):
                for t in range(h):
                    near = np.abs(error[:, max(t - 2, 0) : t + 3, j])[kind[:, max(t - 2, 0) : t + 3, j] == move]
                    before = widths[j, move, t - 1] if t else 0.0
                    widths[j, move, t] = max(before, np.quantile(near, _COVERED)) if near.size else before
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
    bands: Bands

    def predict(self, windows: Windows) -> tuple[Array, Array]:
        """Return free runs of all joints and half widths of their 95 % bands, both (w, h, m) [rad].

        Of the windows' measured angles only the first two rows are used.
        """
        runs = run(_members(self.laws, self.members), windows.q, windows.v, windows.p / self.full, windows.step)
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
        Stretches as `Episode.checked` gives them, of one arm.
    horizon
        Steps of a free run, whose error is least.
    every
        Rows between the beginnings of the free runs.
    terms
        Terms of the law of each joint, see `allocator.identification.arm.law`; by default those that show.
    progress
        Called with a word before each step.

    Raises
    ------
    InvalidInput
        For episodes shorter than a free run, and for joints that hardly move.
    """
    tell = progress or (lambda step: None)
    assignment = assign_muscles(episodes)
    windows = Windows.cut(episodes, horizon, every)
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
    return ArmFit(assignment, tuple(laws), tuple(members), full, _bands(tuple(laws), tuple(members), windows))


def _members(laws: Sequence[JointLaw], members: Sequence[Array]) -> dict[int, tuple[JointLaw, Array]]:
    return {law.joint: (law, x) for law, x in zip(laws, members, strict=True)}


def _bands(laws: Sequence[JointLaw], members: Sequence[Array], windows: Windows) -> Bands:
    predicted = np.empty_like(windows.future)
    for i, out in enumerate(folds(windows, _MEMBERS)):
        part = windows.only(out)
        one = _members(laws, [x[i : i + 1] for x in members])
        runs = run(one, part.q, part.v, part.p, part.step)
        predicted[out] = np.stack([runs[j][0] for j in range(len(laws))], axis=-1)
    return Bands.of(predicted, windows.q[:, 1], predicted - windows.future)
