"""What may be wrong with a joint's torque is found here: the disturbance d̂ of the observer as a broken cable or as a
load.

Without muscle i the torque -T_i(θ, P_i) is missing: d̂ is at b - T_i, b being its mean over the last MEMORY seconds, and
follows T_i; that of a load stays. The increments Δ over LATELY seconds tell the two apart, by the likelihood ratio

    Λ_i := max(0, Λ_i + (min(Δd̂²/s², Z²) - min((Δd̂ + ΔT_i)²/s², Z²))/2),   s = SPREAD T_usual

in which increments that neither explains do not count (beyond Z). A cable is suspected where Λ_i > LIMIT and d̂ has just
been there while the muscle pulled: the joint is thrown aside, so that T_i changes at once. A cable stays suspected
until its muscle is seen to pull for `HOLD` seconds.

Whatever makes |d̂| more than LOAD T_usual + MISMATCH (|T_1| + |T_2|) for LASTING seconds is a load, or an angle that is
read wrongly: at constant stiffness an error δ of the angle is the torque K δ, and no sensor tells the two apart.

The functions work on numbers m as those of `mpc.observer.pressure_diagnosis` do.
"""

from math import inf, nan

from mpc.observer.pressure_diagnosis import HOLD, Numbers

MEMORY = 2.0  # [s]
SPREAD = 0.05  # of an increment of d̂ [T_usual]
Z = 3.0
LIMIT = 12.0  # of Λ: e^12 to 1
LOAD = 1.5  # [T_usual] that nobody need be told of
MISMATCH = 0.15  # of the muscles' strength [-]
LATELY = 0.05  # [s]
LASTING = 0.3  # [s], longer than a broken cable takes
_NEAR = 0.2  # of T_i and of T_usual: how near d̂ has to be to b - T_i
_PULLS = 0.4  # [T_usual]

(
    BROKEN,  # muscle 0 or 1, NONE of them
    SINCE,  # its cable is suspected [s]
    LOADED,  # since when there is more than a usual load [s]; NaN: there is not
    MEAN,  # b [N·m]; NaN at first
    FROM, ILL,  # when |d̂| began to be large, and when the cable last was to be suspected [s]
    RATIO, _,  # Λ of both muscles
    MISSING, _,  # when d̂ last was where a broken cable of each would put it [s]
    COUNT,  # of what was put into PAST
    PAST,  # and following: (d̂, T_1, T_2) of the samples within LATELY
) = range(12)  # fmt: skip
NONE = -1.0


def places(dt: float) -> int:
    """Return how many numbers are remembered at the sample time `dt` [s]."""
    return PAST + 3 * max(round(LATELY / dt), 1)


class TorqueDiagnosis:
    """The diagnosis is of one joint whose muscles usually pull with `usual` [N·m] each."""

    def __init__(self, dt: float, usual: float) -> None:
        self.dt, self.usual = dt, usual
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.numbers: list[float] = [0.0] * places(self.dt)
        self.numbers[BROKEN], self.numbers[LOADED], self.numbers[MEAN] = NONE, nan, nan
        self.numbers[MISSING] = self.numbers[MISSING + 1] = -inf

    @property
    def broken(self) -> int | None:
        """Return muscle 0 or 1, whose cable is suspected."""
        return None if self.numbers[BROKEN] == NONE else int(self.numbers[BROKEN])

    @property
    def since(self) -> float:
        """Return since when a cable is suspected [s]."""
        return self.numbers[SINCE]

    @property
    def loaded(self) -> float | None:
        """Return since when [s] there is more than a usual load."""
        return None if self.numbers[LOADED] != self.numbers[LOADED] else self.numbers[LOADED]

    def follow(self, t: float, d: float, T1: float, T2: float) -> None:
        """Follow the observer, as the function does."""
        follow(self.numbers, self.dt, self.usual, t, d, T1, T2)


def follow(m: Numbers, dt: float, usual: float, t: float, d: float, T1: float, T2: float) -> None:
    """Follow the observer, which finds `d` at `t` [s] while the muscles of its model pull with `T1` and `T2` [N·m]."""
    size, count = (len(m) - PAST) // 3, int(m[COUNT])
    place = PAST + 3 * (count % size)  # of the oldest of the past, which is forgotten
    if m[MEAN] != m[MEAN]:
        m[MEAN] = d
    if count >= size:
        compare(m, place, usual, t, d, T1, T2)
    if abs(d) <= LOAD * usual + MISMATCH * (abs(T1) + abs(T2)):
        m[FROM] = t
    m[LOADED] = m[FROM] if t - m[FROM] > LASTING else nan
    if m[BROKEN] == NONE:
        m[MEAN] += dt / MEMORY * (d - m[MEAN])
    m[place], m[place + 1], m[place + 2] = d, T1, T2
    m[COUNT] = m[COUNT] + 1 if m[COUNT] + 1 < 2 * size else float(size)  # it only matters where, and whether all are


def compare(m: Numbers, past: int, usual: float, t: float, d: float, T1: float, T2: float) -> None:
    """Compare what a load and what broken cables explain of the increments since what is at `past`."""
    T, s, b = (T1, T2), SPREAD * usual, m[MEAN]
    increment = d - m[past]
    as_load = min(increment**2 / s**2, Z**2)
    for i in range(2):
        as_broken = min((increment + T[i] - m[past + 1 + i]) ** 2 / s**2, Z**2)
        m[RATIO + i] = min(max(m[RATIO + i] + (as_load - as_broken) / 2, 0.0), 2 * LIMIT)
        pull = T[i] if i == 0 else -T[i]
        pulls = pull > _PULLS * usual  # else nothing can be told of its cable
        if pulls and abs(d + T[i] - b) < _NEAR * (pull + usual) and abs(d - b) > pull / 2:
            m[MISSING + i] = t
        if m[BROKEN] == i:
            m[ILL] = max(m[ILL], m[MISSING + i]) if pulls else t
            m[BROKEN] = NONE if t - m[ILL] > HOLD else float(i)
        elif m[BROKEN] == NONE and m[RATIO + i] > LIMIT and t - m[MISSING + i] < LASTING / 2:
            m[BROKEN], m[SINCE], m[ILL] = float(i), t, t
