"""A step of the MPC in closed loop, against nonlinear MPCs on the same problem and against other solvers of its QP."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.util import find_spec
from math import inf, nan
from time import thread_time
from typing import Any

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from benchmarks.speed.acados import alone
from benchmarks.speed.acados.rti import AcadosRTI, available
from benchmarks.speed.clock import MISSED, Measurement, seconds
from benchmarks.speed.steps.loop import DT, Loop, closed_loop
from benchmarks.speed.steps.rivals import CvxpyOSQP, DoMPC
from benchmarks.speed.truth import BenchmarkFailure
from mpc import Plant, TrackingMPC
from mpc.tracking.qp.programme import QP
from mpc.tracking.qp.solvers import solver
from mpc.tracking.qp.step import certified
from mpc.trials.simulation import Controller
from mpc.yardsticks.nonlinear import NonlinearMPC

PART = "control"
CLOSE = 2e-3 * BAR  # [Pa] tolerance of equal commands
Maker = Callable[[Plant, int], Controller]

NONLINEAR: dict[str, Maker] = {
    "IPOPT": lambda plant, N: NonlinearMPC(plant, DT, N, solver="ipopt"),
    "fatrop": lambda plant, N: NonlinearMPC(plant, DT, N, solver="fatrop"),
}
RTI = "acados, RTI, its C function alone"
SETTLED: dict[str, Maker] = {RTI: lambda plant, N: AcadosRTI(plant, DT, N, iterations=20)}  # for the check
WANTED = {("IPOPT", 20): 150.0, ("do-mpc", 20): 250.0}
AT_MOST = {20: {"tail": 3.5, "outside": 0.5, "cost": 1.0005}, 40: {"tail": 5.0}, 80: {"tail": 6.0}}  # requirements
ALONE = (20, 40, 80)  # horizons with QPs solved also by HPIPM
GROWTH = 4.5  # greatest growth of the mean time of a step from N = 20 to N = 80
FLOORS = {("IPOPT", 20): 30.0}
BLOCKS = {20: (1,) * 10 + (2,) * 5, 40: (1,) * 10 + (2,) * 5 + (4,) * 5, 80: (1,) * 10 + (2,) * 5 + (4,) * 5 + (8,) * 5}


def measure(light: bool) -> Iterator[Measurement]:
    """Yield the measurements of every horizon; the light version of one, against IPOPT alone."""
    rivals = dict(NONLINEAR)
    if find_spec("do_mpc"):
        rivals["do-mpc"] = lambda plant, N: DoMPC(plant, DT, N)
    if available():
        rivals[RTI] = lambda plant, N: AcadosRTI(plant, DT, N)
    elif not light:
        yield Measurement(PART, "MPC step by acados, RTI", nan, "step", note="not found: its place is open")
    for N in (20,) if light else (10, 20, 40, 80):
        chosen = {"IPOPT": rivals["IPOPT"]} if light else rivals
        check_commands(N, chosen)
        yield from loops(N, chosen, duration=1.5 if light else 3.0)
        yield from qps(N, rounds=5 if light else 15)
        if not light and N in ALONE:
            yield from alone.measure(N)
    if not light:
        yield growth()


def mpc(plant: Plant, N: int, **settings: Any) -> TrackingMPC:
    return TrackingMPC(plant, DT, N, **settings)


def check_commands(N: int, rivals: dict[str, Maker]) -> None:
    """Check that repeated QPs and all nonlinear solvers give the same commands, for as much of the plan as known."""
    plant = Plant()
    x = plant.at_rest(0.0, 7.6)
    for theta, K, d in tasks(N):
        right = mpc(plant, N, iterations=20).step(x, theta, K, d).u
        for name, make in rivals.items():
            make = SETTLED.get(name, make)
            found = make(plant, N).step(x, theta, K, d).u
            if not (off := np.abs(found - right[: len(found)]).max()) <= CLOSE:
                raise BenchmarkFailure(f"{name}, N = {N}: commands {off / BAR:.2g} bar from those of repeated QPs")


def tasks(N: int) -> Iterator[tuple[Array, Array, float]]:
    """Return θ, K and load with a slew limit that binds in most of the plan, or nowhere: binding hides differences."""
    k = np.arange(N + 1)
    yield np.where(k < N // 2, 0.0, 5 * DEG), np.full(N + 1, 7.7), 0.2
    yield 0.1 * DEG * k / N, np.full(N + 1, 7.61), 0.02


def loops(N: int, rivals: dict[str, Maker], duration: float) -> Iterator[Measurement]:
    """Compare the steps of two runs of the same trajectory; this project's runs surround each rival's."""
    own = [closed_loop(lambda plant: mpc(plant, N), duration)]
    for name, make in rivals.items():
        other = rival_loop(lambda plant, make=make: make(plant, N), duration)
        own.append(closed_loop(lambda plant: mpc(plant, N), duration))
        yield compared(f"MPC step, N = {N}", own[-2:], name, other, N)
        if name == "IPOPT" and (blocks := BLOCKS.get(N)):
            blocked = [closed_loop(lambda plant: mpc(plant, N, blocks=blocks), duration) for _ in range(2)]
            share = blocked[1].cost(N) / own[-1].cost(N)
            note = f"cost {share:.4f} of that without blocks"
            yield compared(f"MPC step, N = {N} in {len(blocks)} blocks", blocked, name, other, N, note)
    if N in AT_MOST:
        yield from shares(N, own)


def shares(N: int, own: list[Loop]) -> Iterator[Measurement]:
    """Yield the slowest steps over the median, and the share outside the QP, from the fastest of all runs."""
    what, asked, runs = f"MPC step, N = {N}", AT_MOST[N], np.array([loop.seconds for loop in own])
    fastest = runs.min(axis=0)
    median, slow = float(np.median(fastest)), float(np.quantile(fastest, 0.99))
    low, high = np.quantile(np.median(runs, axis=1) / np.quantile(runs, 0.99, axis=1), (0.25, 0.75))
    means = f"{what}, 99 % of the steps", slow, "step", "its median", median
    yield Measurement(PART, *means, median / slow, low, high, 1 / asked["tail"])
    outside = np.array([loop.outside for loop in own])
    low, share, high = np.quantile(outside, (0.25, 0.5, 0.75))
    means = f"{what}, outside the QP", float(share * median), "step", "the whole step", median
    yield Measurement(PART, *means, 1 / share, 1 / high, 1 / low, 1 / asked["outside"] if "outside" in asked else nan)


def rival_loop(make: Callable[[Plant], Controller], duration: float) -> Loop:
    """Return one run of a rival; for acados the faster of two, as for this project, of its C function alone."""
    made: list[Controller] = []

    def remembered(plant: Plant) -> Controller:
        made.append(make(plant))
        return made[-1]

    loop = closed_loop(remembered, duration)
    if not isinstance(first := made[0], AcadosRTI):
        return loop
    once = np.array(first.seconds)  # which a second run overwrites
    closed_loop(lambda plant: first, duration)
    return replace(loop, seconds=np.minimum(once, first.seconds))


def compared(what: str, own: list[Loop], name: str, other: Loop, N: int, note: str = "") -> Measurement:
    """Compare the faster of this project's two runs, sample by sample, with a rival's."""
    mine = np.minimum(own[0].seconds, own[1].seconds)
    low, ratio, high = np.quantile(other.seconds / mine, (0.25, 0.5, 0.75))
    cost = own[1].cost(N) / other.cost(N)
    notes = (
        f"limits bind in {own[1].saturated:.0%} of the plans",
        judged(f"cost {cost:.4f} of the rival's", cost, AT_MOST.get(N, {}).get("cost")),
        note,
    )
    return Measurement(
        *(PART, what, float(np.median(mine)), "step", name, float(np.median(other.seconds)), ratio, low, high),
        *(WANTED.get((name, N), nan), FLOORS.get((name, N), nan), "; ".join(filter(None, notes))),
    )


def growth() -> Measurement:
    """Measure the mean step of a horizon four times as long, including slow steps, in turns."""
    runs = {N: [closed_loop(lambda plant, N=N: mpc(plant, N), 3.0).seconds for _ in range(3)] for N in (20, 80)}
    short, long = (np.min(runs[N], axis=0) for N in (20, 80))
    ratios = [one.mean() / other.mean() for one, other in zip(runs[20], runs[80], strict=True)]
    low, ratio, high = np.quantile(ratios, (0.25, 0.5, 0.75))
    means = float(long.mean()), "step", "N = 20, mean", float(short.mean())
    return Measurement(PART, "MPC step, N = 80, mean", *means, ratio, low, high, 1 / GROWTH)


def judged(words: str, value: float, most: float | None) -> str:
    """Return the text of a requirement, and whether it was missed."""
    if most is None:
        return words
    return f"{words}, at most {most:g} asked{'' if value <= most else f': {MISSED}'}"


def qps(N: int, rounds: int) -> Iterator[Measurement]:
    """Measure the whole step in closed loop, against only the solution of such a QP by cvxpy with OSQP."""
    plant = Plant()
    controller = mpc(plant, N)
    qp = whole(controller, plant.at_rest(0.0, 7.6), np.linspace(0.0, 10 * DEG, N + 1), np.full(N + 1, 8.0))
    other = CvxpyOSQP(qp)
    exact = certified(solver("daqp"), qp, inf, controller.problem.curvature).z
    if np.abs(other(qp) - exact)[:2].max() * BAR > CLOSE:
        raise BenchmarkFailure(f"cvxpy + OSQP, N = {N}: first changes {other(qp)[:2]} bar, not {exact[:2]} bar")
    mine = float(np.median(closed_loop(lambda plant: mpc(plant, N), 1.0).seconds))
    theirs = np.array([seconds(lambda: other(qp), clock=thread_time) for _ in range(rounds)])
    low, ratio, high = np.quantile(theirs / mine, (0.25, 0.5, 0.75))
    name = "cvxpy + OSQP, a QP alone"
    yield Measurement(PART, f"MPC step, N = {N}", mine, "step", name, float(np.median(theirs)), ratio, low, high)


def whole(controller: TrackingMPC, x: Array, theta: Array, K: Array) -> QP:
    """Return the QP of a step from `x` with all of its rows."""
    from mpc.tracking.qp.condense import condense

    feed = controller._feed_forward(theta, K, np.zeros(len(theta)))
    model = controller._predictor.linearise(x, controller.limits.limited(x[2:], feed.u))
    return condense(controller.problem, model, feed, x[2:], feed.u[0])
