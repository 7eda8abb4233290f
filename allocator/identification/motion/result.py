"""The fit of a moving joint gives this back."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from os import PathLike
from typing import Any, NamedTuple, Self

import numpy as np

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.files.atomic import write_text
from allocator.identification.motion.muscles import fit_muscles
from allocator.identification.motion.problem import MotionProblem, Prediction
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.static import Equilibrium
from allocator.joint import storage
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.muscles.storage import toml
from allocator.presentation.tables import html_table, number
from allocator.units import BAR, DEG

_GAINS = 0.8, 1.25  # between which the same kind of joint moves
_LEAST_LAG = 1e-3  # [s] a plant has
_LEAST_BAND = 100.0  # [Pa] less is none
_BEYOND = 1.05  # greatest pressure that is predicted for, in that of the log
_MUSCLE_ROWS = 400  # of the log, at which the muscles are fitted to the static angle


class Estimate(NamedTuple):
    """An estimate is a value with its 95 % interval."""

    value: float
    std: float
    low: float
    high: float
    unit: str


class Errors(NamedTuple):
    """Errors are root mean squares of the free run over some rows [rad]."""

    every: float  # over all of these rows
    taut: float  # over those with both pressures at 1.5 bar or more, after the lag; NaN without any

    @classmethod
    def of(cls, error: Array, judged: Mask, taut: Mask) -> Self:
        """Return those of the `error` (n,) [rad] in the rows `judged` (n,)."""
        return cls(_rms(error[judged]), _rms(error[judged & taut]))


class _Muscles(NamedTuple):
    """The muscles that hold the static angles of the log."""

    joint: AntagonistJoint
    zero: float  # of the encoder [rad]
    rms: float  # of the free run with them, all rows [rad]


@dataclass(frozen=True)
class MotionFit:
    """A fit is what a joint does in motion, and how far to trust it. Angles in rad, pressures in Pa."""

    operator: PrandtlIshlinskii  # hysteresis of the angle, gain 1
    parameters: Mapping[str, Estimate]
    """`lag_up`, `lag_down`, `dead_time` [s], `dead_band` [Pa], `filling` [s/Pa] at least of a rising or falling
    pressure, `base` [-] of the widths, `loop_width` [rad] of a wide sweep at P1 + P2 = 5 bar, `stuck_slope` w_0 [-];
    `damping` [s] and `inertia` [s²] over stiffness; `gain` [-] of the static angle over that of the given joint. What
    the log does not show is left out."""
    error: Errors  # of the log that was fitted
    held_out: Errors  # of the last 40 %, predicted from the first 60 %
    blocks: tuple[Errors, ...]  # of five contiguous blocks, each predicted from the others
    unseen: tuple[str, ...]  # what the log does not show, and what would
    converged: bool
    given: AntagonistJoint | None = field(repr=False)  # joint to begin with
    scale_known: bool = field(repr=False)
    problem: MotionProblem = field(repr=False)
    x: Array = field(repr=False)  # its unknowns

    @property
    def log(self) -> MotionLog:
        """Return the rows used."""
        return self.problem.log

    @property
    def left_out(self) -> Errors:
        """Return the root mean square of the left-out blocks' errors [rad], each block counted once."""
        every, taut = np.array(self.blocks).T
        return Errors(_rms(every), _rms(taut[np.isfinite(taut)]))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return what is to be known before the fit is used, sentences without a full stop."""
        found = () if self.converged else ("the search stopped before it converged",)
        gain = self.parameters.get("gain")
        if gain is None or _GAINS[0] < gain.value < _GAINS[1]:
            return found
        return (
            *found,
            f"the static angle moves {gain.value:.2f} times as far as that of the joint that was given: are the "
            "pressures absolute or in another unit, or is it another joint?",
        )

    @cached_property
    def run(self) -> Prediction:
        """Return the free run over the log."""
        return self.problem.run(self.x, self.log.settled)

    def errors(self) -> Array:
        """Return the angle measured minus that of the free run (n,) [rad]."""
        return self.log.theta - self.run.theta

    def predicted(self, t: Any, P1: Any, P2: Any) -> Array:
        """Return the angle (m,) [rad] of a free run over other times t [s] and pressures [Pa], arrays (m,).

        It begins at rest, without memory. Raises `InvalidInput` at what is no row of such numbers, and at pressures far
        above those of the log.
        """
        times, one, two = checks.real("t", t, "s"), checks.pressure("P1", P1), checks.pressure("P2", P2)
        if times.ndim != 1 or not times.shape == one.shape == two.shape or times.size < 2:
            raise InvalidInput("t, P1 and P2 have to be rows of numbers, one of each for every sample")
        if not (np.diff(times) > 0).all():
            raise InvalidInput("t has to increase from row to row [s]")
        for name, P in (("P1", one), ("P2", two)):
            if P.max() > _BEYOND * self.log.greatest_pressure:
                raise InvalidInput(
                    f"{name} goes up to {P.max() / BAR:.3g} bar, and that of the log that was fitted up to "
                    f"{self.log.greatest_pressure / BAR:.3g} bar: what the joint does beyond is not known"
                )
        return self.problem.elsewhere(times, (one, two), self.x, self.run.weights)

    # --- a plant ----------------------------------------------------------------------------------------------------

    @property
    def joint(self) -> AntagonistJoint:
        """Return the joint whose muscles hold the static angles of this log, with the hysteresis.

        Its muscles are those of the joint that was given, changed as little as the angles need: see `fit_muscles`.
        Raises `InvalidInput` where no joint was given.
        """
        return self._muscles.joint

    @property
    def joint_rms(self) -> float:
        """Return the error [rad] of the free run with the muscles of `joint` in the place of the polynomial."""
        return self._muscles.rms

    @cached_property
    def _muscles(self) -> _Muscles:
        if self.given is None:
            raise InvalidInput(
                "no joint was given, so that there are no muscles and no plant: fit_motion(…, joint=…), or --joint "
                "with a joint of fit-joint"
            )
        run, given, log = self.run, self.given, self.log
        rows = np.linspace(0, log.n - 1, min(log.n, _MUSCLE_ROWS)).astype(int)
        agonist, antagonist, zero = fit_muscles(given, run.static[rows], run.P1[rows], run.P2[rows])
        low, high = given.pressure_limits
        joint = replace(
            given,
            **_reaching(given, log.theta - zero),
            agonist=agonist,
            antagonist=antagonist,
            pressure_limits=(low, max(high, log.greatest_pressure)),
            friction=0.0,
            covariance=None,
            hysteresis=self.operator,
        )
        u = zero + Equilibrium(joint, log.greatest_pressure)(run.P1, run.P2)
        moved = self.problem.hysteretic(u, run.P1, run.P2, self.x, log.settled)
        return _Muscles(joint, zero, _rms((log.theta - moved.theta)[log.settled]))

    def save(self, path: str | PathLike[str]) -> None:
        """Write the plant as TOML: joint, hysteresis, [plant] and [regulators], for every command's --joint.

        Raises `InvalidInput` where no joint was given, and `CannotWrite`.
        """
        write_text(path, self.dumps())

    def dumps(self) -> str:
        """Return the text of the plant's file."""
        values, joint = self.problem.values(self.x), self.joint
        if values["dead_band"] < _LEAST_BAND:
            values |= {"dead_band": 0.0}
        source: dict[str, str | float] = {
            "rows": self.log.n,
            "free_run_rms_deg": round(self._muscles.rms / DEG, 4),
            "held_out_rms_deg": round(self.held_out.every / DEG, 4),
            "encoder_zero_deg": round(self._muscles.zero / DEG, 4),
            "unseen": "; ".join(self.unseen),
        }
        lines = [storage.dumps(joint, scale_known=self.scale_known, source=source)]
        lines += ["[plant]  # SI units: kg·m², N·m·s/rad, s, N·m, Pa/s; what was not seen is as in `Plant()`"]
        lines += [f"{name} = {toml(value)}" for name, value in self._plant().items()]
        lines += ["", "[regulators]  # s, Pa"]
        lines += [f"{name} = {toml(values[name])}" for name in ("dead_time", "dead_band", "lag_up", "lag_down")]
        return "\n".join(lines) + "\n"

    def _plant(self) -> dict[str, float | tuple[float, float]]:
        """Return what [plant] takes: one lag for both pressures, and inertia and damping where they were seen."""
        p, numbers = self.parameters, dict[str, float | tuple[float, float]]()
        if "lag_up" in p:
            lag = max((p["lag_up"].value + p["lag_down"].value) / 2, _LEAST_LAG)
            numbers["lag"] = (lag, lag)
        if self.scale_known and "inertia" in p:
            P1, P2 = float(self.run.P1.mean()), float(self.run.P2.mean())
            K = float(np.median(self.joint.stiffness(self.joint.equilibrium(P1, P2), P1, P2)))
            numbers |= {name: p[name].value * K for name in ("inertia", "damping")}
        return numbers

    # --- in words ---------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Return the fit in one row of a table; pressures in bar, angles in degrees."""
        row: dict[str, Any] = {
            "rows": self.log.n,
            "rms_deg": self.error.every / DEG,
            "rms_taut_deg": self.error.taut / DEG,
            "held_out_deg": self.held_out.every / DEG,
            "held_out_taut_deg": self.held_out.taut / DEG,
            "left_out_deg": self.left_out.every / DEG,
            "left_out_taut_deg": self.left_out.taut / DEG,
        }
        for name, e in self.parameters.items():
            key, _, unit = LABELS[name]
            row |= {key: e.value / unit, f"{key}_low": e.low / unit, f"{key}_high": e.high / unit}
        return row

    def __repr__(self) -> str:
        """Say how well the angle is predicted, and what was found."""
        found = "; ".join(f"{name} {value}" for name, value in self._found().items())
        return f"MotionFit: {self._errors()}\n  {found}"

    def _repr_html_(self) -> str:
        """Return the same as a table for notebooks."""
        return html_table(f"MotionFit: {self._errors()}", self._found().items())

    def _errors(self) -> str:
        return (
            f"free run {number(self.error.every / DEG, 3)}° RMS, {number(self.held_out.every / DEG, 3)}° on the last "
            f"40 % held out, {number(self.left_out.every / DEG, 3)}° on five blocks left out in turn"
        )

    def _found(self) -> dict[str, str]:
        return {
            label.words: f"{number(e.value / label.unit, 3)} ± {number(e.std / label.unit, 2)}"
            for label, e in ((LABELS[name], e) for name, e in self.parameters.items())
        }


