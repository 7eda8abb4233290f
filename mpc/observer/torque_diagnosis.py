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
"""

from collections import deque
from math import inf

from mpc.observer.pressure_diagnosis import HOLD

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


class TorqueDiagnosis:
    """The diagnosis is of one joint whose muscles usually pull with `usual` [N·m] each."""

    def __init__(self, dt: float, usual: float) -> None:
        self.dt, self.usual = dt, usual
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.broken: int | None = None  # muscle 0 or 1
        self.since = 0.0  # [s] its cable is suspected
        self.loaded: float | None = None  # since when [s] there is more than a usual load
        self._ratios = [0.0, 0.0]  # Λ
        self._past: deque[tuple[float, float, float]] = deque(maxlen=max(round(LATELY / self.dt), 1))
        self._mean: float | None = None  # b [N·m]
        self._from = self._ill = 0.0  # [s] when |d̂| began to be large, and when the cable last was to be suspected
        self._missing = [-inf, -inf]  # [s] when d̂ last was where a broken cable would put it

    def follow(self, t: float, d: float, T1: float, T2: float) -> None:
        """Follow the observer, which finds `d` at `t` [s] while the muscles of its model pull with `T1` and `T2`
        [N·m].
        """
        now = d, T1, T2
        self._mean = d if self._mean is None else self._mean
        self._compare(t, now, self._mean)
        self._weigh(t, now)
        if self.broken is None:
            self._mean += self.dt / MEMORY * (d - self._mean)
        self._past.append(now)

    def _compare(self, t: float, now: tuple[float, float, float], b: float) -> None:
        if len(self._past) < (self._past.maxlen or 0):
            return
        (d, *T), (d_past, *T_past), s = now, self._past[0], SPREAD * self.usual
        as_load = min((d - d_past) ** 2 / s**2, Z**2)
        for i in (0, 1):
            as_broken = min((d - d_past + T[i] - T_past[i]) ** 2 / s**2, Z**2)
            self._ratios[i] = min(max(self._ratios[i] + (as_load - as_broken) / 2, 0.0), 2 * LIMIT)
            pull = -T[i] if i else T[i]
            pulls = pull > _PULLS * self.usual  # else nothing can be told of its cable
            if pulls and abs(d + T[i] - b) < _NEAR * (pull + self.usual) and abs(d - b) > pull / 2:
                self._missing[i] = t
            if self.broken == i:
                self._ill = max(self._ill, self._missing[i]) if pulls else t
                self.broken = None if t - self._ill > HOLD else i
            elif self.broken is None and self._ratios[i] > LIMIT and t - self._missing[i] < LASTING / 2:
                self.broken, self.since, self._ill = i, t, t

    def _weigh(self, t: float, now: tuple[float, float, float]) -> None:
        d, T1, T2 = now
        if abs(d) <= LOAD * self.usual + MISMATCH * (abs(T1) + abs(T2)):
            self._from = t
        self.loaded = self._from if t - self._from > LASTING else None


__all__ = ["LASTING", "LATELY", "LIMIT", "LOAD", "MEMORY", "MISMATCH", "SPREAD", "TorqueDiagnosis", "Z"]
