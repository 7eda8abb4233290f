"""The report's figures: the values that it states, its own formulas, and what it says of the curves in words."""

import numpy as np
import pytest

from allocator.units import BAR, DEG
from benchmarks.report_figures import FIGURES, draw, figure_1b, figure_3, figure_5b, figure_6, figure_7, figure_8
from benchmarks.report_figures.joint import figure_8_marked
from benchmarks.report_figures.muscles import readings

AREA = np.pi * 0.0109**2  # S of the report's muscle [m²]
A_MINUS_B = 3 / np.tan(25.5 * DEG) ** 2 - 1 / np.sin(25.5 * DEG) ** 2
BARS = tuple(f"{n} bar" for n in range(1, 6))


def drawn(curve):
    """Its points without the gaps."""
    there = np.isfinite(curve.y)
    return curve.x[there], curve.y[there]


def test_1b_ideal_mckibben_forces_are_proportional_to_pressure_and_end_at_37_percent():
    (panel,) = figure_1b()
    strongest = panel.curve("5 bar")
    assert strongest.y[0] == pytest.approx(1504, rel=5e-4)  # report, section 1
    for n, label in enumerate(BARS, 1):
        curve = panel.curve(label)
        assert curve.y == pytest.approx(n / 5 * strongest.y, abs=1e-9)
        assert curve.x[-1] == pytest.approx(37.0, abs=0.1)
        assert curve.y[-1] == pytest.approx(0, abs=1e-9)


