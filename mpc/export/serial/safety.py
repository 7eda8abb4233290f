"""What a board does when its host falls silent is said here."""

from dataclasses import dataclass
from math import isfinite

from allocator import checks
from allocator.errors import InvalidInput
from allocator.units import BAR

_LONGEST = 1e3  # [s] of a watchdog; the board's clock begins anew after 4295 s


@dataclass(frozen=True)
class Safety:
    """The safety of a board is what it does when the host is silent."""

    watchdog: float = 0.2  # silence after which the pressures fall [s]
    fall: float = 1 * BAR  # how fast the higher of them falls [Pa/s]; 0: they are held, inf: at once

    def __post_init__(self) -> None:
        """Check both. Raises InvalidInput."""
        watchdog = checks.positive("watchdog", self.watchdog, "s")
        if not 1e-3 <= watchdog <= _LONGEST:
            raise InvalidInput(f"watchdog = {watchdog:g} s has to be between 0.001 and {_LONGEST:g} s")
        fall = float(self.fall)
        if not fall >= 0 or (isfinite(fall) and 0 < fall < BAR / 1e3):
            raise InvalidInput(f"fall = {fall:g} Pa/s has to be 0 (hold), inf (at once) or 100 Pa/s at least")
