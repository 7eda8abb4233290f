"""Strangers drawn by structure and seed, as plants for `simulate`."""

from collections import deque
from dataclasses import dataclass, replace
from functools import cache
from math import inf
from typing import Any

import numpy as np

from allocator import BAR, DEG, AntagonistJoint, Pulley
from allocator.calculus import Array
from allocator.identification import fit
from allocator.muscles.models.affine import Sarosi2012
from benchmarks.strangers import physics
from benchmarks.strangers.physics import BRAID, EXPONENTIAL, FLOWING, LAGGED, POWER, SLIPS, SPOOLED, TIPS, Parts
from mpc import Compensation, Plant
from mpc.model.faults import Fault

STRUCTURES = ("braid", "tips", "power", "exponential")
TUNING, REPORTING = 1000, 0  # the first seeds for each
LEVER, LENGTH, MIDDLE = 0.02, 0.25, 0.13  # as everybody is told: R [m], l0 [m], ε0 [-]
ARM = 0.25  # [m] at which a payload hangs
EARTH = 9.81


@dataclass(frozen=True)
class Sensors:
    """Resolution, age, noise and drift of the sensors."""

    step: float = 0.1 * DEG  # of the encoder
    late: int = 1  # samples by which its readings are old
    noise: float = 0.01 * BAR
    drift: float = 0.0  # of the pressure sensors [Pa/s]


@dataclass(frozen=True)
class Stranger:
    """A joint whose structure the library does not model."""

    structure: str
    seed: int
    parts: Parts
    sensors: Sensors
    delay: float  # of the commands [s]
    jitter: float  # of that, uniform, from sample to sample [s]
    nominal: Plant  # model from data sheets
    told: Compensation  # from data sheets
    payload: float = 0.0  # torque of a weight that is hung at its end [N·m] …
    payload_from: float = inf  # … from then on [s]
    faults: tuple[Fault, ...] = ()

    def loaded(self, payload: float, time: float) -> "Stranger":
        """Return it with a payload [N·m] from a time [s] on."""
        return replace(self, payload=payload, payload_from=time)

    def at_rest(self, theta: float, K: float) -> Array:
        """Return the state (4,) to begin from: the nominal plant's."""
        return self.nominal.at_rest(theta, K)

    def begin(self, dt: float, x0: Array, seed: int) -> "Trial":
        """Begin an experiment from `x0` (4,) with commands every `dt` [s]."""
        return Trial(self, dt, x0, seed)

    def along(self, x: Array) -> tuple[Array, Array]:
        """Return the isobaric stiffness (M,) [N·m/rad], cables included, and forces (M, 2) [N] in the states (M, 4)."""
        p, theta, k, F, levers = self.parts, x[:, 0], [], [], []
        for i in range(2):
            eps = settled(p, i, theta, x[:, 2 + i])
            _, slope, _ = gain(p, eps)
            bent = elastic(p, eps)[1]
            muscle = (bent - p.strength[i] * slope * x[:, 2 + i]) / p.rest_length
            s, lever = stretch(p, i, theta, eps)
            k.append(muscle * p.cable / (muscle + p.cable))
            F.append(p.cable * np.maximum(s, 0.0))
            levers.append(lever)
        turning = sum(k[i] * levers[i] ** 2 for i in range(2)) - p.lever * p.eccentricity * (F[0] + F[1])
        return turning, np.stack(F, axis=1)


