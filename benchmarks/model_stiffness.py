"""Effect of the muscle model on the stiffness of a joint.

    python -m benchmarks.model_stiffness [--out benchmarks/results]

Every model is fitted to every measured table of the package, and two of the fitted muscles are put on the report's
pulley (R = 2 cm, l0 = 40 cm, ε0 = 0.1375), agonist and antagonist at the same pressure, so T(0) = 0. The output is
`model_stiffness.csv` (all angles) and `model_stiffness.md` (θ = 0, and the range of K over θ), with

* the RMS error over the taut samples and the cross-validated one of left-out samples;
* K(θ = 0) at 1…5 bar ± one standard deviation from the covariance of the parameters (delta method). It is the
  uncertainty within a model, not the model's own error, which the spread between models shows;
* the band: least and greatest K over the models with errors below 2 % of full scale that satisfy [M];
* the spread of K between good models over several sets of data (`benchmarks.stiffness_spread`).

Stretched samples and, of the data sheet, those below 1 bar, are left out. A K in brackets belongs to a pair of muscles
that are slack in the model at that pressure: no joint can have it.
"""

import argparse
import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from allocator import AntagonistJoint, Pulley
from allocator.identification import DATASETS, Fit, load_dataset, rank_models
from allocator.muscles import parameter_sensitivities, standard_deviation
from allocator.units import BAR, DEG
from benchmarks.stiffness_spread import markdown as spreads

PULLEY = Pulley(rest_length=0.40, radius=0.02, initial_contraction=0.1375)
PRESSURES = np.arange(1, 6) * BAR
ANGLES = np.array([-90, -60, -30, 0, 30, 60, 90]) * DEG
RANGES = {"dmsp-20-300-map": (0.0, 7 * BAR), "dmsp-20-sheet": (0.95 * BAR, 7 * BAR)}
GOOD = 2.0  # [% of full scale] RMS error of the models in the band


class Stiffness(NamedTuple):
    """K of a joint with equal muscles at equal pressures, over (pressure, angle)."""

    K: np.ndarray  # (5, 7) [N·m/rad]
    std: np.ndarray  # (5, 7) [N·m/rad]
    taut: np.ndarray  # (5, 7) both muscles pull


def stiffness(fit: Fit) -> Stiffness:
    """Return K = -(R²/l0) Σ F_ε(P, ε_i) and its standard deviation; both muscles share their parameters."""
    joint = AntagonistJoint(PULLEY, fit.muscle, fit.muscle)
    P, theta = PRESSURES[:, None], ANGLES
    gradient = sum(
        -(PULLEY.radius**2) / PULLEY.rest_length * parameter_sensitivities(fit.muscle, P, side.contraction).slope
        for side in (PULLEY.agonist(theta), PULLEY.antagonist(theta))
    )
    taut = np.minimum(*joint.forces(theta, P, P)) >= 0
    return Stiffness(joint.stiffness(theta, P, P), standard_deviation(fit.muscle, gradient), taut)


def rows(table: str, fits: list[tuple[Fit, Stiffness]]) -> Iterator[dict[str, object]]:
    for fit, joint in fits:
        for (i, j), K in np.ndenumerate(joint.K):
            yield {
                "table": table,
                "model": fit.model,
                "taut_samples": fit.n_taut,
                "parameters": fit.rank,
                "rms_N": f"{fit.rms:.3f}",
                "cross_validated_N": f"{fit.cross_validated:.3f}",
                "rms_percent": f"{fit.rms_percent:.3f}",
                "monotone": fit.monotone,
                "closed_form_inverse": fit.closed_form,
                "pressure_bar": f"{PRESSURES[i] / BAR:g}",
                "theta_deg": f"{ANGLES[j] / DEG:g}",
                "K_Nm_per_rad": f"{K:.4f}",
                "K_std_Nm_per_rad": f"{joint.std[i, j]:.4f}",
                "taut": bool(joint.taut[i, j]),
            }


def markdown(table: str, fits: list[tuple[Fit, Stiffness]]) -> Iterator[str]:
    yield f"## {DATASETS[table].about}\n"
    bars = " | ".join(f"{p / BAR:g} bar" for p in PRESSURES)
    yield f"| model | error [N] (unseen) | [M] | inverse | {bars} | over ±90° at 3 bar |"
    yield "|" + "---|" * (5 + len(PRESSURES))
    middle = ANGLES.size // 2
    for fit, joint in fits:
        K = [cell(joint, i, middle) for i in range(PRESSURES.size)]
        inverse = "closed form" if fit.closed_form else "none" if fit.muscle.limitation else "numerical"
        kept = "kept" if fit.monotone else "broken"
        errors = f"{fit.rms:.1f} ({fit.cross_validated:.1f})"
        yield f"| {fit.model} | {errors} | {kept} | {inverse} | {' | '.join(K)} | {over_angle(joint)} |"
    band = np.array([j.K[:, middle] for f, j in fits if f.monotone and f.rms_percent <= GOOD])
    cells = " | ".join(f"{low:.2f}–{high:.2f}" for low, high in zip(band.min(0), band.max(0), strict=True))
    yield f"| **band of the {len(band)} good ones** | ≤ {GOOD:g} % f. s. | kept | | {cells} | |\n"


def cell(joint: Stiffness, i: int, j: int) -> str:
    text = f"{joint.K[i, j]:.2f} ± {joint.std[i, j]:.2f}"
    return text if joint.taut[i, j] else f"({text})"


def over_angle(joint: Stiffness) -> str:
    """Return the range of K over the angles at which both muscles are taut at 3 bar."""
    K = joint.K[2][joint.taut[2]]
    return f"{K.min():.2f}–{K.max():.2f}" if K.size else "slack"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results")
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    lines, records = [__doc__.partition("\n\n")[0].removesuffix(".") + " [N·m/rad]\n"], []
    lines[0] = "# " + lines[0]
    for table, pressures in RANGES.items():
        ranking = rank_models(load_dataset(table), pressure_range=pressures, contraction_range=(0.0, 0.3))
        fits = [(fit, stiffness(fit)) for fit in ranking.fits]
        records += rows(table, fits)
        lines += markdown(table, fits)
    lines += spreads()
    with (out / "model_stiffness.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, records[0])
        writer.writeheader()
        writer.writerows(records)
    text = "\n".join(lines)
    (out / "model_stiffness.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
