"""Targets, one after the other, in one call: checks, rows, box, solution, residual and status.

It does the work of `allocator.allocation.box.problem` and `certificate`. All arrays of a target are flat, because each
array argument costs a compiled function a quarter of a microsecond:

    asked (2n + n² + m + 3)      q, T, K row by row, pressures now; least force, greatest force, greatest step (±inf)
    fixed (2n + m + d + 4)       ends of the joints, greatest pressures, roots of the weights; supply's lower end, unit,
                                 tolerance of bounds, least contraction
    posture (3m + d + d m)       ε, A and B of the forces F = A P + B, y0 and M of y(P) = y0 + M P
    found (m + d + 1 + 3d)       P, y, the residual, the multipliers of the levels
"""

# mypy: allow-untyped-defs, allow-untyped-calls
# numba types the functions by their calls
from collections.abc import Callable
from math import inf, pi

from allocator.allocation.box.kernel.batch import FUNCTIONS as OTHERS
from allocator.allocation.box.kernel.batch import residual
from allocator.allocation.box.kernel.data import Box, Levels, carved, matrix, vector
from allocator.allocation.box.kernel.levels import prepare, solve
from allocator.allocation.status import CLOSED_FORM, Status
from allocator.allocation.two_muscles.kernels.source import EXACT, clip, interval
from allocator.checks import LOOKS_LIKE_BAR

MET, BINDS = CLOSED_FORM
TRUSTED = 1e-7  # an answer with a greater optimality residual is a failure
STRETCHED = 1e-9  # of the contraction ratio: nearer to the threshold counts as on it
SYMMETRIC = 1e-9  # of a stiffness's greatest entry
LIKE_BAR = LOOKS_LIKE_BAR[1]  # [Pa]
HUGE = 1e300
TURN = 2 * pi
TORQUE_LIMITED, STIFFNESS_LIMITED, UNSTABLE = (
    int(Status.TORQUE_LIMITED),
    int(Status.STIFFNESS_LIMITED),
    int(Status.UNSTABLE),
)
OUTSIDE_JOINT_RANGE, SOLVER_FAILED = int(Status.OUTSIDE_JOINT_RANGE), int(Status.SOLVER_FAILED)
ODD = -1  # instead of a status: possibly invalid, to be judged by the readable checks


def answer(asked, fixed, posture, floats, places, signs, found, n, m, diagonal, stiffness_first, nearest):
    """Fill `found` and return (status, guesses, the targets missed, whether K is positive definite).

    The status is `ODD` if the readable implementation must answer.

    `diagonal`: only K's diagonal is given. `nearest`: prefer pressures near the present ones to the least.
    """
    d = n + n * (n + 1) // 2
    q, asked = vector(asked, n)
    T, asked = vector(asked, n)
    K, asked = matrix(asked, n, n)
    now, ends = vector(asked, m)
    if not sensible(q, T, K, now, ends, diagonal, nearest):
        return ODD, 0, 0, False
    work, floats, places, signs = carved(floats, places, signs, d, m, 2)
    levels, box, floats, places, signs = rows_and_box(floats, places, signs, d, m)
    y, floats = vector(floats, d)
    x, floats = vector(floats, m)
    rest, floats = matrix(floats, n, n)
    side, signs = vector(signs, m + d)
    held, signs = vector(signs, m + d)
    P, found = vector(found, m)
    given, found = vector(found, d)
    proof, found = vector(found, 1)
    mu, found = matrix(found, 3, d)
    status = within(q, now, ends, fixed, posture, box, n, m, d, nearest)
    if status == ODD:
        return ODD, 0, 0, False
    fill(T, K, fixed, posture, levels, y, n, m, d, diagonal, stiffness_first)
    if not diagonal and not holds(y, rest, n):
        return ODD, 0, 0, False
    prepare(levels, work)
    rounds = solve(levels, box, x, side, mu, False, work)
    proof[0] = residual(levels, box, x, mu, 0.0, BINDS, held, work) if rounds > 0 else inf
    missed = judged(x, y, fixed, posture, box, P, given, n, m, d, diagonal)
    status = max(status, missed)
    stiff = holds(given, rest, n)
    if not stiff:
        status = max(status, UNSTABLE)
    if not proof[0] <= TRUSTED:
        status = max(status, SOLVER_FAILED)
    return status, rounds, missed, stiff


def rows_and_box(floats, places, signs, d, m):
    """Return the memory of the rows and of the box of a target, and the rest of the flat arrays."""
    A, floats = matrix(floats, d, m)
    b, floats = vector(floats, d)
    lo, floats = vector(floats, m)
    hi, floats = vector(floats, m)
    centre, floats = vector(floats, m)
    onesided, signs = vector(signs, d)
    ends, places = vector(places, 2)
    return Levels(A, b, onesided, ends), Box(lo, hi, centre), floats, places, signs


def answers(asked, fixed, postures, floats, places, signs, found, n, m, diagonal, stiffness_first, nearest):
    """Answer N targets, whose arrays are rows of `asked`, `postures` and `found`.

    Add the results of `answer` to the end of each `found`, and return False if the readable implementation must answer.
    """
    for i in range(len(asked)):
        arrays, facts = (asked[i], fixed, postures[i], floats, places, signs, found[i]), found[i, -4:]
        status, rounds, missed, stiff = answer(*arrays, n, m, diagonal, stiffness_first, nearest)
        facts[0], facts[1], facts[2], facts[3] = status, rounds, missed, stiff
        if status == ODD:
            return False
    return True


