"""Tuned numbers of a control loop: their names, the resulting settings, and the table [tuning] of a plant's file.

[tuning]                       # SI units; written by `antagonist tune`, used by `track`, `run` and `export`
controller = "mpc"             # the loop of these numbers
theta_error = 0.0028           # error that costs one half, 1/√weight [rad]; and so on
…

The loops are those of `mpc.trials.loops`, with these numbers in place of the defaults.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple, Self

from allocator import checks
from allocator.errors import InvalidInput, MissingBackend
from allocator.files.text import FilePath
from allocator.files.toml import Table, section
from allocator.units import BAR, DEG
from mpc.trials.loops import GAINS, Settings
from mpc.yardsticks.baselines import (
    PIDGains,
)

TABLE = "tuning"


class Parameter(NamedTuple):
    """Tunable number on a logarithmic scale."""

    start: Callable[[Settings], float]  # its default
    low: float
    high: float
    unit: str  # in SI
    shown: float = 1.0  # the tables' unit, in SI
    symbol: str = ""  # symbol of that unit


@dataclass(frozen=True)
class Tuning:
    """Tuned numbers of one kind of loop, SI units; immutable.

    Raises `InvalidInput` for loops without such numbers, other names, and numbers that are not positive.
    """

    controller: str
    numbers: Mapping[str, float]

    def __post_init__(self) -> None:
        """Check names and numbers."""
        parameters = parameters_of(self.controller)
        if set(self.numbers) != set(parameters):
            raise InvalidInput(f"the tuning of {self.controller} consists of {', '.join(parameters)}")
        numbers = {name: checks.positive(name, self.numbers[name], p.unit) for name, p in parameters.items()}
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __reduce__(self) -> tuple[object, ...]:
        """Pickle the numbers as a dictionary."""
        return type(self), (self.controller, dict(self.numbers))

    @classmethod
    def start(cls, controller: str, settings: Settings) -> Self:
        """Return the defaults."""
        return cls(controller, {name: p.start(settings) for name, p in parameters_of(controller).items()})

    @classmethod
    def load(cls, path: FilePath) -> Self | None:
        """Read the table [tuning] of a plant's file; None if it has none. Raises `InvalidFile`."""
        table = Table.read(path).table(TABLE)
        if table is None:
            return None
        entries = dict(table.entries)
        controller = entries.pop("controller", "")
        try:
            return cls(controller, entries)
        except (InvalidInput, MissingBackend) as error:
            raise table.fault(error) from None

    def lines(self) -> list[str]:
        """Return the lines of the table [tuning]."""
        return section(TABLE, {"controller": self.controller, **self.numbers}, "SI units; from `antagonist tune`")

    def applied(self, settings: Settings) -> Settings:
        """Return the settings with these numbers."""
        n = self.numbers
        errors = {name: n[f"{name}_error"] ** -2 for name in ("theta", "omega", "rate") if f"{name}_error" in n}
        noises = {name: n[key] for name, key in (("theta", "theta_noise"), ("d_walk", "d_walk")) if key in n}
        gains = {name: n[name] for name in _GAIN_UNITS if name in n}
        known, share = settings.compensation, n["friction_share"]
        frictions = tuple(one.share(share) for one in known.frictions)
        return settings._replace(
            weights=replace(settings.weights, **errors),
            noise=replace(settings.noise, **noises),
            gains=replace(PIDGains(1.0, 0.0, 0.0, 0.0), **gains) if gains else settings.gains,
            compensation=replace(known, friction=known.friction.share(share), frictions=frictions),
        )

    @property
    def summary(self) -> str:
        """One line with the numbers, in the units of tables."""
        parameters = parameters_of(self.controller)
        shown = (
            f"{name.replace('_', ' ')} {value / p.shown:.3g} {p.symbol}".strip()
            for (name, value), p in zip(self.numbers.items(), parameters.values(), strict=True)
        )
        return f"tuning of {self.controller} for this plant: {', '.join(shown)}"


def parameters_of(controller: str) -> Mapping[str, Parameter]:
    """Return the tunable numbers of a controller. Raises `MissingBackend` for an unknown one."""
    if controller not in list(TUNABLE):
        raise MissingBackend("controller to tune", controller, TUNABLE)
    return TUNABLE[controller]


_GAIN_UNITS = {"proportional": "N·m/rad", "integral": "N·m/rad/s", "derivative": "N·m·s/rad", "filter_time": "s"}
_RANGE = 20.0  # range of gains, relative to the usual ones


def _gains(controller: str) -> dict[str, Parameter]:
    """Return the nonzero gains of a PID."""
    usual = {name: float(getattr(GAINS[controller], name)) for name in _GAIN_UNITS}
    return {
        name: Parameter(lambda s, at=at: at, at / _RANGE, at * _RANGE, _GAIN_UNITS[name], 1.0, _GAIN_UNITS[name])  # type: ignore[misc]
        for name, at in usual.items()
        if at
    }


_SHARE = {"friction_share": Parameter(lambda s: 1.0, 0.5, 1.0, "-")}
_NOISES = {
    "theta_noise": Parameter(lambda s: s.noise.theta, 0.001 * DEG, 0.2 * DEG, "rad", DEG, "°"),
    "d_walk": Parameter(lambda s: s.noise.d_walk, 0.05, 20.0, "N·m/√s", 1.0, "N·m/√s"),
}
_ERRORS = {
    "theta_error": Parameter(lambda s: s.weights.theta**-0.5, 0.01 * DEG, 2 * DEG, "rad", DEG, "°"),
    "omega_error": Parameter(lambda s: s.weights.omega**-0.5, 0.5 * DEG, 200 * DEG, "rad/s", DEG, "°/s"),
    "rate_error": Parameter(lambda s: s.weights.rate**-0.5, 0.02 * BAR, 20 * BAR, "Pa/s", BAR, "bar/s"),
}
TUNABLE: Mapping[str, Mapping[str, Parameter]] = {
    "mpc": _ERRORS | _NOISES | _SHARE,
    "lqr": _ERRORS | _NOISES | _SHARE,
    "predictive-pid": _gains("predictive-pid") | _NOISES | _SHARE,
    "pid": _gains("pid") | _SHARE,
    "pi": _gains("pi") | _SHARE,
}
"""Tunable numbers, by the names of the loops."""