class Trial:
    """Simulation of a stranger with its sensors, advanced sample by sample."""

    def __init__(self, stranger: Stranger, dt: float, x0: Array, seed: int) -> None:
        self.stranger, self.dt, p = stranger, dt, stranger.parts
        self._noise = np.random.default_rng([seed, 23])
        eps = [float(settled(p, i, np.atleast_1d(x0[0]), np.atleast_1d(x0[2 + i]))[0]) for i in range(2)]
        self._x = np.array([*x0, *eps, *(x0[2:] + p.offset), 0.0, 0.0, 0.0])
        self._slips = np.zeros((2, SLIPS))
        self.work = np.zeros(3)  # [J] see `physics.advance`
        self._sample = 0
        self._read = deque([x0[0]] * (stranger.sensors.late + 1), maxlen=stranger.sensors.late + 1)
        self._said = np.full(4, np.nan)
        self._sent: list[tuple[float, Array]] = [(-inf, np.array(x0[2:]))]  # when each command acts from [s]
        self._carrying = False

    @property
    def x(self) -> Array:
        """Return the true state (4,)."""
        return self._x[:4].copy()

    @property
    def energy(self) -> float:
        """Elastic energy of the cables [J]."""
        p, stored = self.stranger.parts, 0.0
        for i in range(2):
            s, _ = physics.stretch(p, i, self._x[0], self._x[4 + i])
            stored += p.cable * max(s, 0.0) ** 2 / 2
        return stored

    def measure(self) -> Array:
        """Read the sensors (4,)."""
        sensors, t = self.stranger.sensors, self._sample * self.dt
        self._read.append(self._x[0])
        theta = sensors.step * np.round(self._read[0] / sensors.step) if sensors.step else self._read[0]
        P = self._x[2:4] + sensors.drift * t + sensors.noise * self._noise.standard_normal(2)
        y = np.array([theta, np.nan, *P])
        for fault in self._faults:
            y = fault.read(y + fault.offset(t), self._said)
        self._said = y
        return y

    @property
    def _faults(self) -> list[Fault]:
        return [fault for fault in self.stranger.faults if fault.active(self._sample * self.dt)]

    def advance(self, u: Array, d: float = 0.0) -> None:
        """Advance by one sample with the commands `u` (2,) [Pa] and a torque `d` [N·m] added to the payload's."""
        s, t = self.stranger, self._sample * self.dt
        self._sent.append((t + s.delay + s.jitter * self._noise.uniform(-1, 1), np.array(u, float)))
        while len(self._sent) > 1 and self._sent[1][0] <= t + 1e-9:
            self._sent.pop(0)
        until = np.array([begun - t for begun, _ in self._sent[1:]] + [inf])
        told = np.array([command for _, command in self._sent])
        parts, at_zero = s.parts, self._x[2:4] - s.parts.offset  # the pressures at which a regulator's error is zero
        for fault in self._faults:
            told = np.array([fault.effective(command, at_zero) for command in told])
            parts = parts._replace(whole=parts.whole * fault.pulling)
        inertia, load = s.parts.inertia, d
        if t >= s.payload_from - 1e-9:
            heavier = inertia + abs(s.payload) * ARM / EARTH
            if not self._carrying:
                self._x[1] *= inertia / heavier  # the weight was at rest
                self._carrying = True
            inertia, load = heavier, d + s.payload * np.cos(self._x[0])
        physics.advance(parts, self._x, self._slips, told, until, load, s.parts.gravity, inertia, self.dt, self.work)
        self._sample += 1


def gain(p: Parts, eps: Array) -> tuple[Array, Array, Array]:
    """Return A(ε), its slope and its integral at (n,)."""
    rows = np.array([physics.gain(p, e) for e in eps])
    return rows[:, 0], rows[:, 1], rows[:, 2]


def elastic(p: Parts, eps: Array) -> tuple[Array, Array]:
    """Return E(ε) and its slope at (n,)."""
    rows = np.array([physics.elastic(p, e) for e in eps])
    return rows[:, 0], rows[:, 1]


def stretch(p: Parts, i: int, theta: Array, eps: Array) -> tuple[Array, Array]:
    """Return the stretch [m] and the lever [m] of cable i at (n,)."""
    rows = np.array([physics.stretch(p, i, a, e) for a, e in zip(theta, eps, strict=True)])
    return rows[:, 0], rows[:, 1]


def settled(p: Parts, i: int, theta: Array, P: Array) -> Array:
    """Return the contraction (n,) at which muscle i is in balance with its cable, by Newton's method."""
    eps = p.contraction + p.lever / p.rest_length * (1 if i == 0 else -1) * theta
    for _ in range(30):
        A, slope, _ = gain(p, eps)
        E, bent = elastic(p, eps)
        s, _ = stretch(p, i, theta, eps)
        lacking = p.strength[i] * A * P - E - p.cable * np.maximum(s, 0.0)
        eps = eps - lacking / (p.strength[i] * slope * P - bent - p.cable * p.rest_length)
    return eps


# --- drawing ----------------------------------------------------------------------------------------------------------


def drawn(structure: str, seed: int, **changed: Any) -> Stranger:
    """Return the stranger of this structure and seed, with parts `changed`."""
    rng = np.random.default_rng([STRUCTURES.index(structure), seed, 733])
    offset = rng.uniform(-0.02, 0.02, 2) * BAR
    inertia = float(np.exp(rng.uniform(np.log(0.02), np.log(0.06))))
    loop = rng.uniform(3, 6) * DEG * 5.0 / (4 * LEVER)  # [N] half a loop of 3–6° at 5 N·m/rad, in two muscles
    shares = rng.dirichlet(np.ones(SLIPS)) * 2 * loop
    reach = rng.uniform(0.3, 1.0) * DEG * LEVER * np.array([1.0, 2.5, 5.0, 10.0])  # [m] until they slip
    lag = rng.uniform(0.07, 0.13) * np.exp(rng.normal(0, 0.05, 2))
    parts = Parts(
        law=BRAID, radius=0.01, angle=23 * DEG, shape=0.0, rest_length=LENGTH, contraction=MIDDLE,
        strength=1 + rng.uniform(0.04, 0.1) * np.array([1, -1]) * rng.choice([-1, 1]),
        rubber=float(rng.uniform(20, 50)), void=float(rng.uniform(0.9e-4, 1.4e-4)), cable=3e5,
        whole=np.ones(2), inner_damping=150.0,
        slip=shares, spring=shares / 2 / reach, asymmetry=0.5, slip_base=float(rng.uniform(0.2, 0.8)), bouc_wen=False,
        creep=0.0, creep_time=1.0, lever=LEVER, eccentricity=0.0, inertia=inertia,
        damping=float(2 * rng.uniform(0.1, 0.3) * np.sqrt(5 * inertia)), gravity=float(rng.choice([0.0, 0.3])),
        bearing=0.0, presliding=0.3 * DEG, regulator=LAGGED, up=lag, down=lag * rng.uniform(1.1, 1.8, 2),
        flow=float(rng.uniform(4, 8)) * BAR, spool=0.01, conductance=15 * BAR, opening=0.8 * BAR, leak=0.0,
        dead_band=float(rng.uniform(0.05, 0.12)) * BAR, offset=offset,
    )  # fmt: skip
    own, sensors = _OWN[structure](parts, rng), Sensors()
    if structure == "exponential":
        sensors = Sensors(step=0.05 * DEG, late=2, drift=float(rng.choice([-1, 1])) * 0.002 * BAR)
    if structure == "tips":
        sensors = Sensors(step=0.02 * DEG, late=0)
    own = own._replace(**changed)
    delay = float(rng.uniform(0.008, 0.025))
    return Stranger(structure, seed, own, sensors, delay, 0.002, nominal_of(own), told_of(sensors))


