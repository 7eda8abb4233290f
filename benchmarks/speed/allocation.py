"""`allocate`: one target, a batch, a map, every back-end, against optimisers and against C."""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from hashlib import sha256
from time import perf_counter

import numpy as np

from allocator import Method, Stiffness, allocate, report_joint, warm_up
from allocator.allocation.two_muscles.kernels import kernel
from allocator.allocation.two_muscles.kernels.choice import TonduNumbers
from benchmarks.allocators.targets import JOINTS
from benchmarks.speed.c_reference import c_reference, compiler
from benchmarks.speed.clock import Measurement, Work, versus
from benchmarks.speed.rivals import RIVALS, Problems
from benchmarks.speed.targets import Answers, Targets
from benchmarks.speed.truth import NO_SHORT_CUT, check_pressures, check_same

PART = "allocation"
SINGLE = 200  # targets solved one by one
SLOW = 60  # the same by optimisers
CLOSE = 50.0  # [Pa] tolerance of an optimiser's answer
BACK_ENDS = (("qp", "daqp"), ("qp", "osqp"), ("nlp", "ipopt"), ("nlp", "sqpmethod"))


def measure(light: bool) -> Iterator[Measurement]:
    """Yield all measurements; the plain kernels first, before anything is compiled."""
    rounds = 3 if light else 9
    few = Targets(SINGLE, seed=1)
    loops = {name: optimiser_loop(name, few) for name in (("SciPy SLSQP", "CasADi + IPOPT") if light else RIVALS)}
    # SLSQP calls our joint for torque and stiffness, which became 1.5 times faster: 33 corresponds to the former 50
    yield scalar("one target, not compiled", few, loops["SciPy SLSQP"], rounds, floor=33.0)
    warm_up(), warm_up(joint=LEVER)
    yield scalar("one target", few, loops["SciPy SLSQP"], rounds, wanted=150.0, floor=75.0)
    yield control_horizon(rounds)
    many = Targets(200_000 if light else 1_000_000)
    check_same("allocate", many, answers(many))
    yield from against_c(many, rounds)
    yield machine_threads(rounds)
    yield threads(Targets(1_000_000), rounds)
    for name, loop in loops.items():
        ipopt = name == "CasADi + IPOPT"
        with thread_count(1):
            yield versus(
                *(PART, batch_name(many), lambda: answers(many), f"{name}, one by one", loop),
                units=(many.n, SLOW),
                rounds=rounds,
                wanted=20_000.0 if ipopt else np.nan,
                floor=10_000.0 if ipopt else np.nan,
            )
    yield affine(rounds)
    yield from growth(6 if light else 7, rounds)
    if not light:
        yield feasibility_map(rounds)
        yield from back_ends(few)


LEVER = JOINTS["Sarosi2012 (400N, 200N) on a lever"]


def answers(targets: Targets) -> Answers:
    """Return the answers of `allocate`."""
    a = allocate(*targets.arrays, joint=targets.joint)
    return Answers(a.P1, a.P2, a.T, a.K, a.status, a.limits)


def batch_name(targets: Targets) -> str:
    return f"batch of {targets.n:.0e}".replace("e+0", "e")


@contextmanager
def thread_count(n: int) -> Iterator[None]:
    """Set the number of threads for compiled loops."""
    import numba

    before, numba.config.NUMBA_NUM_THREADS = numba.config.NUMBA_NUM_THREADS, n
    try:
        yield
    finally:
        numba.config.NUMBA_NUM_THREADS = before


def optimiser_loop(name: str, targets: Targets) -> Work:
    """Return a function that solves the first `SLOW` targets by an optimiser, one by one; checked."""
    solve, exact = RIVALS[name](Problems(targets)), answers(targets)
    found = np.array([solve(i) for i in range(targets.n)])
    check_pressures(name, found, np.stack([exact.P1, exact.P2], 1), CLOSE, share=0.97)
    return lambda: [solve(i) for i in range(SLOW)]


def scalar(
    what: str, targets: Targets, slsqp: Work, rounds: int, wanted: float = np.nan, floor: float = np.nan
) -> Measurement:
    def loop() -> None:
        for theta, K, T in targets.rows:
            allocate(theta, K, T)

    ones = [allocate(*row) for row in targets.rows]
    fields = zip(*((a.P1, a.P2, a.T, a.K, int(a.status), a.limits) for a in ones), strict=True)
    check_same(what, targets, Answers(*map(np.array, fields)))
    units = (targets.n, SLOW)
    return versus(
        *(PART, what, loop, "SciPy SLSQP", slsqp),
        units=units,
        repeats=(20, 1),
        rounds=rounds,
        wanted=wanted,
        floor=floor,
    )


def readable(targets: Targets) -> Callable[[], object]:
    """Return the same by the readable NumPy implementation."""
    return lambda: allocate(*targets.arrays, joint=targets.joint, stiffness=Stiffness(tolerance=NO_SHORT_CUT))


def control_horizon(rounds: int) -> Measurement:
    targets = Targets(21, seed=2)
    check_same("21 targets", targets, answers(targets))
    return versus(
        *(PART, "21 targets at once", lambda: answers(targets), "readable implementation", readable(targets)),
        unit="call",
        repeats=(200, 10),
        rounds=rounds,
        floor=8.0,
    )


