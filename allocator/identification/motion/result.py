"""Result of the fit of a moving joint."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array, Mask
from allocator.errors import InvalidInput
from allocator.identification.end_stops import described
from allocator.identification.least_squares import rms
from allocator.identification.motion.doubt import AngleBand, Bands, Drift
from allocator.identification.motion.problem import MotionProblem, Prediction
from allocator.identification.motion.samples import MotionLog
from allocator.identification.motion.static import Equilibrium, fit_muscles
from allocator.joint.antagonist import AntagonistJoint
from allocator.joint.gravity import Gravity
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.muscles import Muscle
from allocator.presentation.tables import html_table, number
from allocator.units import BAR, DEG

TRAINED = 0.6  # share of the log used to predict the held-out rest
_GAINS = 0.8, 1.25  # range of gains of joints of the same kind
_UNEXPLAINED = 0.4  # error of left-out blocks over the motion, above which the log is of another joint or damaged
_BEYOND = 1.05  # greatest pressure of a prediction, relative to that of the log
_MUSCLE_ROWS = 400  # of the log in the fit of muscles to the static angle


class Estimate(NamedTuple):
    """Value with its 95 % interval."""

    value: float
    std: float
    low: float
    high: float


class Errors(NamedTuple):
    """Root mean squares of the free run over some rows [rad]."""

    every: float  # over all of these rows
    taut: float  # over those with both pressures at 1.5 bar or more, after the lag; NaN without any

    @classmethod
    def of(cls, error: Array, judged: Mask, taut: Mask) -> Self:
        """Return those of the `error` (n,) [rad] in the rows `judged` (n,)."""
        return cls(rms(error[judged]), rms(error[judged & taut]))


class MovingJoint(NamedTuple):
    """Joint with muscles that reproduce the static angles of a log, and its parameters of motion."""

    joint: AntagonistJoint
    zero: float  # of the encoder [rad]
    values: Mapping[str, float]  # nonlinear unknowns by name; 0 if not identified
    stiffness: float  # at the mean pressures, gravity's included [N·m/rad]; in the scale of the forces, as the next two
    damping: float  # [N·m·s/rad]
    inertia: float  # [kg·m²]


@dataclass(frozen=True)
class MotionFit:
    """Fitted motion of a joint with its uncertainties. Angles are in rad, pressures in Pa."""

    operator: PrandtlIshlinskii  # hysteresis of the angle, gain 1, at P1 + P2 = 5 bar
    parameters: Mapping[str, Estimate]
    """`lag_up`, `lag_down`, `dead_time` [s], `reading_age` [s] if pressures were measured beside commands, `dead_band`
    [Pa], `filling` [s/Pa] at least of a rising or falling pressure, `lag_ratio` [-] of the antagonist's lags over the
    agonist's (the lags are geometric means of both), `base` [-] of the widths, `loop_width` [rad] of a
    wide sweep at P1 + P2 = 5 bar, `stuck_slope` w_0 [-]; `damping` [s] and `inertia` [s²] over stiffness; `gain` [-] of
    the static angle over that of the given joint. Parameters that the log does not show are left out."""
    error: Errors  # of the log that was fitted
    held_out: Errors  # of the last 40 %, predicted from the first 60 %
    blocks: tuple[Errors, ...]  # of five contiguous blocks, each predicted from the others
    bands: Bands  # about predicted angles
    unseen: tuple[str, ...]  # quantities that the log does not identify, and suggested experiments
    converged: bool
    given: AntagonistJoint | None = field(repr=False)  # initial joint
    zero: float  # encoder reading at its 0 [rad]
    gravity: Gravity  # of the link, known: no part of the muscles
    hold_zero: bool = field(repr=False)  # whether `zero` is known
    scale_known: bool = field(repr=False)
    problem: MotionProblem = field(repr=False)
    x: Array = field(repr=False)  # its unknowns
    x_early: Array = field(repr=False)  # the same, fitted to the first 60 % of the rows

    @property
    def log(self) -> MotionLog:
        """Return the rows used."""
        return self.problem.log

    @property
    def left_out(self) -> Errors:
        """Return the root mean square of the left-out blocks' errors [rad], each block counted once."""
        return Errors(*(rms(errors[np.isfinite(errors)]) for errors in np.array(self.blocks).T))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings, sentences without a full stop."""
        found = tuple(map(described, self.log.ends))
        if not self.converged:
            found = ("the search stopped before it converged", *found)
        if self.left_out.every > _UNEXPLAINED * (moved := float(self.log.theta.std())):
            found = (
                *found,
                f"the pressures predict left-out angles to {self.left_out.every / DEG:.1f}° RMS only, of a motion of "
                f"{moved / DEG:.1f}° RMS: are they clipped or of another joint, or was the joint loaded?",
            )
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

    @cached_property
    def drift(self) -> Drift:
        """Change of the joint's strength over the log, and the errors of its stretches."""
        return Drift.of(self.log, self.run.theta)

    def errors(self) -> Array:
        """Return the measured angle minus that of the free run (n,) [rad]."""
        return self.log.theta - self.run.theta

    def predicted(self, t: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> Array:
        """Return the angle (m,) [rad] of a free run over other times t [s] and pressures [Pa], arrays (m,).

        See `band`, which contains it.
        """
        return self.band(t, P1, P2).theta

    def band(self, t: ArrayLike, P1: ArrayLike, P2: ArrayLike) -> AngleBand:
        """Return the free run over other times t [s] and pressures [Pa], arrays (m,), with the band of 95 %.

        The widths of the band are errors on blocks of the log predicted from the others; `bands.coverage` is their
        coverage of further blocks. They apply to motion like that of the log. The run begins at rest, without memory.
        Raises `InvalidInput` unless the arguments are rows of such numbers, and at pressures far above those of the
        log.
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
                    f"{self.log.greatest_pressure / BAR:.3g} bar: the joint's motion beyond is unknown"
                )
        run = self.problem.elsewhere(times, (one, two), self.x, self.run.weights)
        return self.bands.about(run.theta, self.problem.taut(run))

    # --- a joint with muscles ---------------------------------------------------------------------------------------

    @property
    def joint(self) -> AntagonistJoint:
        """Return the joint with muscles that reproduce the static angles of this log, and the hysteresis.

        Its muscles are those of the given joint, changed as little as necessary: see `fit_muscles`. Raises
        `InvalidInput` if no joint was given.
        """
        return self.moving.joint

    @cached_property
    def moving(self) -> "MovingJoint":
        """The joint with the parameters of motion from the whole log. Raises `InvalidInput` if no joint was given."""
        return self._moving(self.x, self.log.settled)

    @cached_property
    def moving_early(self) -> "MovingJoint":
        """The same as `moving`, from the first 60 % of the log alone."""
        return self._moving(self.x_early, self.log.settled & self.early)

    @property
    def early(self) -> Mask:
        """Rows (n,) used to predict the last 40 %."""
        return np.asarray(np.arange(self.log.n) < TRAINED * self.log.n)

    def _moving(self, x: Array, used: Mask) -> "MovingJoint":
        if self.given is None:
            raise InvalidInput(
                "no joint was given, so that there are no muscles and no plant: fit_motion(…, joint=…), or --machine "
                "with a joint of fit-joint"
            )
        run, given, log = self.problem.run(x, used), self.given, self.log
        rows = np.flatnonzero(used)[np.linspace(0, used.sum() - 1, min(int(used.sum()), _MUSCLE_ROWS)).astype(int)]
        agonist, antagonist, further = fit_muscles(
            given, run.static[rows] - self.zero, run.P1[rows], run.P2[rows], self.gravity, self.hold_zero
        )
        if isinstance(self.problem.static, Equilibrium) and self.problem.gas:
            more = self.problem.static.supplement(self.problem.values(x)["volume"])
            agonist, antagonist = (_holding(*one, given) for one in zip((agonist, antagonist), more, strict=True))
        zero = self.zero + further
        low, high = given.pressure_limits
        least, limits = _reach(given, log.theta - zero)
        joint = replace(
            given,
            agonist=agonist,
            antagonist=antagonist,
            pressure_limits=(low, max(high, log.greatest_pressure)),
            min_contraction=least,
            angle_limits=limits,
            friction=0.0,
            covariance=None,
        )
        P1, P2 = float(run.P1.mean()), float(run.P2.mean())
        at = joint.equilibrium(P1, P2, gravity=self.gravity)
        muscles = float(np.median(joint.stiffness(at, P1, P2)))
        K = muscles + float(np.median(self.gravity.stiffness(at)))
        joint = replace(joint, hysteresis=self._scaled(self.problem.operator(x, run.weights), K, K / muscles))
        values = self.problem.values(x)
        if (age := self.parameters.get("reading_age")) is not None:
            old = min(age.value, values["dead_time"])
            values |= {"dead_time": values["dead_time"] - old, "reading_age": old}
        return MovingJoint(joint, zero, values, K, values["damping"] * K, values["inertia"] * K)

    def _scaled(self, H: PrandtlIshlinskii, K: float, ratio: float) -> PrandtlIshlinskii:
        """Return H in the scale of the refitted muscles, whose stiffness is that of the joint K over `ratio`."""
        if H.stiffness is not None:
            return replace(H, stiffness=K)
        if self.problem.swings or not self.gravity.torque:
            return H
        return H.stiffened(ratio)  # its springs are shares of the stiffness of the muscles alone

    # --- in words ---------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, object]:
        """Return the fit in one row of a table; pressures in bar, angles in degrees."""
        row: dict[str, object] = {
            "rows": self.log.n,
            "rms_deg": self.error.every / DEG,
            "rms_taut_deg": self.error.taut / DEG,
            "held_out_deg": self.held_out.every / DEG,
            "held_out_taut_deg": self.held_out.taut / DEG,
            "left_out_deg": self.left_out.every / DEG,
            "left_out_taut_deg": self.left_out.taut / DEG,
            "band_deg": self.bands.other / DEG,
            "band_taut_deg": self.bands.taut / DEG,
            "band_coverage": self.bands.coverage,
            "stretches": len(self.log.parts),
            "drift_per_hour": self.drift.per_hour,
            "drift_per_hour_std": self.drift.std,
        }
        for name, e in self.parameters.items():
            key, unit = LABELS[name].key, LABELS[name].unit
            row |= {key: e.value / unit, f"{key}_low": e.low / unit, f"{key}_high": e.high / unit}
        return row

    def __repr__(self) -> str:
        """Return the errors of the prediction and the parameters."""
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
    """Name of a parameter in files and in tables, with the displayed unit."""

    key: str
    quantity: str
    symbol: str  # of the unit; "-" of a ratio
    unit: float  # in SI

    @property
    def words(self) -> str:
        """The quantity with its unit in brackets."""
        return self.quantity if self.symbol == "-" else f"{self.quantity} [{self.symbol}]"


LABELS = {
    "lag_up": Label("lag_up_s", "lag of a rising pressure", "s", 1.0),
    "lag_down": Label("lag_down_s", "lag of a falling pressure", "s", 1.0),
    "dead_time": Label("dead_time_s", "dead time", "s", 1.0),
    "reading_age": Label("reading_age_s", "age of the angle's readings", "s", 1.0),
    "dead_band": Label("dead_band_bar", "dead band, total", "bar", BAR),
    "filling": Label("filling_s_per_bar", "time to fill at least", "s/bar", 1 / BAR),
    "lag_ratio": Label("lag_ratio", "lags of the antagonist over those of the agonist", "-", 1.0),
    "volume": Label("gas_volume", "volume of the gas over that of the given joint", "-", 1.0),
    "base": Label("width_without_pressure", "share of the loop's width left at 0 bar", "-", 1.0),
    "loop_width": Label("loop_width_deg", "width of the hysteresis loop at P1 + P2 = 5 bar", "°", DEG),
    "stuck_slope": Label("stuck_slope", "slope while the joint sticks over the slope while it slides", "-", 1.0),
    "gain": Label("gain", "static angle over that of --machine", "-", 1.0),
    "damping": Label("damping_over_stiffness_s", "damping over stiffness", "s", 1.0),
    "inertia": Label("inertia_over_stiffness_s2", "inertia over stiffness", "s²", 1.0),
}


def _holding(muscle: Muscle, more: float, given: AntagonistJoint) -> Muscle:
    """Return the muscle with `more` gas [m³]. Raises `InvalidInput` if its law then leaves none at rest length."""
    at_rest = float(muscle.volume_at_rest(given.geometry.rest_length)) - muscle.tube_volume + more
    if at_rest <= 0:
        raise InvalidInput(
            f"the gas that the log shows leaves this {type(muscle).__name__} {1e6 * at_rest:.3g} cm³ at rest length, "
            "beyond the angles of its fit: measure rests at more angles, or leave the gas out by gas=False (--no-gas)"
        )
    return replace(muscle, inner_radius=None, rest_volume=at_rest) if more else muscle


def _reach(given: AntagonistJoint, theta: Array) -> tuple[float, tuple[float, float] | None]:
    """Return least contraction and angle limits of the `given` joint, widened to the angles (n,) [rad] of a log."""
    ends = float(theta.min()), float(theta.max())
    eps = min(float(given.geometry.agonist(ends[0]).contraction), float(given.geometry.antagonist(ends[1]).contraction))
    limits = given.angle_limits and (min(given.angle_limits[0], ends[0]), max(given.angle_limits[1], ends[1]))
    return min(given.min_contraction, eps), limits