def _braid(p: Parts, rng: np.random.Generator) -> Parts:
    """Bouc and Wen's hysteresis, elastic cables, lags of their own."""
    slip, reach = np.zeros(SLIPS), rng.uniform(1.0, 2.0) * DEG * LEVER
    slip[0] = p.slip.sum()
    return p._replace(bouc_wen=True, slip=slip, spring=slip / 2 / reach, cable=float(rng.uniform(4e4, 8e4)))


def _tips(p: Parts, rng: np.random.Generator) -> Parts:
    """Conical tips, asymmetric slipping in the muscle, an eccentric pulley, a spool, a bearing that rubs."""
    return p._replace(
        law=TIPS, shape=float(rng.uniform(1.1, 1.2)), asymmetry=float(rng.uniform(0.55, 0.7)), regulator=SPOOLED,
        eccentricity=float(rng.uniform(-0.06, 0.06)), spool=float(rng.uniform(0.008, 0.02)), bearing=0.05,
    )  # fmt: skip


def _power(p: Parts, rng: np.random.Generator) -> Parts:
    """Valves through which gas flows and leaks, and muscles that creep."""
    return p._replace(
        law=POWER, shape=float(rng.uniform(0.5, 2.0)), regulator=FLOWING, leak=float(rng.uniform(0.0, 0.02)),
        conductance=float(rng.uniform(12, 18)) * BAR, creep=float(rng.uniform(200, 500)),
        creep_time=float(rng.uniform(0.5, 3.0)), slip=0.6 * p.slip, spring=0.6 * p.spring,
    )  # fmt: skip


def _exponential(p: Parts, rng: np.random.Generator) -> Parts:
    """A law that falls fast near rest length, soft cables, sensors that drift and a late encoder."""
    return p._replace(law=EXPONENTIAL, shape=float(rng.uniform(0.15, 0.3)), cable=float(rng.uniform(8e4, 1.5e5)))


_OWN = {"braid": _braid, "tips": _tips, "power": _power, "exponential": _exponential}


def nominal_of(p: Parts) -> Plant:
    """Return the model that data sheets give: muscles by a force table of their type, steel cables, round pulleys.

    Inertia and damping are those of a drawing, 15 % off; the lag is that of filling.
    """
    muscle = sheet(p.law, round(p.shape, 1), p.radius, p.angle)
    joint = AntagonistJoint(Pulley(LENGTH, LEVER, MIDDLE), muscle, muscle)
    return Plant(joint, 1.15 * p.inertia, 0.85 * p.damping, lag=0.1, gravity_torque=p.gravity, slew=8 * BAR)


@cache
def sheet(law: int, shape: float, radius: float, angle: float) -> Sarosi2012:
    """Return the muscle that is fitted to a table of a type's forces."""
    type_ = _TYPE._replace(law=law, shape=shape if law != BRAID else 0.0, radius=radius, angle=angle)
    eps, P = (a.ravel() for a in np.meshgrid(np.linspace(0, 0.24, 13), np.arange(1.0, 5.1) * BAR))
    F = gain(type_, eps)[0] * P - elastic(type_, eps)[0]
    return replace(fit(Sarosi2012, eps, P, F).muscle, inner_radius=radius, covariance=None)


def told_of(sensors: Sensors) -> Compensation:
    """Return the dead time and dead band on a data sheet of such valves."""
    return Compensation(dead_time=0.02, dead_band=0.08 * BAR)


_TYPE = Parts(
    BRAID, 0.01, 23 * DEG, 0.0, LENGTH, MIDDLE, np.ones(2), 35.0, 1.3e-4, 1e6, np.ones(2), 150.0, np.zeros(SLIPS),
    np.zeros(SLIPS), 0.5, 0.5, False, 0.0, 1.0, LEVER, 0.0, 0.05, 0.1, 0.0, 0.0, 0.01, LAGGED,
    np.full(2, 0.1), np.full(2, 0.1), 5 * BAR, 0.01, 0.0, 1.0, 0.0, 0.0, np.zeros(2),
)  # fmt: skip
