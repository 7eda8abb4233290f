"""Coverage of the stated 95 % interval of a fitted joint's stiffness, under hysteresis and a wrong law.

    python -m benchmarks.identification.joint_coverage [--joints 56] [--first 1000] [--catalogue]

Each joint has muscles of a law outside the catalogue (`benchmarks.identification.foreign_laws`), scaled, of unequal
strength, on a pulley or a lever, an encoder zero, noise, and hysteresis that is constant in the angle or in proportion
to the forces.
With --catalogue the true law is one of the catalogue, or fitted to the measured map of the package, and a different law
is fitted. A laboratory sweeps both pressures both ways and hangs a weight on either side: 100 to 250 equilibria, all
taut. K is compared at the unloaded equilibria, at fixed θ, P1 and P2.

In addition to the coverage the report has the interval score of Gneiting and Raftery (2007), eq. 43, at 95 %, relative
to K,

    S = (u - l) + (2/α) (l - K)₊ + (2/α) (K - u)₊,   α = 0.05

Lower is better: narrow intervals that hold. Seeds below 1000 were used to choose settings; reports use others. One run
on 56 unseen joints from seed 2000: 95.4 % inside (91.4 % under constant hysteresis, 99.4 % under friction), median
stated standard deviation 1.9 %, RMS error 6.5 %, interval score 0.211.
"""

import argparse
from collections.abc import Iterator
from functools import cache
from typing import NamedTuple

import numpy as np

from allocator import AntagonistJoint, Lever, Pulley
from allocator.calculus import Array, increasing_root
from allocator.errors import InvalidInput
from allocator.identification import JointFit, fit, fit_joint, load_dataset
from allocator.identification.joint import report
from allocator.identification.joint.relative import stiffness_with_gradient
from allocator.muscles import Hildebrandt2005, Muscle, scaled
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG
from benchmarks.identification.foreign_laws import drawn

MAP = "dmsp-20-300-map"
FITTED = ("Sarosi2012", "MartensBoblan2017", "Hildebrandt2005", "AffinePolynomial")
TAUT = 20.0  # [N]
STOPS = (-60 * DEG, 60 * DEG)
_POINTS = 12  # of a joint in the comparison of K


class Made(NamedTuple):
    """Joint with a laboratory's measurements."""

    joint: AntagonistJoint
    truth: str
    hysteresis: str
    model: str  # to be fitted
    theta: Array  # encoder reading [rad]
    P1: Array
    P2: Array
    torque: Array
    direction: Array
    zero: float  # of the encoder [rad]


class Covered(NamedTuple):
    """Coverage of a joint at some points."""

    made: Made
    fitted: JointFit
    error: Array  # K fitted minus true [N·m/rad]
    std: Array  # stated [N·m/rad]
    formal: Array  # by σ² (JᵀJ)⁻¹ [N·m/rad]
    true: Array  # K [N·m/rad]
    others: dict[str, tuple[float, float]]  # error and stated standard deviation of ratio [-] and zero [rad]

    @property
    def inside(self) -> Array:
        """Return whether the stated 95 % interval holds."""
        return np.asarray(np.abs(self.error) <= 1.96 * self.std)

    @property
    def score(self) -> Array:
        """Return the interval score of the 95 % interval, relative to K."""
        half, error = 1.96 * self.std / self.true, np.abs(self.error / self.true)
        return np.asarray(2 * half + 2 / 0.05 * np.maximum(error - half, 0.0))


@cache
def muscles() -> dict[str, tuple[Muscle, float]]:
    """Return the true muscles and their rest lengths [m]."""
    s = load_dataset(MAP)
    measured = fit(Hildebrandt2005, s.contraction, s.pressure, s.force, folds=0).muscle
    return {
        "Sarosi2012": (SAROSI_DMSP_20_400N, 0.40),
        "MartensBoblan2017": (MARTENS_DMSP_20_300, 0.30),
        "Hildebrandt2005": (measured, 0.30),
    }


