"""One simulated run, its report and its files, of a joint or an arm."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, NamedTuple, TypeVar

import typer

from allocator.calculus import Array
from allocator.lazy import Console
from allocator.mechanism.endpoint import Endpoint
from allocator.shell.outputs import IMAGES, say
from mpc.model.compensation import Compensation
from mpc.model.plant import Plant
from mpc.observer.base import Observer
from mpc.repetition.options import RepeatOptions, progress, report
from mpc.repetition.practice import Practice, practise
from mpc.repetition.response import Response
from mpc.trials.loops import Settings, margins_in_words, sliding_margins
from mpc.trials.metrics import metrics
from mpc.trials.motions.corrections import Correction, Owner, compared
from mpc.trials.motions.reference import Reference
from mpc.trials.pictures.report import limits_of_reference, plot_margins, table_of, write_run
from mpc.trials.simulation import Controller, Load, Process, Run, simulate

Driven = TypeVar("Driven", bound=Process)
_DATA = ".csv", ".npz", ".mcap"


class Tested(NamedTuple, Generic[Driven]):
    """Plant under test, its controller's knowledge of friction and regulators, and a list of model errors."""

    plant: Driven
    told: Compensation
    unknown: str = ""


@dataclass(frozen=True, eq=False)
class Trial:
    """A controller on a plant under test along a reference."""

    name: str  # of the controller
    settings: Settings
    tested: Process
    controller: Controller
    observer: Observer
    asked: Reference
    owner: Owner  # of a correction
    responses: Callable[[], tuple[Response, ...]]  # of the loop, by models of its plant
    about: Iterable[str]  # sentences before the errors
    load: Load | None = None  # unmodelled
    x0: Array | None = None  # None: at rest
    remarks: Callable[[Run], Iterable[str]] = lambda run: ()  # sentences after the errors
    with_margins: bool = True  # whether the report has a sentence on margins
    title: str = ""  # of pictures
    hand: Endpoint | None = None
    watches: Sequence[Callable[[], None]] = ()  # called after every sample
    film: Callable[[Run, Path], str] | None = None  # writes it; returns a sentence or ""

    @property
    def conditions(self) -> dict[str, Any]:
        """Conditions of a run, arguments of `simulate`."""
        return {"observer": self.observer, "x0": self.x0, "load": self.load}


class Outcome(NamedTuple):
    """Run of a trial, and whence its reference was."""

    run: Run
    practice: Practice | None = None  # of which the run is the best repetition
    played: Correction | None = None


def driven(trial: Trial, repeated: RepeatOptions, seed: int, console: "Console") -> Outcome:
    """Simulate the trial once, with the correction of --from, or as often as --repeat needs to learn the motion."""
    asked, begun = trial.asked, repeated.begun(trial.asked, trial.owner, trial.settings.dt)
    given, practice = asked if begun is None else begun.reference, None
    if repeated.repeat is not None:
        limits = trial.settings.plant.angle_limits
        learner = repeated.learner(asked, trial.responses, trial.settings.dt, begun, limits, trial.name)
        practice = practise(
            trial.tested, trial.controller, learner, seed=seed, progress=progress(console), **trial.conditions
        )
        if not trial.watches:
            return Outcome(practice.best, practice)
        given = learner.reference  # the best one is played again for display

    def watch() -> None:
        for one in trial.watches:
            one()

    run = simulate(trial.tested, trial.controller, given, seed=seed, watch=watch, progress=True, **trial.conditions)
    return Outcome(compared(run, asked), practice, begun)


def reported(trial: Trial, outcome: Outcome, learned: tuple[Path, Path] | tuple[()], console: "Console") -> None:
    """Print the trial, its errors and margins, and write what was learned."""
    run, practice = outcome.run, outcome.practice
    figures = metrics(run)
    say(console, *trial.about)
    console.print(table_of(run, figures))
    say(console, run.assumed, *limits_of_reference(figures, trial.settings.plant.slew), *trial.remarks(run))
    if practice is not None:
        report(practice.learner, trial.owner, practice.first.theta, practice.best.theta, learned, console)
    elif outcome.played is not None:
        say(console, f"played: {outcome.played.summary}")
    if trial.with_margins:
        say(console, *margins_in_words(trial.name, trial.settings, trial.asked, trial.controller))


def written(trial: Trial, run: Run, files: list[Path], margins: Path | None, console: "Console") -> list[Path]:
    """Write the files of a run and the picture of its margins, and return all of them."""
    plant, notes, film = trial.settings.plant, list[str](), trial.film
    model = plant if isinstance(plant, Plant) else None
    for path in files:
        if path.suffix.lower() in IMAGES:
            say(console, f"drawing {path}")
        save = None if film is None else lambda path: notes.append(film(run, path))
        write_run(run, path, save, trial.title, trial.hand, model)
    if margins is not None:
        plot_margins(sliding_margins(trial.name, trial.settings), margins, trial.title)
        files = [*files, margins]
    say(console, *notes, f"written: {', '.join(map(str, files))}")
    return files


def shown(files: Iterable[Path]) -> None:
    """Open pictures and films with the system's viewer."""
    for path in files:
        if path.suffix.lower() not in _DATA:
            typer.launch(str(path))
