"""Measured stiffness on hidden joints of the library's own effects: python -m benchmarks.felt hidden.

Each has strengths of 0.8–1.25, one of four structures of hysteresis with a loop of 0–10°, gas, dead band, delays, an
encoder of 0.02–0.1°, and sensor offsets. The measurement knows the content of a data sheet or a fit: the model with
strengths of 1, dead time and dead band, the age of the readings, the inertia.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from allocator import BAR, DEG
from allocator.errors import InvalidInput
from allocator.joint.hysteresis import PrandtlIshlinskii
from mpc import Plant, RealPlant
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.log import from_log
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.bench.measuring.shaking import Shaking
from mpc.bench.measuring.simulation import driven
from mpc.bench.measuring.strengths import Known
from mpc.bench.safety import Stopped
from mpc.model.compensation import Compensation
from mpc.model.friction.contact import Hysteresis, Loads
from mpc.model.friction.dahl import Friction
from mpc.model.friction.maxwell_slip import MaxwellSlip

DT = 0.01  # [s]
STRUCTURES = "Maxwell slip", "Dahl", "Coulomb", "elastic operator"


class Hidden(NamedTuple):
    """Joint with the prior knowledge of it."""

    real: RealPlant
    told: Compensation
    theta: float  # [rad]
    K: float  # [N·m/rad]


class Outcome(NamedTuple):
    """Comparison of a measurement with the truth; errors relative."""

    measured: MeasuredStiffness
    K_error: float
    K_std: float
    strengths: tuple[float, float]
    felt: tuple[tuple[float, float, float], ...]  # amplitude [rad], error, std


def friction_of(structure: str, plant: Plant, width: float, rng: np.random.Generator) -> Hysteresis:
    """Return hysteresis with a loop `width` [rad] wide."""
    if width < 0.2 * DEG:
        return Friction()
    if structure == "Maxwell slip":
        return MaxwellSlip.of_width(plant, width)
    if structure == "Dahl":
        return Friction.of_width(plant, width, presliding=float(rng.uniform(0.4, 1.2)) * DEG)
    if structure == "Coulomb":
        torque = float(plant.isobaric(np.array([0.0, 0.0, 2.5 * BAR, 2.5 * BAR]))) * width / 2
        return Friction(0.0, torque, 0.3 * DEG)
    w = rng.dirichlet(np.ones(3)) * min(0.55, width / (6 * DEG))
    radii = np.cumsum(rng.uniform(0.4, 1.2, 3)) * width / 3
    return MaxwellSlip.of(PrandtlIshlinskii((1 - float(w.sum()), *w), tuple(radii), base=float(rng.uniform(0.2, 0.8))))


def hidden(seed: int, **changed: float) -> Hidden:
    """Return the joint of a seed, with effects `changed`."""
    rng = np.random.default_rng([seed, 34])
    nominal = replace(RealPlant.standard().nominal, inertia=float(rng.uniform(0.03, 0.07)))
    structure, width = STRUCTURES[seed % 4], float(rng.uniform(0, 10)) * DEG
    effects = {
        "dead_time": float(rng.uniform(0.01, 0.04)),
        "dead_band": float(rng.uniform(0.0, 0.15)) * BAR,
        "flow": float(rng.uniform(5, 10)) * BAR,
        "encoder": float(rng.uniform(0.02, 0.1)) * DEG,
        "reading_age": float(rng.choice([0.0, 0.01])),
        "pressure_noise": 0.02 * BAR,
    }
    offsets = tuple(rng.uniform(-0.03, 0.03, 2) * BAR)
    real = RealPlant(
        nominal, tuple(rng.uniform(0.8, 1.25, 2)), friction_of(structure, nominal, width, rng),
        pressure_offset=offsets, **(effects | changed),
    )  # fmt: skip
    told = Compensation(
        real.friction.share(float(rng.uniform(0.7, 1.1))) if not real.friction.absent else Friction(),
        effects["dead_time"], effects["dead_band"], flow=effects["flow"], reading_age=effects["reading_age"],
    )  # fmt: skip
    return Hidden(real, told, float(rng.uniform(-20, 20)) * DEG, float(rng.uniform(4.5, 7.0)))


def truth(h: Hidden, m: MeasuredStiffness) -> tuple[float, Callable[[float], float]]:
    """Return the backbone K and K_felt(A) of the real joint at the place of the measurement, at its true pressures."""
    P = np.array(m.pressures) - h.real.pressure_offset
    x = np.array([m.theta, 0.0, *P])
    K, contact = float(h.real.isobaric(x)), Loads.of(h.real, x)
    return K, lambda A: K + float(h.real.friction.loop.secant(A).added(K, contact.pulled, contact.filled))


def measured(h: Hidden, seed: int, tones: Tones | None = None, inertia_error: float = 0.0, J: float = 1.0) -> Outcome:
    """Measure a hidden joint, with a given inertia of J times the true one, ± `inertia_error`."""
    tones = Tones() if tones is None else tones
    plant = replace(h.real.nominal, inertia=J * h.real.nominal.inertia)
    e = Experiment(plant, h.told, h.theta, h.K, DT, tones)
    try:
        driven(h.real, e, plant, h.theta, seed)
    except (Stopped, InvalidInput) as ended:
        e.findings.refusal = e.findings.refusal or str(ended)
    known = Known(plant.inertia, inertia_error, h.told.reading_age)
    return outcome(h, MeasuredStiffness.of(plant, h.told.friction.loop, e.findings, known, h.real.encoder))


def shaken(h: Hidden, seed: int, inertia_error: float = 0.0, J: float = 1.0) -> Outcome:
    """Measure a hidden joint by noise that moves it by about 10°."""
    plant = replace(h.real.nominal, inertia=J * h.real.nominal.inertia)
    source = Shaking(plant, h.theta, h.K, DT, 10 * DEG, 45.0)
    try:
        driven(h.real, source, plant, h.theta, seed)
    except (Stopped, InvalidInput) as ended:
        P1, P2 = source.first
        return outcome(h, MeasuredStiffness(h.theta, (P1, P2), duration=source.duration, refusal=str(ended)))
    assert source.log is not None
    known = Known(plant.inertia, inertia_error, h.told.reading_age)
    m = from_log(plant, h.told.friction.loop, source.log, known)
    return outcome(h, replace(m, furthest=source.furthest))


def outcome(h: Hidden, m: MeasuredStiffness) -> Outcome:
    """Return a measurement and the truth."""
    if m.refusal:
        return Outcome(m, np.nan, np.nan, (np.nan, np.nan), ())
    K, felt = truth(h, m)
    gains = h.real.force_gains
    errors = tuple(g / t - 1 for g, t in zip(m.strengths, gains, strict=True))
    curve = tuple((f.amplitude, f.K / felt(f.amplitude) - 1, f.K_std / f.K) for f in m.felt)
    return Outcome(m, m.K / K - 1, m.K_std / K, errors, curve)  # type: ignore[arg-type]


def report(n: int = 100, first: int = 0, inertia_error: float = 0.0, by: Callable[..., Outcome] = measured) -> str:
    """Measure n hidden joints and return the figures."""
    found = []
    for seed in range(first, first + n):
        rng = np.random.default_rng([seed, 35])
        J = float(1 + inertia_error * rng.standard_normal())
        out = by(hidden(seed), seed, inertia_error=inertia_error, J=J)
        found.append(out)
        m = out.measured
        print(
            f"{seed} {STRUCTURES[seed % 4]}: {m.duration:.0f} s, moved {m.furthest:.2f} A, "
            + (m.sentence if m.refusal else f"K {100 * out.K_error:+.1f} ± {100 * out.K_std:.1f} %, strengths "
               f"{100 * out.strengths[0]:+.1f} {100 * out.strengths[1]:+.1f} %, felt "
               + " ".join(f"{a / DEG:.1f}°: {100 * e:+.1f}±{100 * s:.1f}" for a, e, s in out.felt)),
            flush=True,
        )  # fmt: skip
    return summary(found)


def summary(found: list[Outcome]) -> str:
    """Return medians, nine in ten, coverage."""
    there = [o for o in found if o.measured.success]
    error, std = (np.array([getattr(o, name) for o in there]) for name in ("K_error", "K_std"))
    strengths = np.array([o.strengths for o in there])
    felt = np.array([(e, s) for o in there for _, e, s in o.felt])
    times, far = (np.array([getattr(o.measured, name) for o in found]) for name in ("duration", "furthest"))
    wide = 100 * np.quantile(np.abs(error), 0.9), 100 * np.quantile(np.abs(strengths), 0.9)
    felt_wide = 100 * np.quantile(np.abs(felt[:, 0]), 0.9)
    K_cover, felt_cover = (100 * np.mean(np.abs(e) <= 1.96 * s) for e, s in ((error, std), (felt[:, 0], felt[:, 1])))
    return (
        f"{len(there)} of {len(found)} measured; K: median error {100 * np.median(error):+.2f} %, nine in ten within "
        f"{wide[0]:.1f} %, 95 % interval covers {K_cover:.0f} %; strengths: nine in ten within {wide[1]:.1f} %; "
        f"felt K: nine in ten within {felt_wide:.1f} %, covered {felt_cover:.0f} %; {np.median(times):.0f} s "
        f"({times.max():.0f} at most), moved by up to {far.max():.2f} A"
    )
