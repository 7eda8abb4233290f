"""The window of a loop shows its last seconds; without a screen the loop's text goes on."""

import matplotlib
import pytest

from mpc.bench.shell import live_plot


def states(n):
    for k in range(n):
        yield {
            "t": 0.1 * k,
            "theta": [0.1],
            "theta_ref": [0.2],
            "K": [5.0],
            "K_ref": [5.5],
            "P": [2e5, 3e5],
            "unit": "N·m/rad",
            "entries": ["K"],
        }


@pytest.fixture
def window():
    import matplotlib.pyplot as plt

    with matplotlib.rc_context():
        plt.switch_backend("agg")
        made = live_plot.Window()
        yield made
        plt.close(made.figure)


def test_the_window_shows_the_last_seconds_in_degrees_and_bar(window):
    for k, state in enumerate(states(300)):
        if k % 30 in (0, 29):
            window.show(state)
    window.figure.canvas.draw()
    lines = {line.get_label(): line for axes in window.figure.axes for line in axes.lines}
    assert lines["theta"].get_ydata()[-1] == pytest.approx(5.73, abs=0.01)
    assert lines["P2"].get_ydata()[-1] == pytest.approx(3.0)
    assert window.figure.axes[-1].get_xlim() == pytest.approx((19.9, 29.9))


def test_the_window_of_an_arm_has_a_line_for_each_of_its_quantities(window):
    for state in states(3):
        several = {"theta": [0.1, 0.2], "theta_ref": [0.1, 0.3], "K": [3.0, 0.5, 2.0], "K_ref": [3.0, 0.5, 2.0]}
        window.show(state | several | {"P": [1e5] * 5 + [4e5], "entries": ["K11", "K12", "K22"]})
    lines = {line.get_label(): line for axes in window.figure.axes for line in axes.lines}
    assert len(lines) == 4 + 6 + 6
    assert lines["theta2_ref"].get_ydata()[-1] == pytest.approx(17.19, abs=0.01)
    assert lines["P6"].get_ydata() == pytest.approx([4.0] * 3)
    assert (lines["K12"].get_linestyle(), lines["K12_ref"].get_linestyle()) == ("-", "--")


def test_without_a_screen_the_states_go_on(capsys):
    import matplotlib.pyplot as plt

    plt.switch_backend("agg")
    assert len(list(live_plot.plotted(states(5)))) == 5
    assert "no window for --plot" in capsys.readouterr().err
