"""Processor times, in turns with the rivals, which solve the same problems in the same run."""

import warnings
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from allocator import allocate, warm_up
from allocator.allocation.box import pivoting
from allocator.allocation.box.arguments import problem_from
from allocator.mechanism import machines
from benchmarks.mechanisms.targets import POSTURE, Targets, arm_at_postures, random_mechanism, random_targets
from benchmarks.speed.clock import seconds

FEW = 200  # targets for the rivals, which are called one by one
FLAT = 1e-3  # cost of the pressures in the weighted QP, per (supply)², if 1 [N·m/rad]² costs 1
BATCH, KERNEL = "compiled batch, with statuses", "the kernel alone"
BOTH = "the kernel alone, weighted, then least pressures"
Solver = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Time(NamedTuple):
    """Processor time of a target: the least of the rounds, since other work on the machine only adds."""

    what: str
    microseconds: float
    off: float  # of the pressures from the exact ones, of the supply; 0 for ours, which are checked elsewhere


def times(rounds: int) -> list[Time]:
    """Yield all times, of `rounds` rounds in turns."""
    if not warm_up(joint=machines.arm26()):
        raise SystemExit("numba cannot compile here; there is nothing to measure")
    return [*lexicographic(rounds), *weighted(rounds), *sizes(rounds)]


def in_turns(works: dict[str, Callable[[], object]], units: dict[str, int], rounds: int) -> dict[str, float]:
    """Return the least time [µs] per target of each work."""
    for work in works.values():
        work()
    turns = [{name: seconds(work) for name, work in works.items()} for _ in range(rounds)]
    return {name: 1e6 * min(turn[name] for turn in turns) / units[name] for name in works}


def lexicographic(rounds: int) -> list[Time]:
    """Time torque, then stiffness, then least pressure, with status and certificate, on the arm with six muscles."""
    one, own = random_targets(machines.arm26(), POSTURE, 10_000), arm_at_postures(10_000)
    few = Targets(one.mechanism, one.q, one.T[:FEW], one.K[:FEW])
    warm_up(joint=few.mechanism)
    exact = allocate(few.q, few.K, few.T, joint=few.mechanism)
    problem, readable = one.problem, machines.arm26()  # the latter is not warmed up
    works = {
        "the kernel alone": lambda: pivoting.solve(problem),
        "compiled, target by target from Python": lambda: [
            allocate(few.q, K, T, joint=few.mechanism) for K, T in zip(few.K, few.T, strict=True)
        ],
        "readable, target by target from Python": lambda: [
            allocate(few.q, K, T, joint=readable) for K, T in zip(few.K, few.T, strict=True)
        ],
        "compiled batch, one posture": lambda: allocate(one.q, one.K, one.T, joint=one.mechanism),
        "compiled batch, every target at its own posture": lambda: allocate(own.q, own.K, own.T, joint=own.mechanism),
        "DAQP, three QPs called from Python": lambda: daqp_levels(few),
        "DAQP through qpsolvers (method='qp')": lambda: allocate(few.q, few.K, few.T, joint=few.mechanism, method="qp"),
    }
    units = {name: FEW if "DAQP" in name or "target by target" in name else 10_000 for name in works}
    found = in_turns(works, units, rounds)
    off = {
        "DAQP, three QPs called from Python": daqp_levels(few),
        "DAQP through qpsolvers (method='qp')": works["DAQP through qpsolvers (method='qp')"]().P / 5e5,
    }
    return [
        Time(f"lexicographic: {name}", t, float(np.abs(off[name] - exact.P / 5e5).max()) if name in off else 0.0)
        for name, t in found.items()
    ]


def daqp_levels(t: Targets) -> np.ndarray:
    """Solve the three QPs by `daqp.solve` itself, with only the sums for the next one's equalities."""
    import daqp

    p = t.problem
    (_, ends), (lo, hi, centre) = p.rows, p.x_bounds
    A, (e1, e2), m = p.A[0], ends, lo.shape[1]
    A1, A2, sense = (
        A[:e1],
        A[e1:e2],
        [np.concatenate([np.zeros(m), np.full(k, 5)]).astype(np.int32) for k in (0, e1, e2)],
    )
    H1, H2, H3, none = A1.T @ A1, A2.T @ A2, np.eye(m), np.zeros((0, m))
    options = {"primal_tol": 1e-9, "dual_tol": 1e-10}
    found = np.empty(lo.shape)
    for i in range(len(lo)):
        b1, b2, low, high = p.b[i, :e1], p.b[i, e1:e2], lo[i], hi[i]
        x = daqp.solve(H1, -A1.T @ b1, none, high, low, sense[0], **options)[0]
        kept = A1 @ x
        x = daqp.solve(H2, -A2.T @ b2, A1, np.r_[high, kept], np.r_[low, kept], sense[1], **options)[0]
        kept = A @ x
        x = daqp.solve(H3, -centre[i], A, np.r_[high, kept], np.r_[low, kept], sense[2], **options)[0]
        found[i] = x
    return found


