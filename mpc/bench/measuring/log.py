"""Strengths and stiffness from any log by weak-form regression.

With the torques T_i of the model at the measured angles and pressures, true strengths g_i, known inertia J, damping b,
gravity m g l, stop operators s_j of the measured angle with half widths r_j on a grid, and a stiffness e that the
model's force laws lack,

    J θ'' + b θ' + m g l sin(θ - θ_h) = g_1 T_1 + g_2 T_2 - e θ - Σ w_j s_j(θ; r_j) + c,   w_j, b ≥ 0          (W1)

Multiplied by bumps φ that vanish with their slopes at both ends, and integrated by parts,

    J ∫φ''θ = g_1 ∫φT_1 + g_2 ∫φT_2 - e ∫φθ - Σ w_j ∫φs_j + b ∫φ'θ - m g l ∫φ sin(θ - θ_h) + c ∫φ               (W2)

no noise is differentiated. The solution is by least squares with nonnegative unknowns. The springs w_j are numbers,
or shares of the model's K along the log: both are columns. No stop is wider than half the swing, because a stop that
never slips cannot be distinguished from K. The backbone K is g_1 k_1 + g_2 k_2 + e with the stiffnesses k_i of the
model's muscles: e corrects the shape of the laws, which strengths cannot. The gas acts only through the measured
pressures, so that the stiffness is the isobaric one.

The inertia sets the scale. A log is therefore refused if the torques without e do not explain its accelerations:
friction alone fits a slow sine as well as muscles do, with strengths that are wrong by half. The standard deviations
are those of leaving out every twelfth of the log in turn, of the readings' age, and the square of the unexplained
share, since errors of the regressors attenuate.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import sqrt
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidFile, InvalidInput
from allocator.files.bags import is_recording
from allocator.identification.motion.samples import read_motion_log
from allocator.identification.recording import stretches
from allocator.joint.felt import Loop
from allocator.units import DEG
from mpc.bench.logs import read_log
from mpc.bench.measuring.result import Felt, MeasuredStiffness
from mpc.bench.measuring.springs import SPRINGS, solved, stop
from mpc.bench.measuring.strengths import Known, why_implausible
from mpc.model.plant import Plant

_HALF = 0.15  # [s] of a bump
_STEP = 0.01  # [s] between rows, at most, into which a log is interpolated
_STOPS, _NARROWEST, _WIDEST = 8, 0.3 * DEG, 12 * DEG
_SWING = 0.05, 0.95  # quantiles of the angle that define the swing
_DAMPING, _SHAPE = 2 + 2 * _STOPS, 5 + 2 * _STOPS  # columns of b, e and -e
_PARTS = 12  # of the log, left out in turn
_SETTLED = 4  # bumps at the beginning, until the state of the stops is known
LEAST_ROWS = 400
_UNEXPLAINED = 0.15  # of the inertia's torque (RMS), beyond which a log is refused
_KNOWN = 0.05  # standard deviation of a strength, beyond which a log is refused
_MODEL = 0.0125  # [-] of the strengths: model error of the equations, by hidden joints (seeds >= 1000)
_AGE = 0.002  # [s] standard deviation of the age of the angle's readings, which turns accelerations into damping
_CURVE = 1 * DEG, 2 * DEG, 4 * DEG, 8 * DEG  # amplitudes of the felt stiffness


@dataclass(frozen=True)
class Samples:
    """Rows of a moving joint with its measured pressures; arrays (n,)."""

    t: Array  # [s], increasing; gaps end a stretch
    theta: Array  # of the joint [rad]
    P1: Array  # in the muscle, gauge [Pa]
    P2: Array
    notes: tuple[str, ...] = ()  # sentences about rows of a file that were left out

    @classmethod
    def of(cls, t: ArrayLike, theta: ArrayLike, P1: ArrayLike, P2: ArrayLike, notes: tuple[str, ...] = ()) -> Self:
        """Check the rows. Raises `InvalidInput`."""
        named = {"t": checks.real("t", t, "s"), "theta": checks.angle("theta", theta)}
        named |= {name: checks.pressure(name, P) for name, P in (("P1", P1), ("P2", P2))}
        if any(a.ndim != 1 or a.size != named["t"].size for a in named.values()) or named["t"].size < LEAST_ROWS:
            raise InvalidInput(f"t, theta, P1 and P2 have to be rows of the same length, {LEAST_ROWS} samples or more")
        if not (np.diff(named["t"]) > 0).all():
            raise InvalidInput("t has to increase [s]")
        rows = [np.array(a, float) for a in named.values()]
        return cls(rows[0], rows[1], rows[2], rows[3], notes)


def read_log_of_motion(
    path: str | Path,
    columns: Mapping[str, str] | None = None,
    *,
    skip_rows: int = 0,
    topics: str | None = None,
    zero: float = 0.0,
) -> Samples:
    """Read a log of `antagonist run`, or any that `fit-motion` reads, with measured pressures.

    `columns`, `skip_rows` and `topics` are those of `read_motion_log`. `zero` [rad] is subtracted from the encoder's
    readings; a log of `run` has angles of the joint. Raises `InvalidFile`.
    """
    notes: tuple[str, ...] = ()
    if not columns and not topics and _of_a_run(Path(path)):
        c = read_log(path)
        if "theta" not in c:
            raise InvalidFile(path, "is the log of an arm; expected that of one joint with two muscles")
        good = np.all([np.isfinite(c[name]) for name in ("t", "theta", "P1", "P2")], axis=0)
        rows = [c[name][good] for name in ("t", "theta", "P1", "P2")]
    else:
        log = read_motion_log(path, columns, skip_rows=skip_rows, topics=topics)
        notes = log.notes
        rows = [log.t, log.theta - zero, *((log.P1, log.P2) if log.measured is None else log.measured)]
    try:
        return Samples.of(rows[0], rows[1], rows[2], rows[3], notes)
    except InvalidInput as error:
        raise InvalidFile(path, str(error)) from None


def _of_a_run(path: Path) -> bool:
    """Return whether the file is a log of `antagonist run`."""
    if is_recording(path) or not path.is_file():
        return False
    with open(path, encoding="utf-8", errors="replace") as file:
        head = next((line for line in file if not line.startswith("#")), "")
    return "P1_command" in head and "phase" in head


def from_log(plant: Plant, loop: Loop, log: Samples, known: Known) -> MeasuredStiffness:
    """Return a joint's stiffness as measured from a log, or the reason for a refusal.

    `plant` is the model, `loop` its hysteresis, to which the felt stiffness is compared; `known.inertia` [kg·m²] is the
    scale, and `known.age` [s] that of the angle's readings. There must not be a weight on the joint.
    """
    table = _Table.of(plant, log, known)
    duration = float(sum(np.ptp(log.t[part]) for part in stretches(log.t)))
    middle = theta, P1, P2 = tuple(float(np.median(a)) for a in (log.theta, log.P1, log.P2))
    refused = partial(MeasuredStiffness, theta, (P1, P2), duration=duration)
    if len(table.y) < 4 * table.X.shape[1]:
        return refused(refusal=f"{duration:.0f} s are too short")
    X = table.X[:, :_SHAPE]
    left = float(np.std(table.y - X @ solved(X, table.y)) / np.std(table.y))
    x = solved(table.X, table.y)
    scale = _scale(x)
    scattered = _scatter(table)
    std = np.sqrt(np.diag(scattered)[:2]) / np.maximum(x[:2], 1e-9)
    if why := _why_not(left, float(std.max()), x):
        return refused(refusal=why)
    common = _MODEL**2 + left**4 + known.inertia_error**2
    C = scattered[:3, :3] + common * np.outer(scale, scale) + _by_age(plant, log, known, x)
    return _measured(plant, loop, table, x, C, sqrt(scattered[3, 3]), middle, duration)


def _why_not(left: float, std: float, x: Array) -> str:
    """Return the reason why the log does not determine the strengths, or ""."""
    excite = "step both pressures at random, or shake the joint near its resonance, for a minute"
    if left > _UNEXPLAINED:
        return (
            f"the torques leave {100 * left:.3g} % of the log's accelerations unexplained (at most "
            f"{100 * _UNEXPLAINED:.0f}): too little excitation, commanded pressures, or another joint; {excite}"
        )
    if std > _KNOWN:
        return f"the strengths are known to ± {100 * min(std, 9.99):.0f} % only: too little excitation; {excite}"
    return why_implausible((float(x[0]), float(x[1])))


@dataclass(frozen=True)
class _Table:
    """Regression (W2): y = X x, of unknowns g_1, g_2, w_j (n), w_j as shares of K (n), b, c, -c, e, -e."""

    X: Array
    y: Array
    widths: Array  # r_j (n,) [rad]
    scale: float  # K of the model [N·m/rad], for the shares
    swing: float  # [rad]

    @classmethod
    def of(cls, plant: Plant, log: Samples, known: Known) -> Self:
        """Return the table of a log."""
        low, high = np.quantile(log.theta, _SWING)
        widest = max(min((high - low) / 2, _WIDEST), 2 * _NARROWEST)
        r = np.geomspace(_NARROWEST, widest, _STOPS)
        agonist, antagonist = plant.joint.sides(log.theta)
        scale = float(np.median(agonist.stiffness(log.P1) + antagonist.stiffness(log.P2)))
        X, y = [], []
        for part in stretches(log.t):
            there = _part(plant, log, part, known, r, scale)
            if there is not None:
                X.append(there[0])
                y.append(there[1])
        n = _SHAPE + 2
        none = np.zeros((0, n)), np.zeros(0)
        return cls(np.concatenate([none[0], *X]), np.concatenate([none[1], *y]), r, scale, float(high - low) / 2)


def _part(plant: Plant, log: Samples, part: slice, known: Known, r: Array, scale: float) -> tuple[Array, Array] | None:
    """Return X and y of a stretch; None if it is too short."""
    t = log.t[part]
    h = min(float(np.median(np.diff(t))), _STEP)
    even = t[0] + h * np.arange(int((t[-1] - t[0] - known.age) / h))
    m = round(_HALF / h)
    if even.size < (_SETTLED + 4) * m:
        return None
    theta = np.interp(even + known.age, t, log.theta[part])
    P1, P2 = (np.interp(even, t, P[part]) for P in (log.P1, log.P2))
    agonist, antagonist = plant.joint.sides(theta)
    share = (agonist.stiffness(P1) + antagonist.stiffness(P2)) / scale
    stops = [stop(theta, width) for width in r]
    columns = [agonist.torque(P1), antagonist.torque(P2), *(-s for s in stops), *(-share * s for s in stops)]
    z = np.arange(-m, m + 1) / m
    bump, slope, bend = (
        (1 - z**2) ** 4,
        -8 * z * (1 - z**2) ** 3 / (m * h),
        (48 * z**2 * (1 - z**2) ** 2 - 8 * (1 - z**2) ** 3) / (m * h) ** 2,
    )

    def over(signal: Array, weight: Array) -> Array:
        return np.convolve(signal, weight[::-1], "valid")[:: max(m // 2, 1)][2 * _SETTLED :] * h

    one = over(np.ones(theta.size), bump)
    shape = over(theta - np.median(log.theta), bump)
    X = np.stack([*(over(c, bump) for c in columns), over(theta, slope), one, -one, -shape, shape], axis=1)
    return X, known.inertia * over(theta, bend) + over(plant.gravity.moment(theta), bump)


def _scale(x: Array) -> Array:
    """Return g_1, g_2 and e (3,), the unknowns of the backbone."""
    return np.array([x[0], x[1], x[_SHAPE] - x[_SHAPE + 1]])


def _scatter(table: _Table) -> Array:
    """Return the covariance (4, 4) of g_1, g_2, e and the damping by leaving out parts of the log in turn."""
    ends = np.linspace(0, len(table.y), _PARTS + 1).astype(int)
    found = []
    for a, b in pairwise(ends.tolist()):
        keep = np.r_[0:a, b : len(table.y)]
        x = solved(table.X[keep], table.y[keep])
        found.append([*_scale(x), x[_DAMPING]])
    off = np.array(found) - np.mean(found, axis=0)
    return np.asarray((_PARTS - 1) / _PARTS * off.T @ off)


def _by_age(plant: Plant, log: Samples, known: Known, x: Array) -> Array:
    """Return the covariance (3, 3) of g_1, g_2 and e by the age of the readings."""
    error = max(known.age_error, _AGE)
    later = _Table.of(plant, log, replace(known, age=known.age + error))
    off = _scale(solved(later.X, later.y)) - _scale(x)
    return np.outer(off, off)


def _measured(
    plant: Plant,
    loop: Loop,
    table: _Table,
    x: Array,
    C: Array,
    damping_std: float,
    middle: Sequence[float],
    duration: float,
) -> MeasuredStiffness:
    theta, P = middle[0], (middle[1], middle[2])
    k = np.array([float(s.stiffness(p)) for s, p in zip(plant.joint.sides(theta), P, strict=True)])
    K, K_std = float(_scale(x) @ [*k, 1]), sqrt(float([*k, 1] @ C @ [*k, 1]))
    own, shares = x[2 : 2 + _STOPS], x[2 + _STOPS : 2 + 2 * _STOPS]
    w = own + shares * float(k.sum()) / table.scale
    felt = [
        _felt(A, K, K_std, w, table.widths, float(plant.joint.stiffness(theta, *P, amplitude=A, loop=loop)))
        for A in _CURVE
        if A <= table.swing
    ]
    return MeasuredStiffness(
        theta, P, (float(x[0]), float(x[1])), C[:2, :2], K, K_std, float(k.sum()), tuple(felt), float(x[_DAMPING]),
        damping_std, duration=duration,
    )  # fmt: skip


def _felt(A: float, K: float, K_std: float, w: Array, r: Array, model: float) -> Felt:
    """Return the felt stiffness of the springs found, by (S1)."""
    K_h = float(w @ np.minimum(1.0, r / A))
    work = float(4 * w * r @ np.maximum(A - r, 0.0))
    return Felt(A, K + K_h, sqrt(K_std**2 + (SPRINGS * K_h) ** 2), work / (np.pi * A**2 * (K + K_h)), model)
