"""Figures 1(b), 5(b), 6 and 7: force and stiffness of one muscle.

The report does not print its measured points (Sárosi et al. 2015, one DMSP-20-400N). They are replaced by the law that
Sárosi et al. fitted to that muscle, and by measured forces of another specimen, a DMSP-20-300 of this package. The
readings ε_max at 3 and 5 bar are the report's, those at 1, 2 and 4 bar follow from Sárosi's law.
"""

import numpy as np

from allocator.calculus import Array
from allocator.identification import load_dataset
from allocator.muscles import Muscle, PolynomialMcKibben, TonduLopez2000
from allocator.muscles.catalogue import SAROSI_DMSP_20_400N, TONDU_DMSP_20_400N, TONDU_MCKIBBEN
from allocator.units import BAR, DEG
from benchmarks.report_figures.panel import Curve, Panel

PRESSURES = np.arange(1, 6) * BAR  # [Pa]
R0, ALPHA0 = 0.0109, 25.5 * DEG  # [m], [rad]: the report's DMSP-20-400N
REST_LENGTH = 0.40  # [m]
_READ_IN_REPORT = {3 * BAR: 0.225, 5 * BAR: 0.275}
_EPS = np.linspace(0.0, 0.30, 301)
_CONTRACTION, _FORCE = "contraction ε [%]", "force F [N]"


def readings() -> dict[float, float]:
    """Return the contraction without load ε_max [-] by pressure [Pa]: the report's two, the others of Sárosi's law."""
    from scipy.optimize import brentq

    law = SAROSI_DMSP_20_400N
    return {
        float(P): _READ_IN_REPORT.get(float(P)) or float(brentq(lambda eps, P=P: law.force(P, eps), 1e-3, 0.4))
        for P in PRESSURES
    }


def figure_1b() -> tuple[Panel, ...]:
    """Compute figure 1(b), of the ideal McKibben muscle (7): force over contraction at 1 … 5 bar."""
    eps = np.linspace(0.0, TONDU_MCKIBBEN.max_contraction, 201)
    curves = tuple(Curve(_bar(P), 100 * eps, TONDU_MCKIBBEN.force(P, eps)) for P in PRESSURES)
    return (Panel("1(b) ideal McKibben muscle (7)", _CONTRACTION, _FORCE, curves),)


def figure_5b() -> tuple[Panel, ...]:
    """Compute figure 5(b): the McKibben law with ε_max(P) (11) against measurements."""
    curves = [_isobar(_law_11(P), P, "line") for P in PRESSURES]
    curves += [_isobar(SAROSI_DMSP_20_400N, P, "dashed") for P in PRESSURES]
    curves += [_measured(P) for P in PRESSURES]
    styles = (
        ("line", "law (11)"),
        ("dashed", "Sárosi's fit to the DMSP-20-400N"),
        ("dots", "DMSP-20-300, measured at\n" + _levels()),
    )
    return (Panel("5(b) McKibben law with ε_max(P)", _CONTRACTION, _FORCE, tuple(curves), styles),)


def figure_6() -> tuple[Panel, ...]:
    """Compute figure 6: polynomials through the readings ε_max (13)-(15), of fifth (oscillating) and third order."""
    read = readings()
    chosen = {"6(a) fifth order, 1 … 5 bar": PRESSURES, "6(b) third order, 3, 4, 5 bar": PRESSURES[2:]}
    panels = []
    for title, pressures in chosen.items():
        muscle = PolynomialMcKibben.identify(R0, ALPHA0, pressures.tolist(), [read[float(P)] for P in pressures])
        curves = [_isobar(muscle, P, "line") for P in PRESSURES]
        curves += [_isobar(SAROSI_DMSP_20_400N, P, "dashed") for P in PRESSURES]
        styles = (("line", "polynomial (13)-(15)"), ("dashed", "Sárosi's fit"))
        panels.append(Panel(title, _CONTRACTION, _FORCE, tuple(curves), styles))
    return tuple(panels)


def figure_7() -> tuple[Panel, ...]:
    """Compute figure 7: force of law (11) and of the report's model (13), (18), stiffness of the model and of a fit.

    The fit is Sárosi's.
    """
    force = [_isobar(_law_11(P), P, "line") for P in PRESSURES]
    force += [_isobar(TONDU_DMSP_20_400N, P, "dashed") for P in PRESSURES]
    stiffness = [_stiffness(SAROSI_DMSP_20_400N, P, "line") for P in PRESSURES]
    stiffness += [_stiffness(TONDU_DMSP_20_400N, P, "dashed") for P in PRESSURES]
    styles = (("line", "(a) law (11), (b) Sárosi's fit"), ("dashed", "report's model (13), (18)"))
    return (
        Panel("7(a) force", _CONTRACTION, _FORCE, tuple(force), styles),
        Panel(
            "7(b) stiffness of the muscle, l0 = 40 cm", _CONTRACTION, "stiffness K_M [kN/m]", tuple(stiffness), styles
        ),
    )


def _law_11(P: float) -> Muscle:
    """Return (11) with the k(P) that follows from the reading at this pressure."""
    shape = TonduLopez2000.with_constant_k(R0, ALPHA0, 1.0)
    return TonduLopez2000.with_constant_k(R0, ALPHA0, shape.max_contraction / readings()[float(P)])


def _isobar(muscle: Muscle, P: float, style: str) -> Curve:
    """Return the force at one pressure while it is taut, from ε = 0 on."""
    return Curve(_bar(P), 100 * _EPS, np.where(_taut(muscle, P), muscle.force(P, _EPS), np.nan), style)


def _stiffness(muscle: Muscle, P: float, style: str) -> Curve:
    """Return K_M = ∂F/∂l = -(1/l0) ∂F/∂ε [kN/m]   (21)"""
    K = -muscle.slope(P, _EPS) / REST_LENGTH / 1e3
    return Curve(_bar(P), 100 * _EPS, np.where(_taut(muscle, P), K, np.nan), style)


def _taut(muscle: Muscle, P: float) -> Array:
    """Return the part of the axis where the muscle pulls, up to the first contraction without force."""
    return np.logical_and.accumulate(muscle.force(P, _EPS) >= 0)


def _measured(P: float) -> Curve:
    """Return the measured points of the pressure nearest to P."""
    table = load_dataset("dmsp-20-300-map")
    near = np.isclose(table.pressure, _level(P)) & (table.force > 0)
    return Curve(_bar(P), 100 * table.contraction[near], table.force[near], "dots")


def _level(P: float) -> float:
    pressures = load_dataset("dmsp-20-300-map").pressure
    return float(pressures[np.argmin(np.abs(pressures - P))])


def _levels() -> str:
    return ", ".join(f"{_level(P) / BAR:.3g}" for P in PRESSURES) + " bar"


def _bar(P: float) -> str:
    return f"{P / BAR:g} bar"
