"""Command `antagonist fit`: a muscle from a table of measured forces."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from allocator.errors import InvalidInput, MissingBackend
from allocator.files.text import short
from allocator.identification.muscle.fit import Ranking, rank_models
from allocator.identification.muscle.plotting import fit_figure
from allocator.identification.muscle.reading import DATASETS, read_samples
from allocator.identification.muscle.result import Fit
from allocator.identification.muscle.samples import Samples, joined
from allocator.identification.options import LogOptions, assigned, columns_option, each, print_lines
from allocator.muscles import MODELS, Muscle
from allocator.presentation.plotting import save_figure
from allocator.shell.options import grouped, within
from allocator.shell.outputs import AsJSON, Force, claim_result, print_json, write
from allocator.units import BAR, MM

_MOST_CONTRACTION = 0.6  # [-] no muscle of this family contracts further
_DEFAULT = "dmsp-20-300-map"


@dataclass(frozen=True)
class ForceOptions(LogOptions):
    """Options of a table of measured forces."""

    columns: Annotated[str | None, columns_option("pressure=p:bar,force=F:N")] = None


@grouped
def fit_command(
    data: Annotated[
        list[str] | None,
        typer.Argument(
            help=f"CSV files or bags, or a table of the package; the tables are {', '.join(DATASETS)}", metavar="DATA"
        ),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="fit this model only; by default all models are fitted and ranked")
    ] = None,
    rest_length: Annotated[
        float | None, typer.Option(help="rest length of the muscle [mm]; for columns of lengths")
    ] = None,
    *,
    source: ForceOptions,
    hold: Annotated[
        list[str] | None, typer.Option(help="parameter to hold fixed, in SI units, such as r0=0.0109; may be repeated")
    ] = None,
    min_pressure: Annotated[float | None, typer.Option(help="leave out samples below this pressure [bar]")] = None,
    min_contraction: Annotated[
        float | None, typer.Option(help="leave out samples below this contraction ratio")
    ] = None,
    zero_noise: Annotated[
        float | None,
        typer.Option(help="noise of the load cell without a force [N]; by default estimated from slack samples"),
    ] = None,
    out: Annotated[Path | None, typer.Option(help="TOML file to write the muscle to")] = None,
    plot: Annotated[Path | None, typer.Option(help="picture of isobars and data")] = None,
    force: Force = False,
    as_json: AsJSON = False,
) -> None:
    """Fit force laws to measured forces, rank them, and save the best one, or that of --model.

    Columns are found by name and unit: contraction [%], length or shortening [mm], pressure [bar] (gauge), force [N],
    also in other units and words (eps_pct, p (kPa), Kraft [N]). Without DATA a measured table of the package is used.
    Several files give one muscle; the zero of the load cell is estimated for each file.
    """
    within("--rest-length", rest_length, "mm", 1, 100_000)
    within("--min-pressure", min_pressure, "bar", -1, 100)
    within("--min-contraction", min_contraction, "(a ratio, not percent)", -1, 1)
    within("--zero-noise", zero_noise, "N", 0, 1_000_000)
    files = data or [_DEFAULT]
    claim_result(out, plot, inputs=files, force=force)
    console = Console(stderr=as_json)
    ranking = rank_models(
        joined({name: _samples(str(one), rest_length, source) for name, one in short(files).items()}),
        _models(model),
        progress=each,
        hold=assigned("--hold", hold or [], "NAME=VALUE, such as r0=0.0109"),
        pressure_range=(-np.inf if min_pressure is None else min_pressure * BAR, np.inf),
        contraction_range=(-np.inf if min_contraction is None else min_contraction, np.inf),
        zero_noise=zero_noise,
    )
    best = ranking.best
    if best is None:
        raise InvalidInput(_none_fits(ranking.failures))
    if as_json:
        print_json(_values(ranking, best))
    else:
        _report(ranking, console)
        _describe(best, console)
    names = ", ".join(Path(one).name.encode(errors="replace").decode() for one in files)
    write(out, lambda path: best.save(path, {"data": names}), console)
    write(plot, lambda path: save_figure(fit_figure(best), path, dpi=150), console)


def _samples(data: str, rest_length: float | None, source: LogOptions) -> Samples:
    if data in DATASETS:
        return DATASETS[data].samples()
    return source.read(read_samples, data, None if rest_length is None else rest_length * MM)


def _models(name: str | None) -> tuple[type[Muscle], ...]:
    if name is None:
        return tuple(MODELS.values())
    if name not in MODELS:
        raise MissingBackend("model", name, MODELS)
    return (MODELS[name],)


def _none_fits(failures: Mapping[str, str]) -> str:
    """Return the sentence for samples that no model fits: the reason of the first one, which has few parameters."""
    reason, *others = failures.values()
    return f"no force law can be fitted: {reason}" if others else reason


def _report(ranking: Ranking, console: Console) -> None:
    caption = (
        f"samples the model takes, of {ranking.samples}; RMS error [N] of those fitted; RMS error of samples kept from "
        f"the fit (cross-validation in 5 parts, the same {ranking.judged} samples for all models, weighted as in the "
        "fit); parameters fitted (in brackets how many combinations of them are determined, if fewer); whether "
        "[M] is kept: more pressure pulls more and stiffens, on which stiffness control rests"
    )
    table = Table(title="Muscle models, best first", caption=escape(caption), box=SIMPLE_HEAD, pad_edge=False)
    table.padding = (0, 1, 0, 0)
    table.add_column("model", no_wrap=True)
    for heading in ("samples", "error", "unseen", "params"):
        table.add_column(heading, justify="right", no_wrap=True)
    for heading in (r"\[M]", "inverse"):
        table.add_column(heading, no_wrap=True)
    for fit in ranking.fits:
        table.add_row(
            fit.model,
            str(fit.samples.n),
            f"{fit.rms:#.3g}".rstrip("."),
            f"{fit.cross_validated:#.3g}".rstrip("."),
            str(len(fit.free)) if fit.rank == len(fit.free) else f"{len(fit.free)} ({fit.rank})",
            "kept" if fit.monotone else "broken",
            "closed form" if fit.closed_form else "–" if fit.muscle.limitation else "numerical",
            style="bold" if fit is ranking.best else None,
        )
    if ranking.fits:
        console.print(table)
        print_lines(console, [_of_affine(ranking)] if len(ranking.fits) > 1 else [])
    print_lines(console, (f"{name}: not fitted, {why}" for name, why in ranking.failures.items()))


def _of_affine(ranking: Ranking) -> str:
    """Return a sentence about the best law that is affine in the pressure."""
    if ranking.affine is None:
        return (
            "none of these laws is affine in the pressure and keeps [M]: the C of an arm's controller needs such a law"
        )
    unseen, cost = ranking.affine.cross_validated, ranking.cost_of_affine
    best = "the least error of all" if cost == 1 else f"{cost:.2f} times the least error of all"
    return (
        f"best law that is affine in the pressure, as the C of an arm's controller needs it: {ranking.affine.model}, "
        f"{unseen:.3g} N unseen, {best}"
    )


def _describe(fit: Fit[Muscle], console: Console) -> None:
    """Print the chosen muscle: parameters with their standard deviations, and warnings."""
    samples = fit.samples
    lines = [
        f"{fit.model}, {fit.n_taut} taut samples and {fit.slack.sum()} slack ones: {fit.rms:.2f} N RMS, greatest error "
        f"{fit.max_error:.2f} N ({fit.max_error_percent:.1f} % of full scale)"
    ]
    for name, std in fit.standard_deviations.items():
        spread = f"± {std:.2g}" if name in fit.free else "(held)"
        lines.append(f"  {name} = {fit.muscle.parameters[name]:.6g} {spread}")
    lines.append(f"  measured at {fit.muscle.measured}; {_greatest(fit)}")
    if samples.zero_noise > 0:
        lines.append(f"  slack is a force below {samples.slack_limit:.3g} N, three times the zero noise")
    if not samples.zero_seen:
        lines.append("  the load cell's zero was not seen: no plateau of slack readings shows it")
    lines += [f"  {f.name}: {f.samples} taut samples, {f.rms:.2f} N RMS, mean {f.mean:+.2f} N" for f in fit.files]
    lines += [f"  {note}" for note in samples.notes]
    lines += [f"  {n} samples left out: {reason}" for reason, n in samples.dropped.items()]
    print_lines(console, [*lines, *(f"  beware: {warning}" for warning in fit.warnings)])


def _greatest(fit: Fit[Muscle]) -> str:
    """Return the contraction of zero force at the highest pressure, and whether that was measured."""
    P, most = float(fit.samples.pressure.max()), float(fit.samples.contraction.max())
    eps = np.linspace(0.0, _MOST_CONTRACTION, 2001)
    slack = np.flatnonzero(fit.muscle.law(P, eps) <= 0)
    at = f"at {P / BAR:.3g} bar the muscle goes slack at a contraction of"
    if not slack.size:
        return f"{at} more than {_MOST_CONTRACTION:g}, by extrapolation"
    return f"{at} {eps[slack[0]]:.3g}{'' if eps[slack[0]] <= most else ', by extrapolation'}"


def _values(ranking: Ranking, best: Fit[Muscle]) -> dict[str, object]:
    """Return the values printed by `--json`; parameters are in SI units, as in the file of --out."""
    return {
        "ranking": [fit.to_dict() for fit in ranking.fits],
        "failures": ranking.failures,
        "best_affine": None if ranking.affine is None else ranking.affine.model,
        "cost_of_affine": None if ranking.affine is None else ranking.cost_of_affine,
        "best": {
            **best.to_dict(),
            "files": [f._asdict() for f in best.files],
            "samples_left_out": best.samples.dropped,
            "notes": best.samples.notes,
            "measured": None if best.muscle.measured is None else vars(best.muscle.measured),
            "warnings": best.warnings,
        },
    }
