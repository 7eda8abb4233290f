"""Tasks a and b: isometric forces of two real muscles of 10 mm, inflated and deflated, and their slope.

Repetitions 8 and 9 are fitted and 10 is predicted, one direction of the pressure at a time. Another length is predicted
from all repetitions of the first, inflating. Bins of fewer than 20 readings while deflating are transients. The slope
is judged by differences of the predicted and the measured forces of neighbouring contractions, where both pull. Each
rig's load cell is zeroed by its readings of slack muscles. The end length comes from the forces at no contraction of
four lengths of the same laboratory, 20 and 30 cm among them: at no contraction the held-out length is not unseen.
In brackets is the share of the errors that twice the surface's stated standard deviation covers; that doubt was set on
these two muscles. Where one reading is seen it is the mean force of the held-out length at no contraction and 6 bar.
The last row is no prediction: three numbers, of force, contraction and pressure, are fitted to the held-out length
itself, as a lower bound for laws of this form.
"""

import csv
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from allocator.calculus import Array, Mask
from allocator.identification.muscle.fit import fit
from allocator.identification.muscle.surface import ForceSurface
from allocator.muscles import MODELS, Muscle
from benchmarks.real.scores import best_in_bold

FILE = Path("festo_isometric") / "dmsp_10mm_20_30cm.csv"
END_LENGTH = 0.04  # [m], of `allocator.identification.muscle.surface`
_LEAST_BIN = 20
_MOST_PRESSURE = 625e3  # [Pa]
_HELD_OUT = 10
_PULLS = 30.0  # [N], above which a slope is judged
_PRESSURES = np.arange(300e3, 620e3, 20e3)  # [Pa] at which it is

Force = Callable[[Array, Array], Array]
_LAWS = "Sarosi2012", "MartensBoblan2017", "AffinePolynomial", "ThresholdPolynomial", "TableMuscle"
_READING = 600e3  # [Pa]
_BIN = 10e3  # [Pa]
_SLACK = 100e3  # [Pa], below which a contracted muscle is slack and shows the load cell's zero


class Forces(NamedTuple):
    """Rows of the table; arrays (n,)."""

    length: Array  # [m]
    contraction: Array  # [-]
    pressure: Array  # [Pa]
    force: Array  # [N]
    test: Array
    inflating: Mask

    def only(self, keep: Mask) -> "Forces":
        """Return some of the rows."""
        return Forces(*(column[keep] for column in self))


def read(path: Path) -> Forces:
    """Return the bins that are no transients, each length with the load cell's zero taken off."""
    with path.open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    number = {name: np.array([float(row[name]) for row in rows]) for name in rows[0] if name != "direction"}
    inflating = np.array([row["direction"] == "inflating" for row in rows])
    P = number["pressure_kPa"] * 1e3
    kept = (inflating | (number["n"] >= _LEAST_BIN)) & (P < _MOST_PRESSURE)
    columns = number["cut_length_cm"] / 100, number["contraction"], P, number["force_N"], number["test"], inflating
    found = Forces(*columns).only(kept)
    for length in np.unique(found.length):
        here = found.length == length
        slack = here & (found.pressure < _SLACK) & (found.contraction > 0)
        found.force[here] -= np.median(found.force[slack])
    return found


def surface(rows: Forces) -> ForceSurface:
    """Fit the surface."""
    return ForceSurface.fit(rows.contraction, rows.pressure, rows.force, pressures=16)


def law(model: type[Muscle]) -> Callable[[Forces], Force]:
    """Return what fits a parametric law to rows."""

    def fitted(rows: Forces) -> Force:
        P = np.maximum(rows.pressure, 0.0)
        muscle = fit(model, rows.contraction, P, rows.force, folds=0).muscle
        return lambda P, eps: np.maximum(muscle.force(P, eps), 0.0)  # slack: it pushes nothing

    return fitted


METHODS: dict[str, Callable[[Forces], Force]] = {
    **{name: law(MODELS[name]) for name in _LAWS},
    "B-spline surface": lambda rows: surface(rows).force,
}


def _repetition(rows: Forces, method: Callable[[Forces], Force]) -> tuple[float, float, float]:
    """Return RMS and median error [N] on the held-out repetition, and the median relative error of its slope."""
    errors, slopes = [], []
    for up in (True, False):
        one = rows.only(rows.inflating == up)
        seen, held = one.only(one.test < _HELD_OUT), one.only(one.test == _HELD_OUT)
        force = method(seen)
        errors.append(force(np.maximum(held.pressure, 0.0), held.contraction) - held.force)
        slopes.append(_slope_errors(force, held))
    error = np.concatenate(errors)
    return float(np.sqrt(np.mean(error**2))), float(np.median(np.abs(error))), float(np.median(np.concatenate(slopes)))


