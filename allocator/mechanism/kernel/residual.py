"""How far an answer is from optimal is computed from the answer itself; the multipliers are believed for no more."""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from collections.abc import Callable

from allocator.mechanism.kernel.levels import CANCELS


def residual(levels, box, x, mu, pull, near, held, work):
    """Return the greatest gradient that is left at any level, in fractions of its scale.

    `pull` is the weight that ‖x - c‖² has beside the rows of the last level; with 0 it is a level of its own. `held`
    (m + p) is memory. `levels.prepare` and `levels.scale` come before.
    """
    ends, scales, factors = levels.ends, work.scales, work.rhs
    K, begin, worst = len(ends), 0, 0.0
    for j in range(len(x)):
        held[j] = box.lo[j] >= box.hi[j]
    for i in range(len(levels.b)):
        held[len(x) + i] = not levels.onesided[i]
    for k in range(K + 1 if pull == 0.0 else K):
        end, largest = ends[k] if k < K else begin, 0.0
        for i in range(end):
            factors[i] = mu[k, i]
            largest = max(largest, abs(mu[k, i]))
            if i >= begin:  # the level's own rows, from the answer itself
                excess = -slack(i, levels, x)
                factors[i] = max(excess, 0.0) if levels.onesided[i] else excess
                worst = max(worst, abs(factors[i] - mu[k, i]) / scales[0, k])
        to_centre = 1.0 if k == K else (pull if k == K - 1 else 0.0)
        worst = max(worst, of_variables(k, end, levels, box, x, mu, to_centre, largest, near, held, work))
        worst = max(worst, of_rows(k, end, levels, x, mu, largest, near, held, work))
        begin = end
    return worst


def slack(i, levels, x):
    """Return b - A x of row `i`."""
    left = levels.b[i]
    for j in range(len(x)):
        left -= levels.A[i, j] * x[j]
    return left


def of_variables(k, end, levels, box, x, mu, to_centre, greatest, near, held, work):
    """Return what is left of level k's gradient; `held` are the variables that an earlier level holds at a bound."""
    A, factors, worst = levels.A, work.rhs, 0.0
    for j in range(len(x)):
        gradient = to_centre * (x[j] - box.centre[j])
        felt, size = gradient, abs(gradient)
        for i in range(end):
            gradient += A[i, j] * factors[i]
            felt += A[i, j] * mu[k, i]
            size += abs(A[i, j]) * greatest
        low, high = x[j] <= box.lo[j] + near, x[j] >= box.hi[j] - near
        wrong = abs(gradient)
        if low or high:
            wrong = max(-gradient if low else gradient, 0.0)
        if not held[j]:
            worst = max(worst, wrong / (work.scales[1, k] + size))
            held[j] = (low or high) and abs(felt) > CANCELS * size
    return worst


def of_rows(k, end, levels, x, mu, greatest, near, held, work):
    """Return what is left of the multipliers of one-sided rows, which push from their bound only, and only at it."""
    worst, level, m = 0.0, 0, len(x)
    for i in range(end):
        if i >= levels.ends[level]:
            level += 1
        if not held[m + i]:
            at = slack(i, levels, x) <= near * work.scales[0, level]
            wrong = max(-work.rhs[i], 0.0) if at else abs(work.rhs[i])
            worst = max(worst, wrong / (work.scales[0, k] + greatest))
            held[m + i] = at and abs(mu[k, i]) > CANCELS * greatest
    return worst


FUNCTIONS: tuple[Callable[..., object], ...] = (residual, slack, of_variables, of_rows)
