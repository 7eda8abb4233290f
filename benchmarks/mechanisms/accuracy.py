"""Checks of the answers: all faces of the box, independent multipliers, separating directions, one joint."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from allocator import BAR, Limits, Status, allocate, warm_up
from allocator.mechanism import Mechanism, machines
from benchmarks.mechanisms.targets import POSTURE, Targets, arm_at_postures, random_mechanism, random_targets
from tests.allocator.mechanism.enumeration import best_of_all_faces
from tests.allocator.mechanism.multipliers import kkt_by_hand
from tests.conftest import JOINTS


class Check(NamedTuple):
    """One check: its name, the number of targets, the worst value and the allowed one."""

    what: str
    targets: int
    worst: float
    allowed: float

    @property
    def failed(self) -> bool:
        """Whether the worst is worse than allowed."""
        return not self.worst <= self.allowed


def checks(N: int) -> Iterator[Check]:
    """Yield all checks, including the optimality of `N` targets."""
    one = random_targets(machines.arm26(), POSTURE, N, seed=1)
    yield from optimality("arm26 at one posture", one)
    yield from optimality("arm26, every target at a posture of its own", arm_at_postures(N, seed=2))
    for n, m in ((3, 9), (4, 12), (7, 20)):
        mechanism = random_mechanism(n, m)
        yield from optimality(f"n/m = {n}/{m}", random_targets(mechanism, np.full(n, 0.1), N // 20, seed=3))
    yield faces(random_targets(machines.arm26(), POSTURE, N // 10, seed=4))
    yield from one_joint(N // 10)
    yield from target_by_target(arm_at_postures(N // 2, seed=6))


def optimality(what: str, t: Targets) -> Iterator[Check]:
    """Yield checks of optimality conditions, separating directions and statuses."""
    a = allocate(t.q, t.K, t.T, joint=t.mechanism)
    problem = t.problem
    yield Check(f"{what}: optimality residual", len(t.T), float(a.kkt_residual.max()), 1e-9)
    by_hand = kkt_by_hand(problem, a.P / problem.unit)
    yield Check(f"{what}: the same with multipliers by SVD", len(t.T), float(by_hand.max()), 1e-9)
    y0, M = t.mechanism.targets_map(t.q)
    lo, hi = t.mechanism.pressure_box(t.q)
    y, (d, _, _) = t.mechanism.stacked(t.T, t.K), a.separation
    dM = (d[:, None, :] @ np.broadcast_to(M, (len(d), *M.shape[-2:])))[:, 0]
    proved = (d * y0).sum(-1) + np.maximum(dM * lo, dM * hi).sum(-1) < (d * y).sum(-1)
    beyond = ~(a.torque_met & a.stiffness_met)
    yield Check(f"{what}: out of reach without a proof, or a proof against a feasible target", int(beyond.sum()),
                float((proved != beyond).sum()), 0.0)  # fmt: skip
    met = np.abs(problem.given(a.P) - y).max(axis=1) < 1e-8
    yield Check(f"{what}: false statuses", len(y), float(((a.status == Status.EXACT) != met).sum()), 0.0)


def faces(t: Targets) -> Check:
    """Return the check against the best of all 3^m faces, in fractions of the supply."""
    p = t.problem
    (_, ends), (lo, hi, centre) = p.rows, p.x_bounds
    best = best_of_all_faces(p.A[0], p.b, ends, lo[0], hi[0], centre[0])
    a = allocate(t.q, t.K, t.T, joint=t.mechanism)
    return Check(
        "arm26 against all 729 faces, of the supply", len(best), float(np.abs(a.P / p.unit - best).max()), 1e-9
    )


def one_joint(N: int) -> Iterator[Check]:
    """Return the check of n = 1, m = 2 against `allocate`, in fractions of the supply."""
    for name, joint in JOINTS.items():
        if not joint.affine:
            continue
        rng = np.random.default_rng(5)
        theta = rng.uniform(*joint.angle_range, N)
        P = rng.uniform(*joint.pressure_limits, (2, N))
        T = joint.torque(theta, *P) * np.where(np.arange(N) % 2, 1.0, 3.0)
        K = np.abs(joint.stiffness(theta, *P)) * np.where(np.arange(N) % 3, 1.0, 2.0) + 0.1
        mechanism, worst = Mechanism.from_joint(joint), 0.0
        for priority, weights in (("torque", None), ("stiffness", None), ("weighted", (1.0, 1.0))):
            one = allocate(theta, K, T, joint=joint, priority=priority, weights=weights)
            asked = {"priority": priority, "weights": weights}
            many = allocate(theta[:, None], K[:, None], T[:, None], joint=mechanism, **asked)
            off = np.abs(many.P - np.stack([one.P1, one.P2], axis=-1)).max() / joint.pressure_limits[1]
            worst = max(worst, float(off))
        yield Check(f"n = 1, m = 2: {name} against allocate, of the supply", 3 * N, worst, 1e-9)


def target_by_target(t: Targets) -> Iterator[Check]:
    """Yield checks of single compiled targets under changing limits against the readable implementation and DAQP."""
    readable, rng = machines.arm26(), np.random.default_rng(7)  # which is not warmed up
    warm_up(joint=t.mechanism)
    kept = Limits(), Limits(None), Limits(40.0, 350.0), Limits(max_step=0.5 * BAR)
    off: tuple[list[float], list[float]] = [], []
    other, statuses = 0, set()
    for i, (q, T, K) in enumerate(zip(1.6 * t.q, t.T, t.K, strict=True)):  # some beyond the joints' range
        limits = kept[i % 4]
        limits = limits if limits.max_step is None else limits._replace(previous=rng.uniform(0, 5 * BAR, t.mechanism.m))
        asked = {"limits": limits, "priority": ("torque", "stiffness")[i % 2]}
        given = K if i % 3 else np.diag(K)
        one = allocate(q, given, T, joint=t.mechanism, **asked)
        others = [allocate(q, given, T, joint=readable, method=method, **asked) for method in ("exact", "qp")]
        for found, distances in zip(others, off, strict=True):
            if found.status != Status.SOLVER_FAILED or distances is off[0]:  # DAQP ends without an answer now and then
                distances.append(float(np.abs(one.P - found.P).max()) / (5 * BAR))
        other += one.status != others[0].status
        statuses.add(one.status)
    what = "arm26, target by target under four sets of limits"
    yield Check(f"{what}: compiled against readable, of the supply", len(off[0]), max(off[0]), 1e-9)
    yield Check(f"{what}: other statuses than readable, of {len(statuses)}", len(off[0]), float(other), 0.0)
    yield Check(f"{what}: compiled against DAQP where it solves, of the supply", len(off[1]), max(off[1]), 1e-7)
