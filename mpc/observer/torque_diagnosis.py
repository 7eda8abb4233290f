"""Torque faults of a machine: a broken cable or a load as the cause of the observer's disturbance d̂.

For n joints with m muscles, torques are rows in Rⁿ, in units of a muscle's usual torque at each joint, T_usual,i.
Without muscle j the torque T_j(q, P_j) is missing: d̂ is at b - T_j, b being its mean over the last MEMORY seconds, and
follows T_j; that of a load is constant. The increments Δ over LATELY seconds distinguish the two, by the likelihood
ratio

    Λ_j := max(0, Λ_j + (min(|Δd̂|²/s², Z²) - min(|Δd̂ + ΔT_j|²/s², Z²))/2),   s = SPREAD T_usual

in which increments that neither explains do not count (beyond Z). A cable is likely if Λ_j > LIMIT and d̂ has just
been there while the muscle pulled: the machine is displaced, so that T_j changes at once. It is suspected once it has
been likely for CONFIRMED seconds, because a payload swings the machine alike at first: with inertia that the model does
not have, d̂ follows the torque of the stretched muscle until the payload hangs still. Beyond a usual load, |d̂ - b| >
LOAD T_usual, it is suspected at once. If there are several, the one
whose b - T_j is nearest to the disturbance is suspected, until its muscle is seen to pull for `HOLD` seconds.

If |d̂_i| exceeds LOAD T_usual,i + MISMATCH Σ_j |T_ji| for LASTING seconds, there is a load at joint i or an error of
its angle: at constant stiffness an angle error δ acts like the torque K δ, and no sensor distinguishes the two.

The functions work on a memory like those of `mpc.observer.pressure_diagnosis`.
"""

from math import copysign, inf, nan, sqrt

from mpc.observer.pressure_diagnosis import HOLD, Numbers, Values

MEMORY = 2.0  # [s]
SPREAD = 0.05  # of an increment of d̂ [T_usual]
Z = 3.0
LIMIT = 12.0  # of Λ: e^12 to 1
LOAD = 1.5  # [T_usual] of usual loads
MISMATCH = 0.15  # of the muscles' strength [-]
LATELY = 0.05  # [s]
CONFIRMED = 0.4  # [s]
LASTING = 0.3  # [s], longer than a broken cable takes
_NEAR, _NEARER = 0.2, 1 / 3  # of |T_j| + T_usual, and of |T_j|: how near d̂ has to be to b - T_j
_PULLS = 0.4  # [T_usual]

BROKEN = 0  # muscle, NONE of them
SINCE = 1  # its cable has been likely to be broken [s]
PULLED = 2  # time for which its muscle has been seen to pull since [s]
COUNT = 3  # of the samples put into the past
LOADED = 4  # and following: time since which each joint has more than a usual load [s]; NaN: it has not
NONE = -1.0
# after LOADED of n joints: MEAN b [N·m], NaN at first, and FROM when |d̂| began to be large [s], of n joints each; the
# RATIO Λ, MISSING, the last time [s] at which d̂ was that of a broken cable, and UNLIKELY, the last time [s] at which
# the cable was not likely to be broken, of m muscles each; the past, that is (d̂, T_1, …, T_m) of the samples within
# LATELY


def past_of(n: int, m: int) -> int:
    """Return the place of the past of `n` joints and `m` muscles."""
    return LOADED + 3 * n + 3 * m


class TorqueDiagnosis:
    """Diagnosis of n joints with `m` muscles, which usually pull with `usual` (n,) [N·m] each."""

    def __init__(self, dt: float, usual: list[float], m: int = 2) -> None:
        self.dt, self.usual, self.m = dt, usual, m
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        n, m = len(self.usual), self.m
        self.numbers: list[float] = [0.0] * (past_of(n, m) + n * (m + 1) * max(round(LATELY / self.dt), 1))
        self.numbers[BROKEN] = NONE
        self.numbers[LOADED : LOADED + 2 * n] = [nan] * (2 * n)
        self.numbers[past_of(n, m) - 2 * m : past_of(n, m)] = [-inf] * m + [nan] * m

    @property
    def broken(self) -> int | None:
        """Index of the muscle with the suspected cable."""
        return None if self.numbers[BROKEN] == NONE else int(self.numbers[BROKEN])

    @property
    def since(self) -> float:
        """Time since which the suspected cable has been likely to be broken [s]."""
        return self.numbers[SINCE]

    @property
    def loaded(self) -> list[float | None]:
        """Time since which each joint (n,) has more than a usual load [s]."""
        return [None if since != since else since for since in self.numbers[LOADED : LOADED + len(self.usual)]]