def test_3_stays_within_5_bar_and_is_nearly_linear_in_the_angle():
    difference, total = figure_3()
    for K in range(1, 7):
        theta, d = drawn(difference.curve(f"{K} N·m/rad"))
        _, s = drawn(total.curve(f"{K} N·m/rad"))
        P1, P2 = (s + d) / 2, (s - d) / 2
        assert min(P1.min(), P2.min()) >= -1e-9
        assert max(P1.max(), P2.max()) <= 5 + 1e-9
        assert np.corrcoef(theta, d)[0, 1] > 0.999
        assert s.argmin() == pytest.approx(len(s) // 2, abs=1)  # the sum's curve opens upwards
    assert drawn(difference.curve("4 N·m/rad"))[0].max() == pytest.approx(145)  # the whole range
    assert drawn(difference.curve("6 N·m/rad"))[0].max() < 100  # only partially


def test_3_agrees_with_equation_8_of_the_report():
    difference, total = figure_3()
    a, b, S = 3 / np.tan(23.5 * DEG) ** 2, 1 / np.sin(23.5 * DEG) ** 2, np.pi * 0.01**2
    eps0 = (1 - np.sqrt(b / a)) / 2
    for K in range(1, 7):
        theta, d = drawn(difference.curve(f"{K} N·m/rad"))
        _, s = drawn(total.curve(f"{K} N·m/rad"))
        X = 0.02 * theta * DEG / 0.40
        stiffness = 2 * a * S * 0.02**2 / 0.40 * ((1 - eps0) * s - X * d) * BAR
        assert stiffness == pytest.approx(K, rel=1e-9)


def test_5b_law_11_starts_at_the_braid_s_force_and_ends_at_its_readings():
    (panel,) = figure_5b()
    for label, (P, eps_max) in zip(BARS, readings().items(), strict=True):
        x, F = drawn(panel.curve(label))
        assert F[0] == pytest.approx(AREA * A_MINUS_B * P, rel=1e-12)
        assert x[-1] == pytest.approx(100 * eps_max, abs=0.1)
    assert readings()[3 * BAR] == 0.225  # report, below (19)
    assert readings()[5 * BAR] == 0.275


def test_5b_shows_measured_points_of_the_package_s_table():
    (panel,) = figure_5b()
    x, F = (panel.curve("5 bar", "dots").x, panel.curve("5 bar", "dots").y)
    assert len(x) >= 5
    assert x[0] == pytest.approx(100 * (1 - 0.296 / 0.3))  # Martens & Boblan 2017, appendix, first length
    assert (np.diff(F) < 0).all()


def test_6_the_polynomials_pass_through_their_readings_and_the_fifth_order_wanders():
    fifth, third = figure_6()
    for panel, labels in ((fifth, BARS[1:]), (third, BARS[2:])):
        for label in labels:
            x, F = drawn(panel.curve(label))
            P = float(label.split()[0]) * BAR
            assert x[-1] == pytest.approx(100 * readings()[P], abs=0.15)
            assert F[0] == pytest.approx(AREA * A_MINUS_B * P, rel=1e-12)
    assert (np.diff(drawn(fifth.curve("5 bar"))[1]) > 0).any()  # force rises with contraction: the wandering
    assert (np.diff(drawn(third.curve("5 bar"))[1]) < 0).all()


def test_7_the_model_is_linear_in_the_contraction_and_its_stiffness_constant():
    force, stiffness = figure_7()
    for label in BARS:
        x, F = drawn(force.curve(label, "dashed"))
        assert np.diff(F) == pytest.approx(np.full(len(F) - 1, F[1] - F[0]), rel=1e-6)
        P = float(label.split()[0])
        _, K = drawn(stiffness.curve(label, "dashed"))
        by_21 = AREA / 0.40 * -779.1 / (P - 10.5) * BAR / 1e3  # (21) with the sign of F = -K dl, kN/m
        assert pytest.approx(by_21, rel=1e-3) == K
        slope = -np.diff(F) / (np.diff(x) / 100 * 0.40) / 1e3
        assert slope == pytest.approx(np.full(len(slope), by_21), rel=1e-3)


def test_7_the_model_overestimates_the_force_at_1_bar():
    """Report, below (19)."""
    force, _ = figure_7()
    model, law = force.curve("1 bar", "dashed").y, force.curve("1 bar").y
    both = np.isfinite(model) & np.isfinite(law)
    assert (model[both][1:] > law[both][1:]).all()


def test_8_keeps_within_5_bar_and_agrees_with_equation_22():
    difference, total = figure_8()
    for curve in difference.curves:
        _, d = drawn(curve)
        _, s = drawn(total.curve(curve.label))
        P1, P2 = (s + d) / 2, (s - d) / 2
        assert min(P1.min(), P2.min()) >= 0
        assert max(P1.max(), P2.max()) <= 5
        K = AREA * 0.02**2 / 0.40 * -779.0986 * BAR * (1 / (P1 - 10.5) + 1 / (P2 - 10.5))
        assert float(curve.label.split()[0]) == pytest.approx(K, rel=1e-6)
        assert s.argmax() == pytest.approx(len(s) // 2, abs=1)  # the sum's curve opens downwards, unlike figure 3


def test_8_marked_shows_that_6_newton_metres_a_radian_are_slack_everywhere():
    difference, _ = figure_8_marked()
    assert not np.isfinite(difference.curve("6 N·m/rad").y).any()
    assert np.isfinite(difference.curve("6 N·m/rad", "dashed").y).any()
    assert np.isfinite(difference.curve("7.5 N·m/rad").y).all()  # of 7.03 … 8.28, feasible everywhere
    beyond = difference.curve("9 N·m/rad", "dotted")
    taut = drawn(difference.curve("9 N·m/rad"))[0]
    assert taut.max() == pytest.approx(58.8, abs=0.5)  # mathematics.md section 1: K_max is 8.98 at 60°
    assert drawn(beyond)[0].max() == pytest.approx(125)


@pytest.mark.parametrize("number", FIGURES)
def test_every_figure_is_drawn_with_units_a_legend_outside_and_no_empty_panel(number):
    panels = FIGURES[number]()
    figure = draw(*panels)
    figure.canvas.draw()
    for axes, panel in zip(figure.axes, panels, strict=True):
        assert "[" in axes.get_xlabel()
        assert "[" in axes.get_ylabel()
        assert len(axes.lines) >= len(panel.curves)
        assert any(np.isfinite(line.get_ydata()).any() for line in axes.lines)
    legend = figure.axes[-1].get_legend()
    assert legend.get_window_extent().x0 >= figure.axes[-1].get_window_extent().x1
    assert legend.get_window_extent().x1 <= figure.bbox.x1