def made(seed: int, foreign: bool = False) -> Made:
    """Return joint number `seed` with its measurements; if `foreign`, its muscles have a law outside the catalogue."""
    rng = np.random.default_rng([17, seed, *([1] if foreign else [])])
    if foreign:
        muscle, length = drawn(rng), 0.30
        truth = type(muscle).__name__
    else:
        truth = list(muscles())[seed % 3]
        muscle, length = muscles()[truth]
    agonist = scaled(muscle, rng.uniform(0.7, 1.3))
    antagonist = scaled(agonist, rng.uniform(0.8, 1.25))
    constant = bool(seed // 3 % 2)
    if seed // 6 % 2:
        geometry = Lever(length, 0.8 * length, 0.03, float(length * (1 - 0.12) - np.hypot(0.8 * length, 0.03)))
    else:
        geometry = Pulley(length, 0.02, rng.uniform(0.10, 0.14))
    friction = 0.0 if constant else rng.uniform(0.03, 0.13)
    half = rng.uniform(0.4, 2.0) * DEG if constant else 0.0
    joint = AntagonistJoint(geometry, agonist, antagonist, angle_limits=STOPS, friction=friction)
    zero, noise = rng.normal(0, 1.5 * DEG), rng.uniform(0.05, 0.3) * DEG
    P1, P2, torque, s = _programme(rng)
    theta = equilibria(joint, P1, P2, torque, s)
    forces = joint.forces(np.where(np.isfinite(theta), theta, 0.0), P1, P2)
    there = np.isfinite(theta) & (np.minimum(*forces) > TAUT)
    P1, P2, torque, s, theta = (a[there] for a in (P1, P2, torque, s, theta))
    shown = theta + zero - half * s + noise * rng.standard_normal(theta.size)
    model = [name for name in FITTED if name != truth][int(rng.integers(3))]
    return Made(joint, truth, "constant" if constant else "friction", model, shown, P1, P2, torque, s, zero)


def _programme(rng: np.random.Generator) -> tuple[Array, Array, Array, Array]:
    """Return P1, P2 [Pa], the weight's torque [N·m] and the direction of the laboratory's visits."""
    step = rng.choice([0.35, 0.5])
    held, swept = (a.ravel() * BAR for a in np.meshgrid(np.arange(1.0, 5.1, 0.5), np.arange(1.0, 5.1, step)))
    weight = rng.uniform(0.8, 2.0)
    levels = [(a, b) for a in (2.0, 3.0, 4.0) for b in (2.0, 3.0, 4.0) if abs(a - b) < 1.5]
    hung = np.array([(a * BAR, b * BAR, side * weight, s) for a, b in levels for side in (-1, 1) for s in (-1, 1)])
    return (
        np.concatenate([held, swept, hung[:, 0]]),
        np.concatenate([swept, held, hung[:, 1]]),
        np.concatenate([0 * held, 0 * held, hung[:, 2]]),
        np.concatenate([0 * held - 1, 0 * held + 1, hung[:, 3]]),
    )


def equilibria(joint: AntagonistJoint, P1: Array, P2: Array, torque: Array, s: Array) -> Array:
    def lacking(theta: Array, P1: Array, P2: Array, torque: Array, s: Array) -> Array:
        given = joint.torque(theta, P1, P2) - joint.friction_torque(theta, P1, P2, s)
        return np.asarray(torque - given)

    return np.asarray(increasing_root(lacking, *joint.angle_range, P1, P2, torque, s))


def covered(m: Made) -> Covered:
    """Return the comparison of the fit's stiffness with the truth at unloaded equilibria."""
    fitted = fit_joint(
        m.theta,
        m.P1,
        m.P2,
        geometry=m.joint.geometry,
        torque=m.torque,
        direction=m.direction,
        model=m.model,
        leave_one_out=False,
        choices=False,  # they add nothing to the covariance
    )
    free = np.flatnonzero(m.torque == 0)
    at = free[np.linspace(0, free.size - 1, _POINTS).astype(int)]
    theta, P1, P2 = m.theta[at] - m.zero, m.P1[at], m.P2[at]
    found = fitted.joint
    K, true = stiffness_with_gradient(found, theta, P1, P2), m.joint.stiffness(theta, P1, P2)
    ratio = float(m.joint.antagonist.force(3 * BAR, 0.1) / m.joint.agonist.force(3 * BAR, 0.1))
    others = {
        "ratio": (fitted.ratio / ratio - 1, fitted.standard_deviations["log_ratio"]),
        "zero": (fitted.zero - m.zero, fitted.standard_deviations["zero"]),
    }
    formal = report.parameter_jacobian(fitted.problem, fitted.problem.unknowns(fitted.x))
    std = K.std(np.asarray(found.covariance)), K.std(formal @ fitted.doubt.formal @ formal.T)
    return Covered(m, fitted, K.value - true, *std, true, others)


def campaign(seeds: range, foreign: bool = False) -> Iterator[Covered | str]:
    """Yield the coverage of each joint, or the reason for a missing fit."""
    for seed in seeds:
        joint = made(seed, foreign)
        try:
            yield covered(joint)
        except InvalidInput as error:
            yield f"joint {seed} ({joint.model}): {error}"


def _told(found: list[Covered]) -> str:
    """Return the coverage and the widths of the intervals."""

    def share(part: list[Covered]) -> str:
        inside = np.concatenate([c.inside for c in part])
        formal = np.concatenate([np.abs(c.error) <= 1.96 * c.formal for c in part])
        error = np.concatenate([c.error / c.true for c in part])
        width = np.concatenate([c.std / c.true for c in part])
        ratio, zero = (np.mean([abs(e) <= 1.96 * s for e, s in (c.others[n] for c in part)]) for n in ("ratio", "zero"))
        return (
            f"{len(part):4d} joints: K inside {inside.mean():.1%} (formal {formal.mean():.1%}), error "
            f"{np.sqrt(np.mean(error**2)):.1%} RMS, stated std {np.median(width):.1%} (median), "
            f"interval score {np.mean(np.concatenate([c.score for c in part])):.3f}; ratio {ratio:.1%}, "
            f"zero {zero:.1%}"
        )

    lines = [f"all            {share(found)}"]
    kinds = (lambda c: c.made.hysteresis, lambda c: f"of {c.made.truth[:11]}", lambda c: f"fit {c.made.model[:10]}")
    for kind in kinds:
        for name in sorted({kind(c) for c in found}):
            lines.append(f"{name:14s} {share([c for c in found if kind(c) == name])}")
    return "\n".join(lines)


def main() -> None:
    """Run the campaign and print the coverage of the stated intervals."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--joints", type=int, default=56)
    parser.add_argument("--first", type=int, default=1000)
    parser.add_argument("--catalogue", action="store_true", help="true laws of the catalogue")
    given = parser.parse_args()
    found = []
    seeds = range(given.first, given.first + given.joints)
    for i, each in enumerate(campaign(seeds, foreign=not given.catalogue), 1):
        if isinstance(each, str):
            print(each, flush=True)
        else:
            found.append(each)
        if i % 25 == 0:
            print(f"{i} of {given.joints}: {np.concatenate([c.inside for c in found]).mean():.1%}", flush=True)
    print(_told(found))


if __name__ == "__main__":
    main()