def follow(x: Numbers, dt: float, usual: Values, t: float, d: Values, pulls: Values, m: int) -> None:
    """Update by the observer's `d` (n,) [N·m] at `t` [s] and the `pulls` of the `m` muscles of its model.

    The latter are `mpc.observer.pulling.Pulls`: T (m, n) and ∂T/∂P (m, n) first.
    """
    n = len(usual)
    mean, begun, past, count = LOADED + n, LOADED + 2 * n, past_of(n, m), int(x[COUNT])
    row = n * (m + 1)
    size = (len(x) - past) // row
    place = past + row * (count % size)  # of the oldest sample of the past, which is replaced
    if x[mean] != x[mean]:
        for i in range(n):
            x[mean + i] = d[i]
    if count >= size:
        compare(x, place, dt, usual, t, d, pulls, m)
    for i in range(n):
        pulled = 0.0
        for j in range(m):
            pulled += abs(pulls[j * n + i])
        if abs(d[i]) <= LOAD * usual[i] + MISMATCH * pulled:
            x[begun + i] = t
        x[LOADED + i] = x[begun + i] if t - x[begun + i] > LASTING else nan
        if x[BROKEN] == NONE:
            x[mean + i] += dt / MEMORY * (d[i] - x[mean + i])
        x[place + i] = d[i]
    for i in range(n * m):
        x[place + n + i] = pulls[i]
    x[COUNT] = count + 1 if count + 1 < 2 * size else float(size)  # only its place and whether the past is full matter


def missing(x: Numbers, usual: Values, d: Values, pulls: Values, j: int, m: int) -> bool:
    """Return whether d̂ - b, seen along the torque of muscle `j`, opposes it with more than half of its size."""
    n, along, square, sense = len(usual), 0.0, 0.0, 0.0
    for i in range(n):
        T = pulls[j * n + i]
        along += (x[LOADED + n + i] - d[i]) * T / usual[i] ** 2
        square += (T / usual[i]) ** 2
        sense += T * pulls[(m + j) * n + i]
    return sense > 0 and square > _PULLS**2 and along > square / 2


def compare(x: Numbers, past: int, dt: float, usual: Values, t: float, d: Values, pulls: Values, m: int) -> None:
    """Compare loads and broken cables as explanations of the increments since the sample at `past`."""
    n, nearest, found = len(usual), inf, NONE
    ratio, as_load = LOADED + 3 * n, 0.0
    missing, unlikely = ratio + m, ratio + 2 * m
    for i in range(n):
        as_load += ((d[i] - x[past + i]) / (SPREAD * usual[i])) ** 2
    for j in range(m):
        as_broken, pull, off, away = explained(x, past, usual, d, pulls, j, m)
        gained = (min(as_load, Z**2) - min(as_broken, Z**2)) / 2
        x[ratio + j] = min(max(x[ratio + j] + gained, 0.0), 2 * LIMIT)
        can_tell = pull > _PULLS  # else its cable cannot be judged
        if can_tell and off < min(_NEAR * (pull + 1), _NEARER * pull) and away > pull / 2:
            x[missing + j] = t
        if x[BROKEN] == j:
            x[PULLED] = x[PULLED] + dt if can_tell and x[missing + j] < t else 0.0
            x[BROKEN] = NONE if x[PULLED] > HOLD else float(j)
        if not (x[ratio + j] > LIMIT and t - x[missing + j] < LASTING / 2):
            x[unlikely + j] = t
        elif x[BROKEN] == NONE and (t - x[unlikely + j] > CONFIRMED or away > LOAD) and off < nearest:
            nearest, found = off, float(j)
    if x[BROKEN] == NONE and found != NONE:
        x[BROKEN], x[SINCE], x[PULLED] = found, x[unlikely + int(found)], 0.0


def explained(
    x: Numbers, past: int, usual: Values, d: Values, pulls: Values, j: int, m: int
) -> tuple[float, float, float, float]:
    """Return the increments that a broken cable of muscle `j` leaves unexplained [s²], its pull, and the distances of
    d̂ from b - T_j and from b [T_usual].
    """
    n = len(usual)
    left, pulled, sense, off, away = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        T, b = pulls[j * n + i], x[LOADED + n + i]
        increment = d[i] - x[past + i] + T - x[past + n + j * n + i]
        left += (increment / (SPREAD * usual[i])) ** 2
        pulled += (T / usual[i]) ** 2
        sense += T * pulls[(m + j) * n + i]  # ∂T/∂P is along the arms: < 0 if a model lets the muscle push
        off += ((d[i] + T - b) / usual[i]) ** 2
        away += ((d[i] - b) / usual[i]) ** 2
    return left, copysign(sqrt(pulled), sense), sqrt(off), sqrt(away)
