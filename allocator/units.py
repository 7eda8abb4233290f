"""Units to multiply by at the edge of the program; inside, everything is SI (Pa, rad, m, N).

>>> 3 * BAR
300000.0
"""

from math import pi
from typing import Final

BAR: Final = 1e5  # [Pa]
KPA: Final = 1e3  # [Pa]
MPA: Final = 1e6  # [Pa]
PSI: Final = 6894.757293168361  # [Pa]
DEG: Final = pi / 180  # [rad]
MM: Final = 1e-3  # [m]
CM3: Final = 1e-6  # [m³]
PERCENT: Final = 1e-2  # [-]
