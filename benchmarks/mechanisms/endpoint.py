"""Stiffness of a hand: accuracy of feasible targets, and proofs of both outcomes of "at least" at the edge.

`python -m benchmarks.mechanisms.endpoint` takes the arm (n = dim = 2) and the leg (n = 3 > dim = 2) at random postures.
The edge, the greatest factor s of an ellipse that pressures can enclose, is found without the library's solver:
directions v cut half-spaces off the zonotope of all (τ, K), in linear programmes by HiGHS, until none cuts any more.
"""

import argparse
import time
from collections import Counter
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.optimize import linprog

from allocator import Stiffness, allocate
from allocator.allocation import allocate_at_least, warm_up
from allocator.mechanism import Endpoint, Mechanism, machines
from allocator.units import BAR

MACHINES = {
    "arm26": (machines.arm26(), Endpoint.planar([0.30, 0.25])),
    "leg37": (machines.leg37(), Endpoint.planar([0.30, 0.30, 0.10])),
}
_EDGE = 1e-5  # of the factor: distance from the edge of the two targets
_CUTS = 1e-9  # [of the floor] a direction with a smaller deficit does not cut
_MOST_CUTS = 200


class Target(NamedTuple):
    """Posture with feasible torques and endpoint stiffness."""

    q: np.ndarray
    force: np.ndarray
    T: np.ndarray  # in addition to those of the force
    K_x: np.ndarray


def targets(mechanism: Mechanism, hand: Endpoint, N: int, seed: int = 0) -> Iterator[Target]:
    """Yield targets at postures bent by 12° to 29°, with forces of up to 5 N."""
    rng = np.random.default_rng(seed)
    for _ in range(N):
        q = rng.uniform(0.2, 0.5, mechanism.n) * rng.choice([-1, 1], mechanism.n)
        P = rng.uniform(*mechanism.pressure_box(q))
        force = rng.uniform(-5, 5, 2)
        K_x = hand.stiffness(q, mechanism.stiffness(q, P), force)
        yield Target(q, force, mechanism.torque(q, P) - hand.torque(q, force), K_x)


def edge(mechanism: Mechanism, hand: Endpoint, t: Target) -> float:
    """Return the greatest s with pressures that give the torques and K_x ⪰ s K_x*, by cutting planes."""
    lo, hi = (bound / BAR for bound in mechanism.pressure_box(t.q))
    zero = mechanism.torque(t.q, 0 * lo), mechanism.stiffness(t.q, 0 * lo)
    steps = [(mechanism.torque(t.q, e) - zero[0], mechanism.stiffness(t.q, e) - zero[1]) for e in BAR * np.eye(len(lo))]
    J = hand.jacobian(t.q)
    floor, load = J.T @ t.K_x @ J, np.einsum("i,iab->ab", t.force, hand.hessian(t.q))
    torques = np.array([torque for torque, _ in steps]).T
    asked, size, cuts = t.T + J.T @ t.force - zero[0], np.trace(floor), list(np.eye(mechanism.n))
    for _ in range(_MOST_CUTS):
        found = linprog(
            np.append(np.zeros(len(lo)), -1.0),
            A_ub=np.array([[-v @ K @ v for _, K in steps] + [v @ floor @ v] for v in cuts]) / size,
            b_ub=np.array([v @ (zero[1] + load) @ v for v in cuts]) / size,
            A_eq=np.column_stack([torques, np.zeros(mechanism.n)]),
            b_eq=asked,
            bounds=[*zip(lo, hi, strict=True), (-100, 100)],
            options={"primal_feasibility_tolerance": 1e-10, "dual_feasibility_tolerance": 1e-10},
        )
        K = zero[1] + load + np.tensordot(found.x[:-1], [step for _, step in steps], 1)
        values, vectors = np.linalg.eigh((K - found.x[-1] * floor) / size)
        if values[0] > -_CUTS:
            break
        cuts.append(vectors[:, 0])
    return float(found.x[-1])


def at_least(mechanism: Mechanism, hand: Endpoint, N: int) -> str:
    """Return the outcome of targets just inside and just outside the edge."""
    right, proved, gaps, seconds = 0, 0, [0.0], []
    outcomes: Counter[str] = Counter()
    for t in targets(mechanism, hand, N):
        s = edge(mechanism, hand, t)
        for share, expected in ((s - _EDGE, "EXACT"), (s + _EDGE, "STIFFNESS_LIMITED")):
            start = time.perf_counter()
            a = allocate_at_least(mechanism, t.q, share * t.K_x, t.T, stiffness=Stiffness(endpoint=hand, force=t.force))
            seconds.append(time.perf_counter() - start)
            outcomes[a.status.name] += 1
            right += a.status.name == expected
            proved += a.certificate is not None
            gaps += [a.gap] if a.success else []
    told = ", ".join(f"{count} {name}" for name, count in outcomes.items())
    return (
        f"at least: {right} of {2 * N} decided at {_EDGE:.0e} from the edge ({told}), {proved} disproved; gap of "
        f"the others at most {max(gaps):.0e}; {1e3 * np.median(seconds):.0f} ms"
    )


def exactly(mechanism: Mechanism, hand: Endpoint, N: int, factor: float) -> str:
    """Return the outcome of feasible ellipses times a factor."""
    found = [
        allocate(t.q, factor * t.K_x, t.T, joint=mechanism, stiffness=Stiffness(endpoint=hand, force=t.force))
        for t in targets(mechanism, hand, N, seed=1)
    ]
    outcomes = Counter(a.status.name for a in found)
    met = [a for a in found if a.success]
    worst = max((a.endpoint_error for a in met), default=0.0)
    separated = sum(bool(a.separation.reach < a.separation.asked) for a in found if not a.stiffness_met)
    told = ", ".join(f"{count} {name}" for name, count in outcomes.items())
    return f"{factor:g} times a feasible one: {told}; error of those met at most {worst:.0e}, {separated} separated"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=200)
    N = parser.parse_args().targets
    warm_up(joint=machines.arm26())
    for name, (mechanism, hand) in MACHINES.items():
        for factor in (1.0, 1.5):
            print(f"{name}  {exactly(mechanism, hand, N, factor)}", flush=True)
        print(f"{name}  {at_least(mechanism, hand, N)}", flush=True)


if __name__ == "__main__":
    main()
