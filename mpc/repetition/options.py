"""Options of `antagonist track` and `run` for learning a motion by repeating it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from allocator import checks
from allocator.calculus import Array
from allocator.errors import InvalidInput
from allocator.lazy import Console, Table
from allocator.shell.outputs import say
from allocator.units import DEG

if TYPE_CHECKING:
    from mpc.repetition.learner import Learner, Repetition
    from mpc.repetition.response import Response
    from mpc.trials.motions.corrections import Correction, Owner
    from mpc.trials.motions.reference import Reference

_ENDING = ".correction.toml"
_UNNAMED = "motion"
_SLOW = "nmpc"


@dataclass(frozen=True)
class RepeatOptions:
    """Options of a motion to be learned, or of a correction to be played."""

    PANEL: ClassVar[str] = "Repetition"

    repeat: Annotated[
        int | None,
        typer.Option(
            help="repeat the motion at most this many times; the reference is corrected after each repetition"
        ),
    ] = None
    correction: Annotated[
        Path | None,
        typer.Option(
            help=f"TOML file to write the correction to; by default TRAJECTORY{_ENDING} beside the trajectory"
        ),
    ] = None
    learned: Annotated[
        Path | None,
        typer.Option(
            "--from", help="play the correction in this file, which --repeat wrote; with --repeat continue from it"
        ),
    ] = None
    load: Annotated[
        str | None, typer.Option(help="name of the carried load; a correction is refused for another load")
    ] = None

    def __post_init__(self) -> None:
        """Refuse contradictory options. Raises `InvalidInput`."""
        if self.repeat is not None:
            checks.count("--repeat", self.repeat, least=2)
        elif self.correction is not None:
            raise InvalidInput("--correction is written by --repeat N; to play one say --from FILE")
        if self.load is not None and not self.asked:
            raise InvalidInput("--load goes with --repeat or --from: it names the load of a correction")

    @property
    def asked(self) -> bool:
        """Whether a motion is to be learned, or a correction to be played."""
        return self.repeat is not None or self.learned is not None

    def written(self, trajectory: str | None) -> tuple[Path, Path] | tuple[()]:
        """Return the files of the correction and its picture, or () if no motion is repeated."""
        if self.repeat is None:
            return ()
        path = self.correction
        if path is None and trajectory is None and self.learned is not None:
            path = self.learned.with_name(self.learned.name.removesuffix(".toml") + ".next.toml")
        if path is None:
            name = Path(trajectory or _UNNAMED)
            path = name.with_name(name.stem + _ENDING)
        if path.suffix != ".toml":
            raise InvalidInput(f"--correction {path}: the ending has to be .toml")
        return path, path.with_suffix(".png")

    def reference(self, trajectory: str | None, called: "Callable[[], Reference]") -> "Reference":
        """Return the motion of the file --from if no `trajectory` is named, else the one that `called` returns."""
        from mpc.trials.motions.corrections import Correction

        if self.learned is not None and trajectory is None:
            return Correction.load(self.learned).wanted
        found = called()
        return found if found.name or trajectory is None else replace(found, name=Path(trajectory).stem)

    def begun(self, reference: "Reference", owner: "Owner", dt: float) -> "Correction | None":
        """Return the correction of --from for a reference sampled every `dt` [s]; None without --from.

        Raises `InvalidInput` if it belongs to another joint, load, controller or motion.
        """
        from mpc.trials.motions.corrections import Correction

        if self.learned is None:
            return None
        found = Correction.load(self.learned)
        found.check(owner, self.learned)
        return found.along(reference.resampled(dt), self.learned)

    def learner(
        self,
        reference: "Reference",
        responses: "Callable[[], tuple[Response, ...]]",
        dt: float,
        begun: "Correction | None",
        angle_limits: tuple[Array | float, Array | float],
        controller: str,
    ) -> "Learner":
        """Return the learner of --repeat. Raises `InvalidInput` if the controller is too slow for trial runs."""
        from mpc.repetition.learner import Learner

        assert self.repeat is not None
        if controller == _SLOW:
            raise InvalidInput(f"--repeat: {_SLOW} is too slow for trial runs of its response; take mpc")
        shift = None if begun is None else begun.shift
        return Learner(reference, responses(), dt, self.repeat, correction=shift, angle_limits=angle_limits)


def progress(console: "Console") -> "Callable[[Repetition], None]":
    """Return a function that prints the error of each repetition."""
    count = [0]

    def after(done: "Repetition") -> None:
        count[0] += 1
        say(console, f"repetition {count[0]}: angle error {done.rms / DEG:.3g}° RMS, {done.worst / DEG:.3g}° at worst")

    return after


def report(
    learner: "Learner", owner: "Owner", before: Array, after: Array, files: Sequence[Path], console: "Console"
) -> None:
    """Print the results of learning, and write the correction and its picture.

    `before` and `after` are the measured angles (M, …) [rad] of the first and the best repetition.
    """
    from allocator.presentation.plotting import save_figure
    from mpc.repetition.practice import plot_learning
    from mpc.trials.motions.corrections import Correction

    console.print(_table(learner))
    if learner.update is not None:
        rate = f"{100 * learner.update.rate:.0f} % or less at every frequency that the low-pass lets through"
        say(console, f"first update: {learner.update}; on all plants considered, errors fall to {rate}")
    say(console, f"learned: {learner}")
    errors = tuple(one.rms for one in learner.history)
    Correction(learner.course.wanted, learner.best.correction, owner, errors).save(files[0])
    save_figure(plot_learning(learner, before, after, learner.course.wanted.name), files[1], dpi=120)
    say(console, f"play it with --from {files[0]}; its picture is {files[1]}")


def _table(learner: "Learner") -> "Table":
    from rich.table import Table

    table = Table("repetition", "RMS [°]", "worst [°]", "predicted [°]", "gain", title="angle error, as read")
    update, first = learner.update, learner.history[0].rms
    for i, one in enumerate(learner.history):
        promised = "" if update is None else f"{update.predicted[i] * first / DEG:.3g}"
        best = " ←" if one is learner.best else ""
        table.add_row(f"{i + 1}{best}", f"{one.rms / DEG:.3g}", f"{one.worst / DEG:.3g}", promised, f"{one.gain:.2g}")
    return table