class Label(NamedTuple):
    """A label is how a parameter is called, in files and in tables, and the unit shown in SI."""

    key: str
    words: str
    unit: float


LABELS = {
    "lag_up": Label("lag_up_s", "lag of a rising pressure [s]", 1.0),
    "lag_down": Label("lag_down_s", "lag of a falling pressure [s]", 1.0),
    "dead_time": Label("dead_time_s", "dead time [s]", 1.0),
    "dead_band": Label("dead_band_bar", "dead band, total [bar]", BAR),
    "filling": Label("filling_s_per_bar", "time to fill at least [s/bar]", 1 / BAR),
    "base": Label("width_without_pressure", "share of the loop's width left at 0 bar", 1.0),
    "loop_width": Label("loop_width_deg", "width of the hysteresis loop at P1 + P2 = 5 bar [°]", DEG),
    "stuck_slope": Label("stuck_slope", "motion of a joint that sticks, in that of one that slides", 1.0),
    "gain": Label("gain", "static angle, in that of --joint", 1.0),
    "damping": Label("damping_over_stiffness_s", "damping over stiffness [s]", 1.0),
    "inertia": Label("inertia_over_stiffness_s2", "inertia over stiffness [s²]", 1.0),
}


def _reaching(given: AntagonistJoint, theta: Array) -> dict[str, Any]:
    """Return the limits of the `given` joint, widened to the angles (n,) [rad] at which it was seen."""
    ends = float(theta.min()), float(theta.max())
    eps = min(float(given.geometry.agonist(ends[0]).contraction), float(given.geometry.antagonist(ends[1]).contraction))
    limits = given.angle_limits and (min(given.angle_limits[0], ends[0]), max(given.angle_limits[1], ends[1]))
    return {"min_contraction": min(given.min_contraction, eps), "angle_limits": limits}


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean(error**2))) if error.size else float("nan")


__all__ = ["LABELS", "Errors", "Estimate", "MotionFit"]
