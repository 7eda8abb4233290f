"""From an identified joint whose muscles drift by ±10 % to its updated file: python -m benchmarks.felt drift."""

from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from allocator import DEG, allocate
from allocator.joint.hysteresis import PrandtlIshlinskii
from allocator.machine_file import load_joint
from benchmarks.felt.hidden import DT
from mpc import RealPlant
from mpc.bench.measuring.experiment import Experiment, Tones
from mpc.bench.measuring.result import MeasuredStiffness
from mpc.bench.measuring.simulation import driven
from mpc.bench.measuring.strengths import Known
from mpc.bench.measuring.update import update
from mpc.model.friction.contact import Loads

OPERATOR = PrandtlIshlinskii((0.7, 0.12, 0.1, 0.08), (0.5 * DEG, 1.5 * DEG, 4 * DEG), base=0.2)
RESTS = (-15 * DEG, 5.0), (0.0, 6.0), (15 * DEG, 5.0)
ASKED = [(theta * DEG, K) for theta in (-25, -10, 0, 10, 25) for K in (5.0, 6.0, 7.0)]
PUSH = 2 * DEG
_MATTERS = 0.03  # of K: opposite drifts of the strengths hardly change it


def errors(joint, real: RealPlant) -> tuple[float, float]:  # type: ignore[no-untyped-def]
    """Return relative root mean square errors of backbone K and K_felt at ±2°, allocated by the joint's file."""
    found = []
    for theta, K in ASKED:
        a = allocate(theta, K, joint=joint)
        x = np.array([theta, 0.0, a.P1, a.P2])
        true = float(real.isobaric(x))
        contact = Loads.of(real, x)
        felt = true + float(real.friction.loop.secant(PUSH).added(true, contact.pulled, contact.filled))
        found.append((K / true - 1, float(a.felt_stiffness(PUSH)) / felt - 1))
    rms = np.sqrt(np.mean(np.square(found), axis=0))
    return float(rms[0]), float(rms[1])


def drifted(seed: int, directory: Path) -> tuple[tuple[float, float], tuple[float, float], list[str]]:
    """Return the errors before and after the check of one joint, and its message."""
    rng = np.random.default_rng([seed, 36])
    base = RealPlant.standard().nominal
    plant = replace(base, joint=replace(base.joint, hysteresis=OPERATOR), inertia=float(rng.uniform(0.03, 0.06)))
    gains = tuple(1 + 0.1 * rng.choice([-1, 1], 2))
    real = replace(RealPlant.standard(gains, nominal=plant), friction=OPERATOR, dead_band=0.08e5, flow=8e5)
    told = replace(real.known(share=1.0), friction=real.friction, flow=8e5)
    path, found = directory / "joint.toml", []
    plant.save(path)
    before = errors(load_joint(path), real)
    for noise, (theta, K) in enumerate(RESTS, start=len(RESTS) * seed):
        e = Experiment(plant, told, theta, K, DT, Tones(series=()))
        driven(real, e, plant, theta, noise)
        known = Known(plant.inertia)
        found.append(MeasuredStiffness.of(plant, told.friction.loop, e.findings, known, real.encoder))
    joint = update(path, found, plant.inertia) if any(m.success for m in found) else load_joint(path)
    return before, errors(joint, real), [f"strengths {gains[0]:.2f} {gains[1]:.2f}", *(m.sentence for m in found)]


def report(n: int = 12, first: int = 0) -> str:
    """Check n joints and return the figures."""
    rows = []
    for seed in range(first, first + n):
        with TemporaryDirectory() as directory:
            before, after, said = drifted(seed, Path(directory))
        rows.append((*before, *after))
        print(seed, said[0], f"K {100 * before[0]:.1f} → {100 * after[0]:.1f} %, felt K at ±2° {100 * before[1]:.1f} → "
              f"{100 * after[1]:.1f} %", flush=True)  # fmt: skip
    lines = []
    for name, kept in (("both muscles alike", lambda r: r[0] > _MATTERS), ("one each way", lambda r: r[0] <= _MATTERS)):
        if some := [r for r in rows if kept(r)]:
            b, bf, a, af = 100 * np.mean(some, axis=0)
            lines.append(
                f"{len(some)} joints, {name}: RMS error of the realised backbone K {b:.1f} → {a:.1f} % (worst "
                f"{100 * max(r[2] for r in some):.1f} %), of the felt K {bf:.1f} → {af:.1f} %"
            )
    return "; ".join(lines)
