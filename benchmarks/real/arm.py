"""Task d: free runs of an arm's angles from its measured pressures.

Runs of 40 samples (0.42 s) begin every 10 samples of a stretch without a jump of the clock. A model may see the rows
before and the pressures of the whole run. Hold leaves the joints where they are. ARX has three lags of all angles and
pressures. MLP is a network of the same. The grey box is `fit_arm`: which muscles pull which joint is found from the
data, and each joint gets a force of both pressures and its angle, damping, Coulomb friction, and further terms as far
as they lessen the error on left-out episodes of those that are fitted. The stack is a weighted mean of the others, with
weights for each joint that minimise the error on left-out episodes of those that are fitted.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.episodes import Episode
from allocator.units import DEG
from benchmarks.real.arm_log import splits, windows_of
from benchmarks.real.arm_models import ArmModel, arx, grey_box, hold, mlp, stack
from benchmarks.real.scores import Score, best_in_bold

STACK = "stack"
_DRIFT_PARTS = 5


class ArmScores(NamedTuple):
    """Scores of one model on one split, in degrees."""

    split: str
    model: str
    joints: tuple[Score, ...]
    in_time: Array  # RMS error (parts, m) of fifths of the held-out episodes in the order of time
    last: Array  # RMS error (m,) of the last sample


MODELS: dict[str, Callable[[Sequence[Episode]], ArmModel]] = {
    "hold": hold,
    "ARX": arx,
    "MLP": mlp,
    "grey box": grey_box,
}


def judge(split: str, name: str, model: ArmModel, episodes: Sequence[Episode]) -> ArmScores:
    """Return the scores of a model on held-out episodes."""
    windows, past, past_p = windows_of(episodes)
    predicted, half = model.predict(windows, past, past_p)
    error = (predicted - windows.future) / DEG
    joints = tuple(
        Score.of(
            predicted[..., j] / DEG,
            None if half is None else half[..., j] / DEG,
            windows.future[..., j] / DEG,
            windows.episode,
        )
        for j in range(error.shape[2])
    )
    parts = np.array_split(np.arange(len(error)), _DRIFT_PARTS)
    in_time = np.sqrt([np.mean(error[part] ** 2, axis=(0, 1)) for part in parts])
    return ArmScores(split, name, joints, in_time, np.sqrt(np.mean(error[:, -1] ** 2, axis=0)))


def compare(episodes: Sequence[Episode], models: Sequence[str]) -> list[ArmScores]:
    """Return the scores of the models of these names on both splits; each sees the other episodes only."""
    scores = []
    for split, out in splits(episodes).items():
        seen, held = ([e for e, o in zip(episodes, out, strict=True) if o == part] for part in (False, True))
        fitted = {name: MODELS[name](seen) for name in models}
        if sum(model.left_out is not None for model in fitted.values()) > 1:
            fitted[STACK] = stack(list(fitted.values()), seen)
        scores += [judge(split, name, model, held) for name, model in fitted.items()]
    return scores


def table(scores: Sequence[ArmScores]) -> list[str]:
    """Return the scores as lines of Markdown."""
    lines = []
    for split in dict.fromkeys(s.split for s in scores):
        mine = [s for s in scores if s.split == split]
        lines += [f"### Held out: {split}", ""]
        rows = best_in_bold([(s.model, [_error(j) for j in s.joints]) for s in mine], [_rms(s) for s in mine])
        lines += _part("RMS error of 40 samples [°] with 95 % interval; median of the episodes' RMS errors.", rows)
        rows = [_row(s.model, [_bands(j, last) for j, last in zip(s.joints, s.last, strict=True)]) for s in mine]
        title = "NRMSE [-]; coverage [%] and mean half width [°] of the 95 % bands; RMS of the last sample [°]."
        lines += _part(title, rows)
        rows = [_row(s.model, [" ".join(f"{x:.1f}" for x in errors) for errors in s.in_time.T]) for s in mine]
        title = "RMS error [°] of fifths of the held-out free runs in the order of time: drift would grow."
        lines += _part(title, rows)
    return lines


def _rms(s: ArmScores) -> list[float]:
    return [joint.rms for joint in s.joints]


def _error(s: Score) -> str:
    return f"{s.rms:.2f} ({s.rms_interval[0]:.1f}–{s.rms_interval[1]:.1f}); {s.median:.2f}"


def _bands(s: Score, last: float) -> str:
    inside = "–" if np.isnan(s.coverage) else f"{100 * s.coverage:.0f} %, ±{s.sharpness:.1f}"
    return f"{s.nrmse:.2f}; {inside}; {last:.1f}"


def _row(name: str, cells: Sequence[str]) -> str:
    return f"| {name} | {' | '.join(cells)} |"


def _part(title: str, rows: Sequence[str]) -> list[str]:
    """Return a table of joints with its title."""
    m = rows[0].count("|") - 2
    head = _row("model", [f"joint {j + 1}" for j in range(m)])
    return [title, "", head, f"|---{'|---' * m}|", *rows, ""]