def sensible(q, T, K, now, ends, diagonal, nearest):
    """Return whether all numbers are finite and plausible in their units, and K symmetric with a positive diagonal."""
    n, largest, gap = len(q), 0.0, 0.0
    good = ends[0] < ends[1]
    for i in range(n):
        good = good and -TURN <= q[i] <= TURN and -HUGE < T[i] < HUGE and 0.0 < K[i, i] < HUGE
        for j in range(n):
            if not diagonal:
                largest = max(largest, abs(K[i, j]))
                gap = max(gap, abs(K[i, j] - K[j, i]))
                good = good and -HUGE < K[i, j] < HUGE
    good = good and gap <= SYMMETRIC * largest
    if nearest:
        greatest, step = 0.0, ends[2]
        for j in range(len(now)):
            greatest = max(greatest, abs(now[j]))
            good = good and -HUGE < now[j] < HUGE
        good = good and (greatest == 0.0 or greatest > LIKE_BAR) and step > LIKE_BAR
    return good


def within(q, now, ends, fixed, posture, box, n, m, d, nearest):
    """Fill the box, in units of x; return a muscle's or the posture's status, `ODD` if a force falls."""
    least, greatest, step = ends
    low, unit, near, stretched = fixed[2 * n + m + d :]
    lo, hi, centre = box
    status = EXACT
    for i in range(n):
        if q[i] < fixed[i] or q[i] > fixed[n + i]:
            status = OUTSIDE_JOINT_RANGE
    for j in range(m):
        eps, gain, force = posture[j], posture[m + j], posture[2 * m + j]
        if not gain > 0.0:
            return ODD
        nearby, farthest = (now[j] - step, now[j] + step) if nearest else (-inf, inf)
        bounds = (low, fixed[2 * n + j], (least - force) / gain, (greatest - force) / gain, nearby, farthest)
        bottom, top, muscle = interval(bounds, near)
        lo[j], hi[j], centre[j] = bottom / unit, top / unit, now[j] / unit if nearest else 0.0
        status = max(status, muscle)
        if eps < stretched - STRETCHED:
            status = max(status, OUTSIDE_JOINT_RANGE)
    return status


def fill(T, K, fixed, posture, levels, y, n, m, d, diagonal, stiffness_first):
    """Fill the targets `y` and the rows, level after level; free entries have rows of zeros."""
    A, b, onesided, ends = levels
    weights, y0, M = fixed[2 * n + m :], posture[3 * m :], posture[3 * m + d :]
    unit = fixed[2 * n + m + d + 1]
    ends[0], ends[1] = d - n if stiffness_first else n, d
    for i in range(n):
        y[i] = T[i]
    entry = n
    for i in range(n):
        for j in range(i, n):
            y[entry] = K[i, j] if i == j or not diagonal else 0.0
            entry += 1
    for i in range(d):
        row = i if not stiffness_first else (i + d - n if i < n else i - n)
        weight = weights[i] if is_asked(i, n, diagonal) else 0.0
        b[row], onesided[row] = weight * (y[i] - y0[i]), 0
        for j in range(m):
            A[row, j] = weight * unit * M[i * m + j]


def is_asked(entry, n, diagonal):
    """Return whether an entry of y is requested: all torques, and of K all or the diagonal K11, K22, …"""
    if entry < n or not diagonal:
        return True
    at = n
    for i in range(n):
        if entry == at:
            return True
        at += n - i
    return False


def judged(x, y, fixed, posture, box, P, given, n, m, d, diagonal):
    """Fill the pressures, torques and stiffnesses; return which of torque and stiffness are missed."""
    unit, y0, M, missed = fixed[2 * n + m + d + 1], posture[3 * m :], posture[3 * m + d :], 0
    for j in range(m):
        x[j] = clip(x[j], box.lo[j], box.hi[j])
        P[j] = x[j] * unit
    for i in range(d):
        total, scale_of = y0[i], abs(y0[i]) + abs(y[i])
        for j in range(m):
            total += M[i * m + j] * P[j]
            scale_of += abs(M[i * m + j] * box.hi[j]) * unit
        given[i] = total
        if is_asked(i, n, diagonal) and abs(total - y[i]) > MET * scale_of:
            missed = missed | (TORQUE_LIMITED if i < n else STIFFNESS_LIMITED)
    return missed


def holds(given, left, n):
    """Return whether the achieved stiffness is positive definite, by the pivots of its elimination in `left` (n, n)."""
    entry, largest = n, 0.0
    for i in range(n):
        for j in range(i, n):
            left[i, j] = left[j, i] = given[entry]
            largest = max(largest, abs(given[entry]))
            entry += 1
    for i in range(n):
        if not left[i, i] > MET * largest:
            return False
        for j in range(i + 1, n):
            share = left[j, i] / left[i, i]
            for k in range(i + 1, n):
                left[j, k] -= share * left[i, k]
    return True


FUNCTIONS: tuple[Callable[..., object], ...] = (
    *OTHERS,
    *(matrix, vector, carved, rows_and_box, interval, clip),
    *(sensible, within, fill, is_asked, judged, holds),
)