def _slope_errors(force: Force, held: Forces) -> Array:
    steps = np.unique(held.contraction)
    measured = []
    for eps in steps:
        at = held.only(held.contraction == eps)
        order = np.argsort(at.pressure)
        measured.append(np.interp(_PRESSURES, at.pressure[order], at.force[order]))
    predicted = [force(_PRESSURES, np.full(_PRESSURES.size, eps)) for eps in steps]
    fell, expected = np.diff(measured, axis=0), np.diff(predicted, axis=0)
    pulls = np.array(measured)[1:] > _PULLS
    return np.asarray(np.abs(expected / fell - 1)[pulls])


def repeatability(rows: Forces) -> float:
    """Return the RMS difference [N] of the held-out repetition from the mean of the others, at equal pressures."""
    squares = []
    for eps in np.unique(rows.contraction):
        for up in (True, False):
            at = rows.only((rows.contraction == eps) & (rows.inflating == up))
            curves = []
            for test in np.unique(at.test):
                one = at.only(at.test == test)
                order = np.argsort(one.pressure)
                curves.append(np.interp(_PRESSURES, one.pressure[order], one.force[order]))
            squares.append((curves[-1] - np.mean(curves[:-1], axis=0)) ** 2)
    return float(np.sqrt(np.mean(squares)))


def _by_end_length(seen: Forces, held: Forces, end_length: float) -> ForceSurface:
    return surface(seen).at_length(seen.length[0], held.length[0], end_length)


def _by_one_reading(seen: Forces, held: Forces) -> ForceSurface:
    still = held.only(held.contraction == 0)
    near = still.only(np.abs(still.pressure - _READING) < _BIN)
    return _by_end_length(seen, held, END_LENGTH).calibrated(_READING, 0.0, float(near.force.mean()))


def _fitted_to_itself(seen: Forces, held: Forces) -> str:
    """Return the RMS error [N] of the other length's surface with three factors of the held-out length's own."""
    force = surface(seen).force

    def error(s: Array) -> Array:
        return np.asarray(s[0] * force(s[1] * held.pressure, s[2] * held.contraction) - held.force)

    return f"{np.sqrt(np.mean(least_squares(error, np.ones(3)).fun ** 2)):.1f}"


def _predicted(by: Callable[[Forces, Forces], ForceSurface]) -> Callable[[Forces, Forces], str]:
    def scored(seen: Forces, held: Forces) -> str:
        """Return the RMS error [N] and the share that twice the stated standard deviation covers."""
        made = by(seen, held)
        error = made.force(held.pressure, held.contraction) - held.force
        return f"{np.sqrt(np.mean(error**2)):.1f} ({np.mean(np.abs(error) < 2 * made.std):.0%})"

    return scored


OTHER_LENGTH: dict[str, Callable[[Forces, Forces], str]] = {
    "no end": _predicted(partial(_by_end_length, end_length=0.0)),
    f"end length {1000 * END_LENGTH:.0f} mm": _predicted(partial(_by_end_length, end_length=END_LENGTH)),
    f"end length {1000 * END_LENGTH:.0f} mm, one reading seen": _predicted(_by_one_reading),
    "three numbers fitted to itself": _fitted_to_itself,
}


def _other_length(rows: Forces, scored: Callable[[Forces, Forces], str]) -> list[str]:
    """Return the scores of each length, predicted from the other."""
    lengths = np.unique(rows.length)
    of = [rows.only((rows.length == length) & rows.inflating) for length in lengths]
    return [scored(seen, held) for seen, held in (of[::-1], of)]


def table(path: Path) -> list[str]:
    """Return the scores as lines of Markdown."""
    rows = read(path)
    lengths = np.unique(rows.length)
    head = " | ".join(f"{100 * length:.0f} cm" for length in lengths)
    lines = ["Held-out repetition: RMS (median) error [N]; median error of the slope.", ""]
    lines += [f"| model | {head} |", f"|---{'|---' * lengths.size}|"]
    found = [
        (name, [_repetition(rows.only(rows.length == length), method) for length in lengths])
        for name, method in METHODS.items()
    ]
    cells_of = [(name, [f"{rms:.1f} ({mid:.1f}); {slope:.0%}" for rms, mid, slope in cells]) for name, cells in found]
    lines += best_in_bold(cells_of, [[cell[0] for cell in cells] for _, cells in found])
    cells = [f"{repeatability(rows.only(rows.length == length)):.1f}" for length in lengths]
    lines += [f"| repeatability, 3 to 6.2 bar | {' | '.join(cells)} |", ""]
    lines += ["Held-out length, inflating: RMS error [N] of each length, predicted from the other.", ""]
    lines += [f"| model | {head} |", f"|---{'|---' * lengths.size}|"]
    lines += [f"| {name} | {' | '.join(_other_length(rows, scored))} |" for name, scored in OTHER_LENGTH.items()]
    return lines
