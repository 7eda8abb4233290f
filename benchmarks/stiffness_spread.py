"""Spread of stiffness between models that fit the same forces equally well, over several sets of data.

A joint of two equal muscles at equal pressures has K(θ = 0) ∝ -F_ε(P, ε0), so the spread of K is that of the slope. It
is evaluated where the muscle was measured and is taut in all models: at a quarter, half and three quarters of the
measured contractions and at 3, 4 and 5 bar.
"""

import csv
import os
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator.identification import Fit, load_dataset, rank_models
from allocator.identification.muscle.samples import Samples
from allocator.units import BAR

GOOD = 2.0  # [% of full scale] RMS error of the models compared
NEAR = 1.5  # times the least RMS error: those compared if no model is that good
PRESSURES = np.array([3.0, 4.0, 5.0]) * BAR
SHARES = np.array([0.25, 0.5, 0.75])  # of the measured contractions
FEW = 5  # muscle lengths of the thinned table
_ISOMETRIC = Path("data/festo_isometric/dmsp_10mm_20_30cm.csv")
_LEAST_BIN = 20  # readings: smaller bins are transients


class Spread(NamedTuple):
    """Greatest stiffness over the least one, less 1, of the good models."""

    name: str
    lengths: int  # at which forces were measured
    models: int
    error: tuple[float, float]  # least and greatest RMS error of these models [% of full scale]
    least: float
    median: float
    most: float


def sets() -> Iterator[tuple[str, Samples]]:
    """Yield the tables of the package, one of them with few lengths, and the isometric ones of $ANTAGONIST_SHARED."""
    table = load_dataset("dmsp-20-300-map")
    inside = table.where((table.contraction >= 0) & (table.contraction <= 0.3))
    yield "DMSP-20-300, measured", inside
    levels = np.unique(np.round(inside.contraction, 4))
    few = levels[np.linspace(0, levels.size - 1, FEW).round().astype(int)]
    yield f"the same, {FEW} lengths only", inside.where(np.isin(np.round(inside.contraction, 4), few))
    sheet = load_dataset("dmsp-20-sheet")
    yield "DMSP-20, data sheet", sheet.where((sheet.contraction >= 0) & (sheet.pressure >= 0.95 * BAR))
    shared = Path(os.environ.get("ANTAGONIST_SHARED", "")) / _ISOMETRIC
    if shared.is_file():
        yield from isometric(shared)


def isometric(path: Path) -> Iterator[tuple[str, Samples]]:
    """Yield inflated and deflated 10 mm muscles at four constant lengths, one set for each muscle."""
    with path.open(encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if float(row["n"]) >= _LEAST_BIN]
    for cut in ("20", "30"):
        mine = [row for row in rows if row["cut_length_cm"] == cut]
        eps, P, F = (np.array([float(r[c]) for r in mine]) for c in ("contraction", "pressure_kPa", "force_N"))
        yield f"DMSP-10, {cut} cm, isometric", Samples.checked(eps, 1e3 * P, F)


def spread(name: str, samples: Samples) -> Spread:
    """Fit all models to the samples and compare the slopes of the good ones."""
    fits = [fit for fit in rank_models(samples, folds=0).fits if fit.monotone]
    limit = max(GOOD, NEAR * min(fit.rms_percent for fit in fits))
    good = [fit for fit in fits if fit.rms_percent <= limit]
    eps = SHARES * samples.contraction.max()
    ratios = np.array([ratio for P in PRESSURES for e in eps if (ratio := _ratio(good, P, float(e))) > 0])
    error = min(fit.rms_percent for fit in good), max(fit.rms_percent for fit in good)
    lengths = np.unique(np.round(samples.contraction, 3)).size
    least, median, most = (float(f(ratios)) - 1 for f in (np.min, np.median, np.max))
    return Spread(name, lengths, len(good), error, least, median, most)


def _ratio(fits: list[Fit], P: float, eps: float) -> float:
    """Return the greatest slope over the least at one place; 0 if the muscle is slack there in a model."""
    if min(float(fit.muscle.force(P, eps)) for fit in fits) <= 0:
        return 0.0
    slopes = [-float(fit.muscle.slope(P, eps)) for fit in fits]
    return max(slopes) / min(slopes) if min(slopes) > 0 else np.inf


def markdown() -> Iterator[str]:
    """Yield the lines of the table."""
    yield "## Spread between models that fit the same forces equally well\n"
    yield (
        f"Models that keep [M] with an RMS error of at most {GOOD:g} % of full scale (or {NEAR:g} times the least "
        "error, where that is more), at 3 to 5 bar and a quarter to three quarters of the measured contractions: "
        "greatest stiffness over the least one.\n"
    )
    yield "| forces | lengths | models | error [% f. s.] | least | median | greatest spread |"
    yield "|---|---|---|---|---|---|---|"
    for name, samples in sets():
        s = spread(name, samples)
        low, high = s.error
        cells = " | ".join(f"{100 * x:.0f} %" if x < 1 else f"factor {1 + x:.1f}" for x in (s.least, s.median, s.most))
        yield f"| {s.name} | {s.lengths} | {s.models} | {low:.1f}–{high:.1f} | {cells} |"
    yield ""


if __name__ == "__main__":
    print("\n".join(markdown()))
