"""Result of a tuning: every evaluation, before and after, as a table and as a plant's file."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from allocator.errors import InvalidFile
from allocator.files.atomic import write_text
from allocator.files.text import FilePath
from allocator.files.toml import Table
from allocator.presentation.tables import html_table
from mpc.model.plant import Plant
from mpc.trials.tuned import TABLE, Tuning
from mpc.tuning.cost import OF_DRAWS, Evaluation, Problem

WORTH = 0.1  # share of the objective; a smaller gain on draws was a loss on joints of other structures


@dataclass(frozen=True, eq=False)
class Tuned:
    """Tunings that were tried on a problem, the defaults first."""

    problem: Problem
    evaluations: tuple[Evaluation, ...]

    @property
    def before(self) -> Evaluation:
        """The defaults."""
        return self.evaluations[0]

    @property
    def after(self) -> Evaluation:
        """The tuning with the least objective; the defaults if it is not better by `WORTH`."""
        best = min(self.evaluations, key=lambda one: one.objective)
        return best if best.objective < (1 - WORTH) * self.before.objective else self.before

    @property
    def stays(self) -> bool:
        """Whether the defaults stay."""
        return self.after is self.before

    @property
    def tuning(self) -> Tuning:
        """The numbers that were found."""
        return self.after.tuning

    @property
    def warning(self) -> str:
        """A sentence if no tuning keeps the limits, or ""."""
        if self.after.robust:
            return ""
        return (
            f"no tuning kept M_s at or below {self.problem.limit:g} on the model and {OF_DRAWS * self.problem.limit:g} "
            f"on the draws, and the inertia margin at {self.after.bears:.1f} or above (at best {self.after.excess:.2f} "
            "times off): try more evaluations, or shorten the dead time"
        )

    @property
    def note(self) -> str:
        """A sentence if the defaults stay, or if a tuning keeps the limits at the expense of accuracy, or ""."""
        if self.stays:
            gain = 1 - min(one.objective for one in self.evaluations) / self.before.objective
            better = f"the best tuning found lowers their cost by only {gain:.1%}" if gain else "no tuning was better"
            return f"the defaults stay: {better}"
        if not self.after.robust or self.after.error <= self.before.error:
            return ""
        return f"the defaults are more accurate, but exceed a limit {self.before.excess:.2f} times"

    def judged(self, seed: int) -> tuple[Evaluation, Evaluation]:
        """Return the evaluations of the defaults and of the tuning on as many draws of another `seed`."""
        other = self.problem.redrawn(seed)
        return other.evaluated(self.before.tuning, always=True), other.evaluated(self.tuning, always=True)

    def rows(self, pair: tuple[Evaluation, Evaluation] | None = None) -> list[tuple[str, str, str]]:
        """Return name, figure before and figure after, in words; means over the draws, but for the quantile of M_s.

        A `pair` replaces before and after, such as that of `judged`.
        """
        before, after = (_words(one, self.problem.tour.motions) for one in pair or (self.before, self.after))
        return [(name, before[name], after[name]) for name in before]

    def to_dict(self, judged: tuple[Evaluation, Evaluation] | None = None) -> dict[str, object]:
        """Return the result: numbers in SI units, and figures before and after, also those of `judged` if given."""
        others = {} if judged is None else {"judged": {"before": _figures(judged[0]), "after": _figures(judged[1])}}
        return others | {
            "controller": self.tuning.controller,
            "tuning": dict(self.tuning.numbers),
            "evaluations": len(self.evaluations),
            "draws": len(self.problem.draws),
            "seed": self.problem.seed,
            "before": _figures(self.before),
            "after": _figures(self.after),
        }

    def save(self, plant: FilePath, out: FilePath) -> None:
        """Write the plant's file `plant` with the table [tuning] to `out`, everything else as it stands.

        If the defaults of a joint stay, it is written without the table, since `track` suits them to the motion.
        Raises `InvalidFile` and `CannotWrite`.
        """
        usual = self.stays and isinstance(self.problem.settings.plant, Plant)
        write_text(out, with_tuning(plant, None if usual else self.tuning))

    def __repr__(self) -> str:
        """Return the gain in words."""
        before, after, count = self.before, self.after, len(self.evaluations)
        return (
            f"Tuned {self.tuning.controller} in {count} evaluations on {len(self.problem.draws)} draws: cost "
            f"{before.error:.2f} → {after.error:.2f}°, M_s {before.sensitivity_peak:.2f} → {after.sensitivity_peak:.2f}"
        )

    def _repr_html_(self) -> str:
        """Return before and after as a table for notebooks."""
        return html_table(repr(self), ((name, f"{before} → {after}") for name, before, after in self.rows()))


def with_tuning(path: FilePath, tuning: Tuning | None) -> str:
    """Return the text of a plant's file with the table [tuning], which replaces an existing one; None: without one.

    Raises `InvalidFile` if the existing one is not a table of its own.
    """
    Table.read(path)
    text = Path(path).read_text(encoding="utf-8-sig")
    kept = re.sub(rf"(?ms)^\[{TABLE}\].*?(?=^\[|\Z)", "", text).rstrip("\n") + "\n"
    made = kept if tuning is None else kept + "\n".join(tuning.lines()) + "\n"
    if TABLE in Table.parsed(path, kept).entries:
        raise InvalidFile(path, f"[{TABLE}] is not written as a table; remove it")
    Table.parsed(path, made)
    return made


def _words(e: Evaluation, motions: Sequence[str]) -> dict[str, str]:
    legs = {
        f"{name}, RMS before / with load [°]": f"{e.rms(name):.2f} / {e.rms(f'{name} loaded'):.2f}" for name in motions
    }
    return {
        "cost [°]": f"{e.error:.2f}",
        **legs,
        "load comes, RMS [°]": f"{e.rms('load'):.2f}",
        "commands at rest [bar/s]": f"{e.chatter:.2f}",
        "stiffness error, RMS [%]": f"{100 * e.K_error:.1f}",
        "M_s on the model": f"{e.sensitivity_peak:.2f}",
        "M_s on the draws, 80 % quantile": f"{e.peak_of_draws:.2f}",
        "inertia margin on the model": f"{e.inertia_margin:.1f}",
        "delay margin on the model [ms]": f"{1e3 * e.delay_margin:.0f}",
    }


def _figures(e: Evaluation) -> dict[str, object]:
    legs = e.draws[0].rms
    return {
        "cost_deg": e.error,
        **{f"{leg.replace(' ', '_')}_deg": e.rms(leg) for leg in legs},
        "chatter_bar_per_s": e.chatter,
        "K_error": e.K_error,
        "sensitivity_peak": e.sensitivity_peak,
        "sensitivity_peak_of_draws": e.peak_of_draws,
        "inertia_margin": e.inertia_margin,
        "delay_margin_s": e.delay_margin,
    }
