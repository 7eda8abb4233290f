"""Pairs of muscles of an arm's joints, found from its log.

For every joint the acceleration of the moving rows is regressed on all pressures, the state and the sign of the speed,

    v'_j = Σ_i b_ij p_i + c·(q, v, sign v) + e

and each muscle is assigned to one side of one joint, so that the sum of the signed t-statistics b_ij/std(b_ij) is
greatest (a linear assignment). The t-statistic and not b itself: light joints far out accelerate with everything.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.identification.arm.episodes import Episode

_MOVING = 0.05  # [rad/s]: slower rows stick, and tell of no force


@dataclass(frozen=True)
class Assignment:
    """Muscles of the joints, and what the log says for them."""

    pairs: tuple[tuple[int, int], ...]  # muscle that raises, and that lowers, the angle of each joint
    t_statistics: Array  # (m, k): evidence that a muscle accelerates a joint
    margin: float  # by which the sum exceeds that of the best other assignment of one of the muscles

    @property
    def doubtful(self) -> tuple[int, ...]:
        """Muscles whose own evidence is below two standard deviations."""
        sides = [(j, i, sign) for j, pair in enumerate(self.pairs) for i, sign in zip(pair, (1, -1), strict=True)]
        return tuple(i for j, i, sign in sides if sign * self.t_statistics[j, i] < 2)


def assign_muscles(episodes: Sequence[Episode]) -> Assignment:
    """Return which muscle raises and which lowers the angle of each joint.

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
