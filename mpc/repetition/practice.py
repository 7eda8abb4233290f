"""Learning of a motion in simulation, and its picture: errors by repetition, and over time before and after."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from allocator.calculus import Array, Value
from allocator.lazy import Figure
from allocator.presentation.plotting import GREY, legend_below, new_figure
from allocator.units import DEG
from mpc.observer.base import Observer
from mpc.repetition.learner import Learner, Repetition
from mpc.trials.motions.corrections import compared
from mpc.trials.motions.reference import Reference
from mpc.trials.simulation import Controller, Load, Process, Run, simulate


@dataclass(frozen=True, eq=False)
class Practice:
    """First and best run of a learned motion, compared with the desired angles."""

    learner: Learner
    first: Run
    best: Run

    def __repr__(self) -> str:
        """Return the gain, and the reason of the end."""
        return f"Practice: {self.learner}"


class Listener:
    """Observer that records the measured angles."""

    def __init__(self, observer: Observer, n: int) -> None:
        self.observer, self.n = observer, n
        self.heard: list[Array] = []

    def reset(self) -> None:
        """Forget the past."""
        self.heard = []
        self.observer.reset()

    def estimate(self, y: Array, u: Array) -> tuple[Array, Value]:
        """Return the observer's estimate."""
        self.heard.append(np.array(y[: self.n]))
        return self.observer.estimate(y, u)


def practise(
    plant: Process,
    controller: Controller,
    learner: Learner,
    *,
    observer: Observer,
    x0: ArrayLike | None = None,
    load: Load | None = None,
    seed: int = 0,
    progress: Callable[[Repetition], None] | None = None,
) -> Practice:
    """Repeat the motion of `learner` in simulation until it is done, and return the first run and the best one.

    All repetitions begin in the same state, `x0` or the plant's rest at the reference's first point, and each has its
    own noise. The learner sees the measured angles. `progress` is called after each repetition. Other arguments are
    those of `simulate`.
    """
    first = best = None
    while not learner.done:
        number = len(learner.history)
        run, theta = played(
            plant, controller, learner.reference, learner, observer=observer, x0=x0, load=load, seed=seed + number
        )
        found = learner.learn(theta)
        first = run if first is None else first
        best = run if best is None or found is learner.best else best
        if progress is not None:
            progress(found)
    assert first is not None
    assert best is not None
    return Practice(learner, first, best)


def played(
    plant: Process,
    controller: Controller,
    given: Reference,
    learner: Learner,
    *,
    observer: Observer,
    x0: ArrayLike | None = None,
    load: Load | None = None,
    seed: int = 0,
) -> tuple[Run, Array]:
    """Return the run along a `given` reference, compared with the desired one, and its measured angles (M, …) [rad]."""
    course, listener = learner.course, Listener(observer, plant.nominal.n)
    run = simulate(plant, controller, given, x0=x0, observer=listener, load=load, seed=seed)
    read = np.array([*listener.heard, listener.heard[-1]])
    age = getattr(getattr(controller, "compensation", None), "reading_age", 0.0)
    theta = on_time(run.t - run.t[0], read, age).reshape(run.theta.shape)
    return compared(run, course.wanted), theta


def on_time(t: Array, read: Array, age: float) -> Array:
    """Return angles (M, n) at the times `t` (M,) [s] from readings of `age` [s], some of which may be missing."""
    columns = []
    for column in read.T:
        seen = np.isfinite(column)
        columns.append(np.interp(t, t[seen] - age, column[seen]))
    return np.stack(columns, axis=1)


_BEFORE, _AFTER = "#D55E00", "#0072B2"


def plot_learning(
    learner: Learner, before: Array, after: Array, title: str = "", figure: "Figure | None" = None
) -> "Figure":
    """Draw the errors by repetition, and the errors of the first and the best one over time.

    `before` and `after` are the angles (M, …) [rad] of the two repetitions; the joints of an arm have a line each.
    Returns the Matplotlib figure, a new one unless `figure` is given.
    """
    figure = new_figure(9, 3.6) if figure is None else figure
    left, right = figure.subplots(1, 2, width_ratios=(1, 1.6))
    rms = np.array([one.rms for one in learner.history]) / DEG
    number = np.arange(1, rms.size + 1)
    left.semilogy(number, rms, "o-", color=_AFTER, label="RMS")
    left.semilogy(number, [one.worst / DEG for one in learner.history], "s:", color=GREY, ms=4, label="worst")
    if learner.update is not None:
        promised = rms[0] * np.array(learner.update.predicted[: rms.size])
        left.semilogy(number, promised, "--", color="k", lw=1, label="RMS predicted")
    left.set(xlabel="repetition", ylabel="angle error [°]", title=title)
    left.set_xticks(_ticks(rms.size))
    legend_below(left)
    course = learner.course
    shown = slice(course.begin, course.count)  # without the first rest
    t, wanted = course.wanted.t[shown], course.wanted.theta[shown]
    for angles, colour, name in ((before, _BEFORE, "first"), (after, _AFTER, "best")):
        lines = right.plot(t, ((angles[shown] - wanted) / DEG).reshape(t.size, -1), color=colour, lw=1)
        lines[0].set_label(f"{name} repetition")
    right.axhline(0, color="k", lw=0.6)
    right.set(xlabel="time [s]", ylabel="angle error [°]", title="before and after")
    legend_below(right)
    return figure


def _ticks(count: int) -> Sequence[int]:
    return range(1, count + 1, max(1, count // 8))
