"""Plant of a `MotionFit`: the file that holds it, and the errors of that file over the log.

The file holds all fitted numbers. If the log does not show inertia or damping, the file has the caller's values, or
those of `Plant()`. If the log contradicts these, the file has values too small to be seen in it.

Free run of a plant over the pressures of a log: no measured angle is fed back.

`free_run` simulates exactly the objects that `Plant.load` and `Compensation.load` return, so that an error stated for a
plant's file is the error of that file.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.atomic import write_text
from allocator.files.toml import Table, section
from allocator.identification.motion.problem import shares_of_lag
from allocator.identification.motion.result import Errors, MotionFit, MovingJoint
from allocator.identification.motion.samples import TAUT_FROM, MotionLog
from allocator.machine_file import dumps, encoder_zero_in
from allocator.units import DEG
from mpc.codegen.buffered import Buffered
from mpc.model.compensation import Compensation
from mpc.model.plant import NX, Plant
from mpc.model.real import RealPlant
from mpc.model.real_experiment import integrator

_RESOLUTION = 0.25  # of the integration, see `Plant.substeps`: 3e-5 of the change
_HELD = 1e6  # [s] lag of regulators whose pressures are imposed


def free_run(
    process: RealPlant, t: ArrayLike, P1: ArrayLike, P2: ArrayLike, *, begin: float | None = None,
    commanded: bool = True,
) -> Array:  # fmt: skip
    """Return the angle (n,) [rad] of `process` at the times `t` while the pressures of a log act on it.

    A link that reaches an end stop rests there until it is pulled back.

    Parameters
    ----------
    process
        The plant with its friction and regulators: `RealPlant.of(Plant.load(path), Compensation.load(path))`.
    t
        Times [s], increasing; arrays (n,), as are the pressures.
    P1, P2
        Pressures of agonist and antagonist [Pa, gauge]. Each holds until the next.
    begin
        Initial angle [rad] of the joint at rest; by default the equilibrium at the first pressures, or 0 if there is
        none.
    commanded
        Whether the pressures are commands for the regulators. If false, they are the pressures in the muscles,
        interpolated linearly between rows.

    Raises
    ------
    InvalidInput
        If the arrays are not rows of numbers of one length, or `t` does not increase.
    """
    times, one, two = checks.real("t", t, "s"), checks.pressure("P1", P1), checks.pressure("P2", P2)
    if times.ndim != 1 or not times.shape == one.shape == two.shape or times.size < 2:
        raise InvalidInput("t, P1 and P2 have to be rows of numbers, one of each for every sample")
    if not (np.diff(times) > 0).all():
        raise InvalidInput("t has to increase from row to row [s]")
    u = np.stack([one, two], axis=1)
    full = _start(process, u[0], begin)
    if not commanded:
        return _integrated(_without_regulators(process), times, (u[1:] + u[:-1]) / 2, full, imposed=True)
    ends, acting = _acting(times, process.dead_time)
    return _integrated(process, ends, u[acting], full)[np.searchsorted(ends, times)]


def _without_regulators(process: RealPlant) -> RealPlant:
    """Return `process` with imposed pressures, without regulators."""
    nominal = replace(process.nominal, lag=_HELD, gas=None, frequency=0.0)
    return replace(process.without("lag_up", "lag_down", "dead_time", "dead_band", "flow"), nominal=nominal)


def _acting(t: Array, dead_time: float) -> tuple[Array, Array]:
    """Return the times (m,) [s] between which one command acts, including `t`, and the command's index (m - 1,)."""
    ends = np.unique(np.concatenate([t, (t + dead_time)[t + dead_time < t[-1]]]))
    middle = (ends[1:] + ends[:-1]) / 2
    return ends, np.maximum(np.searchsorted(t, middle - dead_time, side="right") - 1, 0)