def against_c(targets: Targets, rounds: int) -> Iterator[Measurement]:
    """Measure one thread, with the checks, new memory for the answers and the result; and the bare loop."""
    if compiler() is None:
        return
    p, loop = tuple(TonduNumbers.of(report_joint()) or ()), kernel("tondu_batch")
    assert loop is not None
    filled = Answers.empty(targets.n)
    out = (*Answers.empty(targets.n), np.empty(targets.n, bool))
    with c_reference(targets) as c, thread_count(1):
        c(filled)
        check_same("C", targets, filled)
        units = (targets.n, targets.n)
        yield versus(
            *(PART, batch_name(targets), lambda: answers(targets), "C, -O3 -march=native", lambda: c(filled)),
            units=units,
            rounds=rounds,
            wanted=0.5,
            floor=0.3,
            note="C writes into existing memory",
        )
        yield versus(
            *(PART, "its compiled loop alone", lambda: loop(*targets.arrays, p, 0.0, *[None] * 5, out)),
            *("C, -O3 -march=native", lambda: c(filled)),
            units=units,
            rounds=rounds,
            wanted=0.5,
            floor=0.4,
        )


def threads(targets: Targets, rounds: int) -> Measurement:
    def by(n: int) -> Work:
        def run() -> None:
            with thread_count(n):
                answers(targets)

        return run

    units = (targets.n, targets.n)
    return versus(
        *(PART, f"{batch_name(targets)}, two threads", by(2), "one thread", by(1)),
        units=units,
        rounds=2 * rounds + 1,
        wanted=1.0,
        floor=0.5,
        clock=perf_counter,
    )


def machine_threads(rounds: int) -> Measurement:
    """Measure the present gain by a second processor: hashing, which needs neither memory nor the interpreter."""
    block = bytes(2_000_000)

    def by(n: int) -> Work:
        def run() -> None:
            with ThreadPoolExecutor(n) as pool:
                list(pool.map(lambda _: sha256(block), range(8)))

        return run

    return versus(
        *(PART, "(the machine: hashing by two threads)", by(2), "one thread", by(1)),
        unit="call",
        rounds=2 * rounds + 1,
        clock=perf_counter,
    )


def affine(rounds: int) -> Measurement:
    targets = Targets(50_000, joint=LEVER)
    check_same("affine muscles", targets, answers(targets))
    return versus(
        *(PART, "batch of 5e4, Sarosi2012 on a lever", lambda: answers(targets)),
        *("readable implementation", readable(targets)),
        units=(targets.n, targets.n),
        rounds=min(rounds, 3),
        floor=2.0,
    )


def growth(decades: int, rounds: int) -> Iterator[Measurement]:
    """Measure the time per target against that in a batch of a thousand: 1 and above is at most linear."""
    thousand = Targets(1000)
    for exponent in range(4, decades + 1):
        targets, n = Targets(10**exponent), 10**exponent
        yield versus(
            *(PART, f"batch of 1e{exponent}", lambda t=targets: answers(t)),
            *("batch of 1e3", lambda: answers(thousand)),
            units=(n, 1000),
            repeats=(max(1, 10**5 // n), 200),
            rounds=min(rounds, 5),
            wanted=1.0,
            floor=0.5,
            note="time a target: linear if not below 1",
        )


def feasibility_map(rounds: int) -> Measurement:
    """Measure 1000 angles by 1000 stiffnesses against as many targets in flat arrays."""
    theta, K = np.linspace(-2.18, 2.18, 1000)[:, None], np.linspace(6.0, 9.0, 1000)
    flat = [np.ascontiguousarray(x).ravel() for x in np.broadcast_arrays(theta, K, 0.5)]
    whole, one = allocate(theta, K, 0.5), allocate(float(theta[700, 0]), float(K[123]), 0.5)
    assert (one.P1, one.status) == (whole.P1[700, 123], whole.status[700, 123])
    million = (10**6, 10**6)
    return versus(
        *(PART, "map of 1000 x 1000", lambda: allocate(theta, K, 0.5), "batch of 1e6", lambda: allocate(*flat)),
        units=million,
        rounds=rounds,
    )


def back_ends(targets: Targets) -> Iterator[Measurement]:
    """Measure every optimising method of `allocate` on ten targets at once, against exact on each."""
    theta, K, T = (x[:10] for x in targets.arrays)
    exact = allocate(theta, K, T)
    right = np.stack([exact.P1, exact.P2], 1)
    slow = [(f"method={m!r}, {s}", {"method": Method(m, solver=s), "joint": targets.joint}) for m, s in BACK_ENDS]
    for name, options in slow:
        found = allocate(theta, K, T, **options)
        check_pressures(name, np.stack([found.P1, found.P2], 1), right, 1e-4 * targets.joint.pressure_span)
        yield versus(
            *(PART, "one target", lambda: [allocate(*row) for row in targets.rows[:10]]),
            *(name, lambda o=options: allocate(theta, K, T, **o)),
            units=(10, 10),
            repeats=(50, 1),
            rounds=3,
        )
    lever = Targets(10, seed=1, joint=LEVER)
    yield versus(
        *(PART, "one target, Sarosi2012 on a lever", lambda: [allocate(*row, joint=LEVER) for row in lever.rows]),
        *("method='convex', clarabel", lambda: allocate(*lever.arrays, joint=LEVER, method="convex")),
        units=(10, 10),
        repeats=(20, 1),
        rounds=3,
    )
