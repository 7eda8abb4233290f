"""Function `tune`: search for the parameters of a loop that minimise its objective, by an evolution strategy.

CMA-ES of the library pycma (Hansen, arXiv:1604.00772) searches over the logarithms of the numbers, from the defaults.
It uses only the order of the objectives, which the charge beyond the limit of M_s preserves (`mpc.tuning.cost`). The
defaults are the first evaluation, so the answer is never worse than they are. The seed determines all draws and
points, for any executor.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from functools import lru_cache
from typing import Any

import numpy as np

from allocator import checks
from allocator.calculus import Value
from allocator.errors import InvalidInput, MissingBackend
from mpc.model.arm.model import Arm
from mpc.model.compensation import Compensation
from mpc.model.machine import Machine, check_machine
from mpc.trials.loops import Settings, robust
from mpc.trials.margins import ROBUST
from mpc.trials.tuned import Tuning, parameters_of
from mpc.tuning.cost import Evaluation, Problem
from mpc.tuning.draws import Spreads
from mpc.tuning.result import Tuned
from mpc.tuning.tour import Tour

EVALUATIONS, DRAWS = 60, 8  # a few minutes on two cores
_STEP = 0.5  # standard deviation of the first points [-], of logarithms: a factor of 1.6
_OF_RANGE = 0.25  # and at most this share of a range

Progress = Callable[..., Iterable[Evaluation]]


def tune(
    plant: Machine,
    compensation: Compensation | None = None,
    *,
    controller: str = "mpc",
    spreads: Spreads | None = None,
    K: Value | None = None,
    peak: float = ROBUST,
    evaluations: int = EVALUATIONS,
    n_draws: int = DRAWS,
    seed: int = 0,
    dt: float = 0.01,
    horizon: int = 20,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Tuned:
    """Return the numbers of a controller and its observer that suit a fitted plant or arm best, and their figures.

    The search minimises the mean closed-loop cost over draws of real machines, subject to limits of M_s. The defaults
    stay unless a tuning is better by 10 %. The loops of an arm are not compiled as a whole, so its evaluations take
    several times as long.

    Parameters
    ----------
    plant, compensation
        The model, a `Plant` or an `Arm` with formulas, and the compensation of controller and observer:
        `Plant.load` and `Compensation.load`. By default a joint's own hysteresis is known.
    controller
        Kind of loop: mpc, lqr, predictive-pid, pid, pi; of an arm mpc.
    spreads
        Deviations of real plants, as read by `Spreads.load` from a file; None: those of data sheets.
    K
        Stiffness [N·m/rad] of the tour, a matrix (k, k) for an arm; by default the machine's usual one.
    peak
        Limit of M_s, the peak of the sensitivity, on the model; it may be exceeded by 0.1, since the defaults meet it
        at one posture. The limit of the 80 % quantile over the draws is half as large again.
    evaluations, n_draws
        Number of tunings to try, and of real plants to try each on.
    seed
        Seed of draws, sensor noise and search.
    dt, horizon
        Sample time [s] and horizon of the MPC in samples.
    executor
        Any `concurrent.futures.Executor` to run on, e.g. a `ProcessPoolExecutor`, or `distributed.Client(...)
        .get_executor()` for a Dask cluster (extra `antagonist[dask]`). None: in this thread.
    progress
        Function around the iteration over evaluations, called with `total=`: `tqdm.tqdm`, `rich.progress.track`.

    Raises
    ------
    InvalidInput
        For `evaluations` below 2, `n_draws` below 1, a `peak` of 1 or less, which no loop keeps, and an arm without
        formulas.
    MissingBackend
        For a controller that cannot be tuned.
    """
    check_machine(plant)
    evaluations, n = checks.count("evaluations", evaluations, least=2), checks.count("n_draws", n_draws, least=1)
    seed = checks.count("seed", seed, least=0)
    if not (peak := checks.number("peak", peak, "-")) > 1:
        raise InvalidInput(f"peak = {peak:g} has to be above 1: no loop that feeds back keeps such an M_s")
    parameters_of(controller)
    if isinstance(plant, Arm) and controller != "mpc":
        raise MissingBackend("controller to tune for an arm", controller, ("mpc",))
    spreads = Spreads() if spreads is None else spreads
    own = Compensation() if isinstance(plant, Arm) else Compensation.of(plant.joint)
    known = own if compensation is None else compensation
    settings = robust(controller, Settings(plant, dt, horizon, known))
    tour = Tour.of(plant, dt, K if K is None or isinstance(plant, Arm) else checks.positive("K", K, "N·m/rad"))
    problem = Problem.of(controller, settings, tour, n, seed, spreads, peak)
    found = _searched(problem, evaluations, executor)
    return Tuned(problem, tuple(found if progress is None else progress(found, total=evaluations)))


def _searched(problem: Problem, evaluations: int, executor: Executor | None) -> Iterator[Evaluation]:
    """Yield the evaluations: the defaults first, then generation after generation."""
    import cma

    start = Tuning.start(problem.controller, problem.settings)
    parameters = parameters_of(problem.controller)
    low, high = (np.log([getattr(p, end) for p in parameters.values()]) for end in ("low", "high"))
    at = np.clip(np.log([*start.numbers.values()]), low, high)
    random = np.random.default_rng([problem.seed, 35])
    options: dict[str, Any] = {
        "bounds": [low, high],
        "CMA_stds": np.minimum(1.0, _OF_RANGE / _STEP * (high - low)),
        "seed": np.nan,  # do not seed NumPy's global generator
        "randn": lambda *shape: random.standard_normal(shape),
        "verbose": -9,
        "verb_log": 0,
    }
    yield problem.evaluated(start, always=True)
    strategy, left = cma.CMAEvolutionStrategy(at, _STEP, options), evaluations - 1
    while left > 0:
        points = strategy.ask()
        tunings = [Tuning(problem.controller, dict(zip(parameters, np.exp(x).tolist(), strict=True))) for x in points]
        tried = []
        for one in _each(problem, tunings[:left], executor):
            tried.append(one)
            yield one
        left -= len(tried)
        if left > 0:
            strategy.tell(points, [one.objective for one in tried])


def _each(problem: Problem, tunings: list[Tuning], executor: Executor | None) -> Iterator[Evaluation]:
    """Yield the evaluations of the tunings, in their order."""
    if executor is None:
        yield from map(problem.evaluated, tunings)
        return
    futures = [executor.submit(_evaluated, problem, tuning) for tuning in tunings]
    try:
        for future in futures:
            yield future.result()
    finally:
        for future in futures:
            future.cancel()


@lru_cache(maxsize=1)
def _kept(problem: Problem) -> Problem:
    """Return the equal problem of an earlier call, with its compiled functions."""
    return problem


def _evaluated(problem: Problem, tuning: Tuning) -> Evaluation:
    """Return the evaluation of a tuning, in another process."""
    return _kept(problem).evaluated(tuning)