def _start(process: RealPlant, P: Array, begin: float | None) -> Array:
    """Return the state with friction's memory (n,) at rest at the pressures P (2,) [Pa]."""
    theta = (
        float(process.nominal.joint.equilibrium(*P, gravity=process.nominal.gravity)) if begin is None else float(begin)
    )
    theta = theta if np.isfinite(theta) else 0.0
    return np.append([theta, 0.0, *P], process.friction.begun(theta))


def _integrated(process: RealPlant, ends: Array, u: Array, full: Array, *, imposed: bool = False) -> Array:
    """Return the angle (m,) [rad] at the times `ends` (m,) [s], from the state `full` (n,) on.

    The commands `u[k]` (2,) [Pa] act between `ends[k]` and the next; `imposed`: the muscles have these pressures.
    """
    step = Buffered(integrator(process, process.substeps(float(np.diff(ends).max()), _RESOLUTION)))
    low, high = process.nominal.joint.angle_limits or (-np.inf, np.inf)
    theta = [float(full[0])]
    for command, length in zip(u, np.diff(ends).tolist(), strict=True):
        if imposed:
            full[2:NX] = command
        full = step(full, command, 0.0, length)[0][0]
        if not low <= full[0] <= high:  # a stop, which takes the speed
            full[:2] = min(max(full[0], low), high), 0.0
        theta.append(float(full[0]))
    return np.array(theta)


COMMANDED, IMPOSED = "commanded", "in the muscles"  # `pressures` in [source]


class Replay(NamedTuple):
    """Log of a moving joint, and the angles that a plant's file predicts for it."""

    log: MotionLog
    theta: Array  # as the encoder would show it (n,) [rad]

    def errors(self, judged: Mask | None = None) -> Errors:
        """Return the RMS errors [rad] over the rows `judged` (n,); by default those after the first two seconds."""
        rows, taut = self.log.settled if judged is None else judged, np.minimum(self.log.P1, self.log.P2) >= TAUT_FROM
        return Errors.of(self.log.theta - self.theta, rows, taut)


def replay(path: str | PathLike[str], log: MotionLog) -> Replay:
    """Run the plant in the file `path` over the pressures of `log`, from the first angle on.

    The plant is loaded by `Plant.load` and `Compensation.load`, as for commands, controllers and observers. The file's
    table [source] holds the encoder's zero, and whether the pressures of the log are commands. Raises `InvalidFile`.
    """
    real = RealPlant.of(Plant.load(path, scale_needed=False), Compensation.load(path, scale_needed=False))
    file = Table.read(path)
    table = file.table("source")
    zero = encoder_zero_in(file)
    pressures = COMMANDED if table is None else table.entries.get("pressures", COMMANDED)
    if pressures not in (COMMANDED, IMPOSED):
        raise InvalidFile(path, f"[source]: pressures has to be {COMMANDED!r} or {IMPOSED!r}")
    commanded = pressures == COMMANDED
    theta = []
    for part in log.parts:
        t, begin = log.t[part], float(log.theta[part.start]) - zero
        run = free_run(real, t, log.P1[part], log.P2[part], begin=begin, commanded=commanded)
        theta.append(np.interp(t - real.reading_age, t, run) + zero)
    return Replay(log, np.concatenate(theta))


_REGULATORS = ("dead_time", "dead_band", "lag_up", "lag_down", "filling")
_LEAST_BAND = 100.0  # [Pa] below which there is none
_SHORTEST = 0.25  # samples of the log, below which no lag is seen
_UNSEEN = 0.5  # samples of the log: invisible time constant of damping; half of it for inertia
_CONTRADICTED = 1.05  # growth of the error above which the log contradicts an inertia


