"""Fits of joints with known truth from their angles, and the validity of the stated intervals.

    python -m benchmarks.identification.joint_truth

Each line is a synthetic laboratory. K and both forces are compared at θ = 0 and 2.5 bar in both muscles; a force is
correct if its interval contains the truth, and the table states whether the force common to both muscles was
determined. With `ANTAGONIST_SHARED` the equilibria in its folder `data/stranger`, made elsewhere, are also fitted.
"""

import os
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from allocator import AntagonistJoint, Lever, Pulley
from allocator.calculus import increasing_root
from allocator.identification.joint.fit import fit_joint
from allocator.identification.joint.reading import read_joint_log
from allocator.identification.joint.result import JointFit
from allocator.muscles import scaled
from allocator.muscles.catalogue import MARTENS_DMSP_20_300, SAROSI_DMSP_20_200N, SAROSI_DMSP_20_400N
from allocator.units import BAR, DEG

PULLEY = Pulley(0.40, 0.02, 0.1375)
LEVER = Lever(0.40, 0.30, 0.03, 0.0435)
STOPS = (-80 * DEG, 80 * DEG)
TAUT = 20.0  # [N] least force of the equilibria
P = 2.5 * BAR


@dataclass(frozen=True)
class Laboratory:
    """Laboratory with a joint and its procedure."""

    name: str
    joint: AntagonistJoint
    noise: float = 0.05 * DEG  # [rad]
    hysteresis: float = 0.0  # constant, half its width [rad]
    zero: float = 0.0  # of the encoder [rad]
    sag: bool = False
    options: dict[str, Any] = field(default_factory=dict)  # of the fit


def pair(geometry: Any, *, friction: float = 0.0, ratio: float = 1.0, muscle: Any = SAROSI_DMSP_20_400N) -> Any:
    return AntagonistJoint(geometry, muscle, scaled(muscle, ratio), angle_limits=STOPS, friction=friction)


MARTENS = pair(Pulley(0.30, 0.02, 0.11), friction=0.05, muscle=MARTENS_DMSP_20_300)
LABORATORIES = (
    Laboratory("pulley, little noise", pair(PULLEY)),
    Laboratory("pulley, much noise", pair(PULLEY), noise=0.5 * DEG),
    Laboratory("constant hysteresis", pair(PULLEY), hysteresis=1.5 * DEG),
    Laboratory("friction μ = .13", pair(PULLEY, friction=0.13), noise=0.3 * DEG),
    Laboratory("friction and constant hysteresis", pair(PULLEY, friction=0.05), hysteresis=1.0 * DEG),
    Laboratory("lever", pair(LEVER)),
    Laboratory("lever, friction, much noise", pair(LEVER, friction=0.1), noise=0.5 * DEG),
    Laboratory("lever, constant hysteresis", pair(LEVER), hysteresis=1.0 * DEG, noise=0.2 * DEG),
    Laboratory("antagonist 1.3 times, zero 5°", pair(PULLEY, friction=0.05, ratio=1.3), zero=5 * DEG),
    Laboratory("friction and a sag test", pair(PULLEY, friction=0.05), sag=True, hysteresis=0.5 * DEG),
    Laboratory("lever and a sag test", pair(LEVER, friction=0.05, ratio=0.8), sag=True, noise=0.3 * DEG),
    Laboratory("a prior of the type", pair(PULLEY), options={"prior": SAROSI_DMSP_20_200N}),
    Laboratory("another law", MARTENS, noise=0.2 * DEG),
    Laboratory("another law, antagonist 1.2 times", replace(MARTENS, antagonist=scaled(MARTENS.agonist, 1.2))),
    Laboratory("another law, lever", pair(Lever(0.30, 0.25, 0.03, 0.0175), muscle=MARTENS_DMSP_20_300)),
)


class Result(NamedTuple):
    """One line of the table."""

    name: str
    fit: JointFit
    stiffness: tuple[float, float, float]  # K true, found, half of its interval [N·m/rad]
    forces: tuple[tuple[float, float, float, float], ...]  # true, found, low, high [N] of both muscles
    seconds: float

    @property
    def right(self) -> tuple[bool, bool]:
        """Return whether the intervals contain the true K and forces."""
        true, found, half = self.stiffness
        return abs(found - true) <= half, all(low <= F <= high for F, _, low, high in self.forces)


