"""Ringing loops: a joint swings with a common period, does not come to rest, and the model does not explain the motion.

Readings or commands that are older than the observer assumes reduce the phase margin of the loop. At the stability
limit the angle swings, and so do the innovations and the disturbance torque d̂, which is their sum. Turning points are
the extrema of the estimated velocity ω from which it has returned by more than NOISE and by BACK of the previous swing.
The loop rings if of the last SWINGS swings between turning points, including the present one,

    each took τ between LEAST and MOST, and none SPREAD times as long as another one,
    each turned the joint by more than SIZE, which is τ |Δω|/π of a sine,
    each moved d̂ by more than UNEXPLAINED of the torque J |Δω| π/τ that accelerates the link,
    each was KEPT to GAINED of the one before, and the present one is GROWTH of the greatest.

A slower reference does not count, nor does a faster one that the model explains. If the model leaves 5 % of the torque
unexplained, a reference of 1.4 Hz or more looks like ringing. The response to a load decays, and a jump of the
reference that follows it is larger than the next swing of a ringing loop.

MOST cannot be raised. d̂ does not tell a loop that rings at 1.0 to 1.4 Hz, under a heavy payload, from a sound one that
follows a sine of 0.75 to 1.3 Hz: on simulated joints of other structures, with fitted models, d̂ moved by 1.0 to 2.7 of
the torque J |Δω| π/τ in the first and by 0.1 to 2.3 in the second. The functions work on a memory m as those of
`mpc.observer.pressure_diagnosis` do.
"""

from math import inf, nan, pi

from allocator.units import DEG
from mpc.observer.pressure_diagnosis import HOLD, Numbers

NOISE = 0.15  # [rad/s]
BACK = 0.2  # [-]
SWINGS = 4
LEAST, MOST = 0.05, 0.36  # [s] of half a period
SPREAD = 1.8  # [-]
SIZE = 4 * DEG  # peak to peak [rad]
UNEXPLAINED = 0.05  # [-]
KEPT, GAINED, GROWTH = 0.65, 2.0, 0.8  # [-]

(
    SINCE,  # time since which the loop rings [s]; NaN: it does not
    FREQUENCY,  # [Hz]
    ILL,  # last time of ringing [s]
    SIGN,  # of the present swing; 0 at first
    EXTREME, AT,  # ω at its extreme [rad/s], NaN at first, and the time [s]
    LOWEST, HIGHEST,  # d̂ in the present swing [N·m]
    COUNT,  # of the turning points below, up to SWINGS
    TURNS,  # and following: (time [s], ω [rad/s], range of d̂ in the swing before [N·m]), newest first
) = range(10)  # fmt: skip
PLACES = TURNS + 3 * SWINGS
_OLDEST = PLACES - 3


class RingingDiagnosis:
    """Diagnosis of the loop of one joint with the inertia `inertia` [kg·m²]."""

    def __init__(self, inertia: float) -> None:
        self.inertia = inertia
        self.reset()

    def reset(self) -> None:
        """Forget the past samples."""
        self.numbers: list[float] = [0.0] * PLACES
        self.numbers[SINCE] = nan
        begin(self.numbers)

    @property
    def since(self) -> float | None:
        """Time since which the loop rings [s]."""
        return None if self.numbers[SINCE] != self.numbers[SINCE] else self.numbers[SINCE]

    @property
    def frequency(self) -> float:
        """Frequency at the onset of ringing [Hz]."""
        return self.numbers[FREQUENCY]


def begin(m: Numbers) -> None:
    """Forget the swings, as after a reading that was not believed."""
    m[SIGN] = m[COUNT] = 0.0
    m[EXTREME], m[LOWEST], m[HIGHEST] = nan, inf, -inf


def follow(m: Numbers, inertia: float, t: float, omega: float, d: float) -> None:
    """Update by the observer's velocity `omega` [rad/s] and torque `d` [N·m] at `t` [s]."""
    if m[EXTREME] != m[EXTREME]:
        m[EXTREME], m[AT] = omega, t
    off = omega - m[EXTREME]
    swing = abs(m[EXTREME] - m[TURNS + 1]) if m[COUNT] > 0 else 0.0
    if m[SIGN] * off > 0:
        m[EXTREME], m[AT] = omega, t
    elif abs(off) > max(NOISE, BACK * swing):
        for i in range(PLACES - 1, TURNS + 2, -1):
            m[i] = m[i - 3]
        m[TURNS], m[TURNS + 1], m[TURNS + 2] = m[AT], m[EXTREME], m[HIGHEST] - m[LOWEST]
        m[COUNT] = min(m[COUNT] + 1, float(SWINGS))
        m[SIGN], m[EXTREME], m[AT], m[LOWEST], m[HIGHEST] = (1.0 if off > 0 else -1.0), omega, t, d, d
    m[LOWEST], m[HIGHEST] = min(m[LOWEST], d), max(m[HIGHEST], d)
    if rings(m, inertia, t):
        m[ILL] = t
        if m[SINCE] != m[SINCE]:
            m[SINCE] = m[_OLDEST]
            m[FREQUENCY] = (SWINGS - 1) / 2 / (m[TURNS] - m[_OLDEST])
    elif t - m[ILL] > HOLD:
        m[SINCE] = nan


def rings(m: Numbers, inertia: float, t: float) -> bool:
    """Return whether the last swings are those of a ringing loop."""
    if m[COUNT] < SWINGS:
        return False
    present = abs(m[EXTREME] - m[TURNS + 1])
    shortest, longest, greatest, later, good = MOST, 0.0, 0.0, present, True
    for i in range(TURNS, _OLDEST, 3):
        time, swing = m[i] - m[i + 3], abs(m[i + 1] - m[i + 4])
        good = good and LEAST < time < MOST and time * swing / pi > SIZE and KEPT * swing <= later <= GAINED * swing
        good = good and m[i + 2] > UNEXPLAINED * inertia * swing * pi / time
        shortest, longest, greatest, later = min(shortest, time), max(longest, time), max(greatest, swing), swing
    lasts = shortest / 2 <= m[AT] - m[TURNS] and t - m[TURNS] < MOST
    return bool(good and lasts and longest < SPREAD * shortest and present >= GROWTH * greatest)