@dataclass(frozen=True)
class IdentifiedPlant:
    """File of a plant that was fitted to a log, and the errors of the file when it predicts angles. Immutable."""

    text: str  # TOML
    run: Replay  # of this file, over the log that it was fitted to
    errors: Errors  # of this file over the log [rad]
    last: Errors  # of this file over the last 40 % of the log
    held_out: Errors  # over the last 40 %, of a file made in the same way from the first 60 % alone
    assumed: tuple[str, ...]  # numbers of [plant] that the log does not show
    seen_slew: float | None = None  # [Pa/s] of [plant], if it is that of the log's commands

    @classmethod
    def of(cls, fit: MotionFit, known: Mapping[str, object] | None = None) -> Self:
        """Return the plant of `fit`; `known` has inertia, damping and slew, used if the log does not show them.

        Raises `InvalidInput` if the fit has no joint.
        """
        rows, early = fit.log.settled, fit.early
        unseen = _Written(fit, fit.moving_early, dict(known or {}), rows & early).best
        final = _Written(fit, fit.moving, dict(known or {}), rows)
        last, held_out = final.best.run.errors(~early), unseen.run.errors(~early)
        errors = final.best.run.errors()
        figures = {
            "rms_deg": errors.every,
            "rms_last_40_percent_deg": last.every,
            "held_out_rms_deg": held_out.every,
        }
        text = final.text(final.best.numbers, {name: round(value / DEG, 3) for name, value in figures.items()})
        return cls(text, final.best.run, errors, last, held_out, final.taken, final.seen_slew)

    @property
    def plant(self) -> Plant:
        """The plant as it is loaded from the file; raises as `save`, and `InvalidFile` for an unknown force scale."""
        with TemporaryDirectory() as directory:
            self.save(path := Path(directory) / "plant.toml")
            return Plant.load(path)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the file, for every command's --machine.

        Raises `InvalidInput` if its free run over the log leaves its geometry or force laws, `CannotWrite`.
        """
        if not np.isfinite(self.run.theta).all():
            t = self.run.log.t[np.argmin(np.isfinite(self.run.theta))]
            raise InvalidInput(
                f"the fitted plant cannot follow its own log: at {t:.3g} s its free run leaves the range of its "
                "geometry or force laws; see the warnings of the fit, or give a log with less motion"
            )
        write_text(path, self.text)


@dataclass(frozen=True)
class _Tried:
    numbers: Mapping[str, object]  # of [plant]
    run: Replay
    error: float  # over the rows that were fitted [rad]


@dataclass(frozen=True)
class _Written:
    """Texts of the plant of a moving joint, with one inertia or another."""

    fit: MotionFit
    moving: MovingJoint
    known: Mapping[str, object]
    used: Mask  # rows that were fitted (n,)

    @cached_property
    def best(self) -> _Tried:
        """The numbers of [plant], and the free run of the file with them."""
        usual = {name: self.known.get(name, getattr(Plant(), name)) for name in ("inertia", "damping")}
        if not self.assumed:
            return self._tried(usual)
        damping = max(self.moving.damping, self._least_damping)
        small = self._tried({"damping": damping, "inertia": damping * _UNSEEN * self.fit.log.step / 2})
        if not self.fit.scale_known:
            return small
        tried = self._tried(usual)
        return tried if tried.error < _CONTRADICTED * small.error else small

    @property
    def assumed(self) -> tuple[str, ...]:
        """Those of inertia and damping that the log does not show; zero damping with an inertia counts as shown."""
        if self.moving.inertia:
            return ()
        return ("inertia",) if self.moving.damping >= self._least_damping else ("damping", "inertia")

    @property
    def taken(self) -> tuple[str, ...]:
        """Names of the plant's unmeasured numbers: `assumed`, and the slew of the regulators unless it is known."""
        return (*self.assumed, *(() if self.seen_slew or "slew" in self.known else ("slew",)))

    @cached_property
    def seen_slew(self) -> float | None:
        """The fastest change [Pa/s] of the log's commands over a lag; None if it is not needed, or shows no commands.

        Over a lag, because regulators cannot tell a step from a slope that is as short.
        """
        if "slew" in self.known or not self._commanded:
            return None
        return self.fit.log.fastest(sum(self._lags.values()) / 2)

    @property
    def _least_damping(self) -> float:
        """Least damping that the log can show without an inertia [N·m·s/rad]."""
        return _UNSEEN * self.fit.log.step * self.moving.stiffness

    @cached_property
    def _commanded(self) -> bool:
        """True if the log shows that its pressures are commands rather than muscle pressures."""
        return any(self.moving.values[name] for name in _REGULATORS)

    @cached_property
    def _lags(self) -> dict[str, float]:
        shortest = _SHORTEST * self.fit.log.step
        return {name: max(self.moving.values[name], shortest) for name in ("lag_up", "lag_down")}

    def _tried(self, otherwise: Mapping[str, object]) -> _Tried:
        """Return the file's free run with inertia and damping as seen, or as in `otherwise`."""
        seen = {name: getattr(self.moving, name) for name in ("inertia", "damping") if name not in self.assumed}
        lag, shares = sum(self._lags.values()) / 2, shares_of_lag(self.moving.values["lag_ratio"])
        lags = {"lag": tuple(share * lag for share in shares)} if self._commanded else {}
        numbers: dict[str, object] = {**otherwise, **seen, **lags}
        numbers |= {name: value for name, value in (("slew", self.known.get("slew", self.seen_slew)),) if value}
        numbers |= self.fit.gravity.filed
        if self._commanded:  # the lags go with the gas, or without it
            numbers["gas"] = self.fit.problem.gas
        elif "gas" in self.known:
            numbers["gas"] = self.known["gas"]
        if numbers.get("gas") and "frequency" in self.known:
            numbers["frequency"] = self.known["frequency"]
        with TemporaryDirectory() as directory:
            path = Path(directory) / "plant.toml"
            path.write_text(self.text(numbers, {}), encoding="utf-8")
            run = replay(path, self.fit.log)
        return _Tried(numbers, run, run.errors(self.used).every)

    def text(self, numbers: Mapping[str, object], figures: Mapping[str, float]) -> str:
        """Return the TOML text with these `numbers` of [plant], and `figures` for the reader."""
        fit, values = self.fit, self.moving.values
        source: dict[str, str | float] = {
            "rows": fit.log.n,
            **figures,
            "encoder_zero_deg": self.moving.zero / DEG,
            **({"encoder_zero_std_deg": 0.0} if fit.hold_zero else {}),
            "pressures": COMMANDED if self._commanded else IMPOSED,
            "unseen": "; ".join(fit.unseen),
            "assumed": ", ".join(self.taken),
        }
        lines = [*_HEADER, dumps(self.moving.joint, scale_known=fit.scale_known, source=source).rstrip("\n")]
        scale = "" if fit.scale_known else ", in the unknown scale of the joint's forces"
        lines += section("plant", numbers, f"SI units: kg·m², N·m·s/rad, s, Pa/s{scale}")
        if self._commanded:
            band, filling = values["dead_band"], values["filling"]
            regulators = {"dead_time": values["dead_time"], "dead_band": band if band >= _LEAST_BAND else 0.0}
            regulators |= self._lags | ({"flow": 1 / filling} if filling else {})
            lines += section("regulators", regulators, "s, Pa, s, s, Pa/s")
            if "reading_age" in values:
                lines += section("sensors", {"reading_age": values["reading_age"]}, "s")
        if fit.parameters:
            intervals = {name: (max(e.low, 0.0), e.high) for name, e in fit.parameters.items() if np.isfinite(e.high)}
            lines += section(
                "intervals", intervals, "95 %, as far as the log shows: s, Pa, rad, -; over stiffness s, s²"
            )
        return "\n".join(lines) + "\n"


_HEADER = (
    "# Plant fitted to the log of a moving joint by `antagonist fit-motion`. The errors in [source] are RMS errors of",
    "# the angle when a file is loaded and simulated over the log, without any measured angle but the first:",
    "# rms_deg: this file, all rows but the first two seconds; it was fitted to them",
    "# rms_last_40_percent_deg: this file, the last 40 % of the rows; it was also fitted to them",
    "# held_out_rms_deg: a file made in the same way from the first 60 % alone, over the last 40 %",
    "",
)