def measured(laboratory: Laboratory, seed: int = 0) -> dict[str, Any]:
    """Return the arguments of `fit_joint`: both sweeps, two weights on either side, and optionally a sag test."""
    joint, rng = laboratory.joint, np.random.default_rng([17, seed])
    held, swept = (a.ravel() * BAR for a in np.meshgrid(np.arange(1.0, 4.6, 0.5), np.arange(1.0, 4.6, 0.5)))
    hung = np.array([(p, W, s) for p in (1.5, 2.5, 3.5) for W in (-2, -1, 1, 2) for s in (-1, 1)])
    P1 = np.concatenate([held, held, hung[:, 0] * BAR])
    P2 = np.concatenate([swept, swept, hung[:, 0] * BAR])
    torque = np.concatenate([np.zeros(2 * held.size), hung[:, 1]])
    direction = np.concatenate([-np.ones(held.size), np.ones(held.size), hung[:, 2]])
    theta = _truth(joint, P1, P2, torque, direction)
    taut = np.isfinite(theta) & (np.minimum(*joint.forces(np.where(np.isfinite(theta), theta, 0.0), P1, P2)) > TAUT)
    P1, P2, torque, direction, theta = (a[taut] for a in (P1, P2, torque, direction, theta))
    theta = theta - direction * laboratory.hysteresis + laboratory.zero + laboratory.noise * rng.normal(size=theta.size)
    columns = {"theta": theta, "P1": P1, "P2": P2, "torque": torque, "direction": direction, "slack": 0 * theta}
    if laboratory.sag:
        columns = {
            name: np.append(a, row) for (name, a), row in zip(columns.items(), _sag(laboratory, rng), strict=True)
        }
    return columns


def _truth(joint: AntagonistJoint, P1: Any, P2: Any, torque: Any, direction: Any) -> Any:
    def lacking(theta: Any, P1: Any, P2: Any, torque: Any, direction: Any) -> Any:
        return torque + joint.friction_torque(theta, P1, P2, direction) - joint.torque(theta, P1, P2)

    return increasing_root(lacking, *joint.angle_range, P1, P2, torque, direction)


def _sag(laboratory: Laboratory, rng: Any) -> list[Any]:
    """Return theta, P1, P2, torque, direction and slack of a sag test at five angles: pressures to 0.05 bar."""
    theta = np.linspace(-40, 40, 5) * DEG
    one, two = laboratory.joint.sides(theta)
    slack = [side.muscle.pressure(0.0, side.contraction) + 0.05 * BAR * rng.normal(size=5) for side in (one, two)]
    return [theta + laboratory.zero, *(np.maximum(p, 0.0) for p in slack), 0 * theta, 0 * theta, 0 * theta + 3]


def judged(name: str, joint: AntagonistJoint, **given: Any) -> Result:
    """Return the fit of one laboratory with its truth."""
    begun = time.perf_counter()
    fit = fit_joint(**given, geometry=joint.geometry, leave_one_out=False, choices=False)
    seconds = time.perf_counter() - begun
    from allocator.identification.joint.relative import stiffness_with_gradient

    at = (np.array([0.0]), np.array([P]), np.array([P]))
    K = stiffness_with_gradient(fit.joint, *at)
    half = 1.96 * float(K.std(np.asarray(fit.joint.covariance))[0])
    F, true = fit.forces(0.0, P, P), joint.forces(0.0, P, P)
    forces = tuple(
        (float(true[i]), float(F[i]), *(float(end) for end in interval))
        for i, interval in enumerate((F.agonist_interval, F.antagonist_interval))
    )
    return Result(name, fit, (float(joint.stiffness(0.0, P, P)), float(K.value[0]), half), forces, seconds)


def strangers() -> Iterator[Result]:
    """Yield the results on equilibria made elsewhere, of two Sarosi2012 on the pulley."""
    if "ANTAGONIST_SHARED" not in os.environ:
        return
    for path in sorted((Path(os.environ["ANTAGONIST_SHARED"]) / "data" / "stranger").glob("equilibria_*.csv")):
        log = read_joint_log(path)
        columns = {name: getattr(log, name) for name in ("theta", "P1", "P2", "torque", "direction")}
        yield judged(path.stem, pair(PULLEY), **columns)


def results() -> Iterator[Result]:
    """Yield all results, one after the other."""
    yield from strangers()
    for laboratory in LABORATORIES:
        yield judged(laboratory.name, laboratory.joint, **measured(laboratory), **laboratory.options)


def line(result: Result) -> str:
    """Return one line of the table."""
    (true, found, half), fit = result.stiffness, result.fit
    forces = " ".join(f"{F:4.0f} {f:5.0f} [{low:5.0f},{high:5.0f}]" for F, f, low, high in result.forces)
    K_right, F_right = result.right
    seen = "seen" if fit.common.seen else "unseen"
    verdict = f"{'ok' if K_right else 'WRONG'}/{'ok' if F_right else 'WRONG' if fit.common.seen else 'outside'}"
    warned = "; not converged" if any("converged" in w for w in fit.warnings) else ""
    return (
        f"{result.name:34} {np.degrees(fit.rms):6.3f}° {true:6.3f} {found:6.3f} ±{half:6.3f}  {forces}  {seen:6} "
        f"{verdict:11} {result.seconds:4.1f} s{warned}"
    )


def main() -> None:
    print("                                        rms   K true  found      ±    F1 true found interval  F2 …")
    for result in results():
        print(line(result), flush=True)


if __name__ == "__main__":
    main()
