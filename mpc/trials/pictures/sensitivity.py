"""Picture of a loop's robustness: its sensitivity over the frequency, and its Nyquist plot."""

from collections.abc import Sequence
from os import PathLike

import numpy as np

from allocator.lazy import Figure
from allocator.presentation.plotting import GREY, name_axes, new_figure, save_figure
from mpc.trials.margins import ROBUST, Margins
from mpc.trials.pictures.plotting import COLOURS

_LOWEST = 0.2  # [Hz]
_SHOWN = 2.5  # of the plane around -1
_CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 361))


def plot_margins(found: Sequence[Margins], path: str | PathLike[str] | None = None, title: str = "") -> "Figure":
    """Return a figure of |S| and of L's eigenvalues in the plane, one colour per posture, and write it to a `path`.

    The circle of radius 1/2 around -1, which L does not enter while M_s ≤ 2, is grey.
    """
    figure = new_figure(11, 4.2)
    plane, spectrum = figure.subplots(1, 2)
    spectrum.axhline(ROBUST, color=GREY, ls="--", lw=1)
    plane.fill((_CIRCLE / ROBUST - 1).real, (_CIRCLE / ROBUST).imag, color=GREY, alpha=0.25, lw=0)
    plane.plot(-1, 0, "+", color="black")
    for margins, colour in zip(found, COLOURS, strict=False):
        name = f"{margins.place}: M_s = {margins.sensitivity_peak:.2f}"
        spectrum.loglog(margins.frequency, margins.magnitude, color=colour, label=name)
        for locus in margins.L:
            plane.plot(locus.real, locus.imag, color=colour)
    spectrum.set_xlim(left=_LOWEST)
    spectrum.set_ylim(bottom=0.05)
    plane.set(xlim=(-_SHOWN + 0.5, 0.5), ylim=(-_SHOWN / 2, _SHOWN / 2), aspect="equal")
    name_axes(spectrum, "frequency [Hz]", "sensitivity |S| [-]")
    name_axes(plane, "real part of L [-]", "imaginary part of L [-]")
    spectrum.legend(loc="lower right", fontsize=8)
    figure.suptitle(title)
    if path is not None:
        save_figure(figure, path)
    return figure
