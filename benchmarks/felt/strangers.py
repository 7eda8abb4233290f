"""Measured stiffness on strangers, with structures absent from the library: python -m benchmarks.felt strangers.

The model is that of data sheets, or with "identified" that of `fit_joint` and `fit_motion` from the stranger's own
logs. Felt stiffness is compared with pushes: quasi-static cycles of ±A at constant pressures, by the stranger's own
equations. A push also meets gravity. Measured stiffness is without the gravity that the model knows. Identified models
know none, so that all of it is in their stiffness, and in the one measured by them.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np

from allocator import DEG
from allocator.calculus import Array
from allocator.errors import InvalidInput
from benchmarks.felt.logs import Rest, recorded
from benchmarks.strangers.identified import Model, data_sheet, identified
from benchmarks.strangers.physics import slipped
from benchmarks.strangers.plants import STRUCTURES, Stranger, drawn, gain, settled, stretch
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.log import from_log
from mpc.bench.measuring.result import Felt, MeasuredStiffness
from mpc.bench.measuring.simulation import driven
from mpc.bench.measuring.strengths import Known
from mpc.bench.safety import Stopped
from mpc.tuning.draws import Spreads

DT = 0.01  # [s]
STEPS, CYCLES = 120, 2  # of a push, quasi-static
RATE = 1.0  # [Hz] of a quick push


def pushed(stranger: Stranger, theta: float, P: Array, amplitude: float) -> float:
    """Return the secant stiffness in slow cycles of ±A about θ at constant true pressures [N·m/rad]."""
    p = stranger.parts
    up = np.linspace(-1, 1, STEPS)
    way = np.concatenate([np.linspace(0, 1, STEPS // 2), *[np.concatenate([-up, up]) for _ in range(CYCLES)]])
    f, eps = np.zeros((2, 4)), np.array([settled_at(stranger, i, theta, P[i], np.zeros(2)) for i in range(2)])
    held, z, before, torques = np.zeros(2), 0.0, theta, []
    for x in way:
        angle, torque = theta + amplitude * float(x), 0.0
        for i in range(2):
            now = settled_at(stranger, i, angle, float(P[i]), held)
            slipped(p, f[i], float(P[i]), float(now), float(now - eps[i]))
            held[i], eps[i] = f[i].sum(), now
            s, lever = stretch(p, i, np.array([angle]), np.array([now]))
            torque += (1 if i == 0 else -1) * float(lever[0] * p.cable * max(float(s[0]), 0.0))
        if p.bearing > 0:
            move = (angle - before) / p.presliding
            z += move * (1 - abs(z) * (0.3 + 0.7 * np.sign(move * z)))
            torque -= p.bearing * z
        before = angle
        torques.append(torque)
    return -(torques[-1] - torques[-STEPS]) / (2 * amplitude)


def settled_at(stranger: Stranger, i: int, theta: float, P: float, held: Array) -> float:
    """Return the contraction at which muscle i, with its hysteresis `held` [N], balances its cable."""
    p, eps = stranger.parts, float(settled(stranger.parts, i, np.array([theta]), np.array([P]))[0])
    for _ in range(3):
        s, _ = stretch(p, i, np.array([theta]), np.array([eps]))
        A, slope, _ = gain(p, np.array([eps]))
        k = p.cable * p.rest_length
        lacking = p.strength[i] * A[0] * P - _elastic(p, eps) - held[i] - p.cable * max(float(s[0]), 0.0)
        eps += float(lacking / (k - p.strength[i] * slope[0] * P))
    return eps


def _elastic(p, eps: float) -> float:  # type: ignore[no-untyped-def]
    from benchmarks.strangers.plants import elastic

    return float(elastic(p, np.array([eps]))[0][0])


def true_strengths(stranger: Stranger, model: Model, m: MeasuredStiffness) -> tuple[float, float]:
    """Return the ratio of torque per pressure on the stranger to that of the model, at the rest."""
    p, found = stranger.parts, []
    for i, side in enumerate(model.plant.joint.sides(m.theta)):
        P, h = m.pressures[i], 2e3
        torque = []
        for q in (P - h, P + h):
            eps = settled(p, i, np.array([m.theta]), np.array([q]))
            s, lever = stretch(p, i, np.array([m.theta]), eps)
            torque.append((1 if i == 0 else -1) * float(lever[0] * p.cable * max(float(s[0]), 0.0)))
        found.append((torque[1] - torque[0]) / (2 * h) / float(side.torque_gain(m.pressures[i])))
    return found[0], found[1]


def measured(stranger: Stranger, model: Model, seed: int, theta: float = 0.0, K: float = 5.0) -> MeasuredStiffness:
    """Measure a stranger with known inertia and age of its readings."""
    plant = replace(model.plant, inertia=stranger.parts.inertia)
    age = stranger.sensors.late * DT
    told = replace(model.told, reading_age=age, flow=min(model.told.flow, stranger.parts.flow))
    tones = Tones()
    e = Experiment(plant, told, theta, K, DT, tones)
    try:
        driven(stranger, e, plant, theta, seed)
    except (Stopped, InvalidInput) as ended:
        e.findings.refusal = e.findings.refusal or str(ended)
    return MeasuredStiffness.of(plant, told.friction.loop, e.findings, Known(plant.inertia, 0.0, age),
                                stranger.sensors.step)  # fmt: skip


Road: TypeAlias = Callable[[Stranger, Model, int], MeasuredStiffness]


def in_log(stranger: Stranger, model: Model, seed: int, theta: float = 0.0, K: float = 5.0) -> MeasuredStiffness:
    """Measure from a minute of noise between 0.3 and 4 Hz, with the same prior knowledge."""
    plant = replace(model.plant, inertia=stranger.parts.inertia)
    log = recorded(stranger, Rest(plant, theta, K), "noise", seed)
    return from_log(plant, model.told.friction.loop, log, Known(plant.inertia, 0.0, stranger.sensors.late * DT))


def unknown_gravity(stranger: Stranger, model: Model, theta: float) -> float:
    """Return the stiffness at θ [rad] of the gravity that the model does not know [N·m/rad]."""
    return float((stranger.parts.gravity - model.plant.gravity_torque) * np.cos(theta))


def creeping(stranger: Stranger, frequency: float = RATE) -> float:
    """Return the stiffness of creep at a frequency [Hz], of which slow pushes meet none [N·m/rad]."""
    p = stranger.parts
    turned = (2 * np.pi * frequency * p.creep_time) ** 2
    return 2 * p.creep * p.lever**2 * float(turned / (1 + turned))


class Errors(NamedTuple):
    """Errors of a felt stiffness, relative to that of a slow push."""

    felt: float  # as measured
    quick: float  # as measured, relative to a quick push
    backbone: float  # part of `felt`
    hysteresis: float  # the other part
    model: float  # as the model predicts it
    model_backbone: float  # part of `model`
    model_hysteresis: float  # the other part
    model_std: float  # that the spreads of the model state


def errors(m: MeasuredStiffness, felt: Felt, K: float, met: float, creep: float, spreads: Spreads) -> Errors:
    """Return the errors for a slow push that meets `met`, of which `K` is the backbone [N·m/rad]."""
    return Errors(
        felt.K / met - 1, felt.K / (met + creep) - 1, (m.K - K) / met, (felt.K - m.K - met + K) / met,
        felt.model / met - 1, (m.model_K - K) / met, (felt.model - m.model_K - met + K) / met,
        float(spreads.felt_std(m.model_K, felt.model)) / met,
    )  # fmt: skip


def report(n: int = 5, first: int = 0, of: str = "data sheet", by: Road = measured) -> str:
    """Measure n strangers of each structure and return the figures."""
    strengths, felts, backbones, total = [], [], [], 0
    for structure in STRUCTURES:
        for seed in range(first, first + n):
            stranger = drawn(structure, seed)
            model = identified(stranger) if of == "identified" else data_sheet(stranger)
            m, total = by(stranger, model, seed), total + 1
            if m.refusal:
                print(structure, seed, m.sentence, flush=True)
                continue
            P = np.array(m.pressures)
            gs = [g / t - 1 for g, t in zip(m.strengths, true_strengths(stranger, model, m), strict=True)]
            heavy, creep = unknown_gravity(stranger, model, m.theta), creeping(stranger)
            K = float(stranger.along(np.array([[m.theta, 0.0, *P]]))[0][0]) + heavy
            curve = [errors(m, f, K, pushed(stranger, m.theta, P, f.amplitude) + heavy, creep, model.spreads)
                     for f in m.felt]  # fmt: skip
            strengths += gs
            felts += [e for f, e in zip(m.felt, curve, strict=True) if 1 * DEG <= f.amplitude <= 8.5 * DEG]
            backbones.append((m.K / K - 1, m.model_K / K - 1, m.K_std / K, (m.K - K - creep) / K))
            felt = " ".join(f"{f.amplitude / DEG:.1f}°: {100 * e.felt:+.1f} ({100 * e.backbone:+.1f} backbone)"
                            for f, e in zip(m.felt, curve, strict=True))  # fmt: skip
            alone = 100 * (m.model_K / K - 1)
            print(
                f"{structure} {seed} strengths {100 * gs[0]:+.1f} {100 * gs[1]:+.1f} %, K {100 * (m.K / K - 1):+.1f} % "
                f"(model alone {alone:+.1f}), felt {felt}, {m.duration:.0f} s",
                flush=True,
            )
    said = f"strangers ({of}): {len(backbones)} of {total} measured; "
    return said + summary(*(np.array(rows) for rows in (strengths, felts, backbones)))


def summary(strengths: Array, felts: Array, backbones: Array) -> str:
    """Return the figures of errors: strengths (n,), `Errors` (n, 8), and backbones with their deviation (n, 4)."""
    g, k = np.abs(strengths), np.abs(backbones)
    model = Errors(*felts.T)
    median, most = (Errors(*100 * np.quantile(np.abs(felts), q, axis=0)) for q in (0.5, 0.9))
    return (
        f"nine in ten strengths within {100 * np.quantile(g, 0.9):.1f} %, felt K at 1–8° within {most.felt:.1f} % "
        f"({most.quick:.1f} % against pushes at {RATE:g} Hz, which meet creep), backbone within "
        f"{100 * np.quantile(k[:, 0], 0.9):.1f} % (model alone {100 * np.quantile(k[:, 1], 0.9):.1f} %), whose 95 % "
        f"interval covers {100 * np.mean(k[:, 0] <= 1.96 * k[:, 2]):.0f} %, with creep at {RATE:g} Hz counted as K "
        f"within {100 * np.quantile(k[:, 3], 0.9):.1f} %, covered {100 * np.mean(k[:, 3] <= 1.96 * k[:, 2]):.0f} %; "
        f"medians "
        f"{100 * np.median(g):.1f}, {median.felt:.1f}, {100 * np.median(k[:, 0]):.1f} %; parts of the felt K's error "
        f"(medians): backbone {median.backbone:.1f}, hysteresis {median.hysteresis:.1f} %; felt K that the model alone "
        f"predicts: median error {median.model:.1f} %, nine in ten within {most.model:.1f} %, parts (medians): "
        f"backbone {median.model_backbone:.1f}, hysteresis {median.model_hysteresis:.1f} %; its 95 % interval covers "
        f"{100 * np.mean(np.abs(model.model) <= 1.96 * np.array(model.model_std)):.0f} %"
    )
