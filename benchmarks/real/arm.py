"""Task d: free runs of an arm's angles from its measured pressures.

Runs of 40 samples (0.42 s) begin every 10 samples of a stretch without a jump of the clock. A model may see the rows
before and the pressures of the whole run. Hold leaves the joints where they are. ARX has three lags of all angles and
pressures. MLP is a network of the same. The grey box is `fit_arm`: which muscles pull which joint is found from the
data, and each joint gets a force of both pressures and its angle, damping, Coulomb friction, and further terms as far
as they lessen the error on left-out episodes of those that are fitted.
"""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.identification.arm.episodes import Episode
from allocator.units import DEG
from benchmarks.real.arm_log import splits, windows_of
from benchmarks.real.arm_models import ArmModel, arx, grey_box, hold, mlp
from benchmarks.real.scores import Score, best_in_bold

_DRIFT_PARTS = 5


class ArmScores(NamedTuple):
    """Scores of one model on one split, in degrees."""

    split: str
    model: str
    joints: tuple[Score, ...]
    in_time: Array  # RMS error (parts, m) of fifths of the held-out episodes in the order of time
    last: Array  # RMS error (m,) of the last sample


MODELS: dict[str, Callable[[Sequence[Episode]], ArmModel]] = {
    "hold": lambda episodes: hold,
    "ARX": arx,
    "MLP": mlp,
    "grey box": grey_box,
}


def judge(split: str, name: str, model: ArmModel, episodes: Sequence[Episode]) -> ArmScores:
    """Return the scores of a model on held-out episodes."""
    windows, past, past_p = windows_of(episodes)
    predicted, half = model(windows, past, past_p)
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
        scores += [judge(split, name, MODELS[name](seen), held) for name in models]
    return scores


def table(scores: Sequence[ArmScores]) -> list[str]:
    """Return the scores as lines of Markdown."""
    m = len(scores[0].joints)
    head = " | ".join(f"joint {j + 1}" for j in range(m))
    lines = []
    for split in dict.fromkeys(s.split for s in scores):
        mine = [s for s in scores if s.split == split]
        lines += [f"### Held out: {split}", "", "RMS error of 40 samples [°], with 95 % interval.", ""]
        lines += [f"| model | {head} |", f"|---{'|---' * m}|"]
        rows = [
            (s.model, [f"{j.rms:.2f} ({j.rms_interval[0]:.1f}–{j.rms_interval[1]:.1f})" for j in s.joints])
            for s in mine
        ]
        lines += best_in_bold(rows, [[j.rms for j in s.joints] for s in mine])
        lines += [
            "",
            "NRMSE [-]; coverage [%] and mean half width [°] of the 95 % bands; RMS of the last sample [°].",
            "",
        ]
        lines += [f"| model | {head} |", f"|---{'|---' * m}|"]
        for s in mine:
            cells = [
                f"{j.nrmse:.2f}; "
                + ("–" if np.isnan(j.coverage) else f"{100 * j.coverage:.0f} %, ±{j.sharpness:.1f}")
                + f"; {last:.1f}"
                for j, last in zip(s.joints, s.last, strict=True)
            ]
            lines.append(f"| {s.model} | {' | '.join(cells)} |")
        lines += ["", "RMS error [°] of fifths of the held-out free runs in the order of time: drift would grow.", ""]
        lines += [f"| model | {head} |", f"|---{'|---' * m}|"]
        for s in mine:
            lines.append(
                f"| {s.model} | {' | '.join(' '.join(f'{x:.1f}' for x in s.in_time[:, j]) for j in range(m))} |"
            )
        lines.append("")
    return lines