def weighted(rounds: int) -> list[Time]:
    """Time one strictly convex QP per target, w_T : w_K : pressures = 1e4 : 1 : FLAT, the same for every solver."""
    t = random_targets(machines.arm26(), POSTURE, 10_000)
    p = t.problem
    lo, hi, _ = p.x_bounds
    m = lo.shape[1]
    rows = np.concatenate([np.full(2, 1e2), np.ones(3)])[:, None]
    A = np.concatenate([rows * p.A[0], np.sqrt(FLAT) * np.eye(m)])
    b = np.concatenate([rows[:, 0] * p.b, np.zeros((len(p.b), m))], axis=1)
    H = A.T @ A
    one = {
        "priority": "weighted",
        "weights": (1e4, 1.0),
        "pull": (FLAT / t.mechanism.pressure_limits[1] ** 2, np.zeros(m)),
    }

    def ours() -> np.ndarray:
        return allocate(t.q, t.K, t.T, joint=t.mechanism, **one).P / p.unit

    def one_by_one(solver: Solver) -> Callable[[], np.ndarray]:
        return lambda: np.array([solver(A, b[i], H, lo[i], hi[i]) for i in range(FEW)])

    ranked = replace(p, priority="weighted", weights=np.repeat([1e4, 1.0, 2.0, 1.0], [2, 1, 1, 1]))
    posed = problem_from(*t[:2], t.K, t.T, **one)[0]
    works = {BATCH: ours, KERNEL: lambda: pivoting.solve(posed).x, BOTH: lambda: pivoting.solve(ranked).x} | {
        name: one_by_one(make(H, lo[0], hi[0])) for name, make in solvers().items()
    }
    found = in_turns(works, {name: len(lo) if name in (BATCH, KERNEL, BOTH) else FEW for name in works}, rounds)
    exact = ours()[:FEW].copy()
    return [
        Time(f"one QP: {name}", found[name], float(np.abs(work()[:FEW] - exact).max())) for name, work in works.items()
    ]


def solvers() -> dict[str, Callable[..., Solver]]:
    """Return rivals for a Hessian and a box that take (A, b, H, lo, hi) and return x; PIQP if it is installed."""
    found: dict[str, Callable[..., Solver]] = {"DAQP": _daqp, "SciPy BVLS": _bvls, "OSQP (1e-6)": _osqp}
    return found | ({"PIQP": _piqp} if find_spec("piqp") else {})


def _daqp(H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> Solver:
    import daqp

    none, sense = np.zeros((0, len(H))), np.zeros(len(H), np.int32)
    return lambda A, b, H, lo, hi: daqp.solve(H, -A.T @ b, none, hi, lo, sense)[0]


def _bvls(H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> Solver:
    from scipy.optimize import lsq_linear

    return lambda A, b, H, lo, hi: lsq_linear(A, b, (lo, hi), method="bvls", tol=1e-12).x


def _osqp(H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> Solver:
    import osqp
    from scipy import sparse

    solver = osqp.OSQP()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        solver.setup(sparse.csc_matrix(np.triu(H)), np.zeros(len(H)), sparse.eye(len(H), format="csc"), lo, hi,
                     eps_abs=1e-6, eps_rel=1e-6, verbose=False, max_iter=20_000)  # fmt: skip

    def solve(A: np.ndarray, b: np.ndarray, H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        solver.update(q=-A.T @ b)
        return np.array(solver.solve(raise_error=False).x)

    return solve


def _piqp(H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> Solver:
    import piqp

    solver = piqp.DenseSolver()
    solver.setup(H, np.zeros(len(H)), x_l=lo, x_u=hi)

    def solve(A: np.ndarray, b: np.ndarray, H: np.ndarray, lo: np.ndarray, hi: np.ndarray) -> np.ndarray:
        solver.update(c=-A.T @ b)
        solver.solve()
        return np.array(solver.result.x)

    return solve


def sizes(rounds: int) -> list[Time]:
    """Time lexicographic batches of larger mechanisms, all targets at one posture."""
    works, units = {}, {}
    for n, m in ((2, 6), (3, 9), (4, 12), (7, 20)):
        mechanism = machines.arm26() if m == 6 else random_mechanism(n, m)
        t = random_targets(mechanism, np.full(n, 0.1), 20_000 // n**2)
        name = f"n/m = {n}/{m}, compiled batch"
        works[name] = lambda t=t: allocate(t.q, t.K, t.T, joint=t.mechanism)
        units[name] = len(t.T)
    return [Time(name, t, 0.0) for name, t in in_turns(works, units, rounds).items()]
