"""Window with the last seconds of a loop, drawn by the dashboard's process, so that drawing delays no sample."""

import sys
from collections import deque
from collections.abc import Iterable, Iterator
from math import degrees

from mpc.bench.display.dashboard import State

_SHOWN = 10.0  # [s]
_MOST = 400  # states kept
_PANELS = (
    ("angle [°]", ("theta", "theta_ref")),
    ("stiffness [N·m/rad]", ("K", "K_ref")),
    ("pressures [bar]", ("P1", "P2")),
)
_COLOURS = ("#0072B2", "#D55E00")


def plotted(states: Iterable[State]) -> Iterator[State]:
    """Yield the states after the window has drawn them; without a screen or an open window, yield them at once."""
    import matplotlib.pyplot as plt

    if plt.get_backend().lower() == "agg":
        print("no window for --plot: there is no screen, or no toolkit (Tk, Qt) for Matplotlib", file=sys.stderr)
        yield from states
        return
    window = Window()
    for state in states:
        if plt.fignum_exists(window.figure.number):
            window.show(state)
            plt.pause(0.001)  # lets the toolkit draw and answer
        yield state


class Window:
    """Window with angle, stiffness and pressures of the last seconds."""

    def __init__(self) -> None:
        import matplotlib.pyplot as plt

        self.figure, self._axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), layout="constrained")
        self._rows: deque[dict[str, float]] = deque(maxlen=_MOST)
        self._lines = {}
        for axes, (label, names) in zip(self._axes, _PANELS, strict=True):
            axes.set_ylabel(label)
            axes.grid(alpha=0.25)
            for name, colour in zip(names, _COLOURS, strict=True):
                (self._lines[name],) = axes.plot([], [], color=colour, label=name)
            axes.legend(loc="upper left", frameon=False, ncols=2)
        self._axes[-1].set_xlabel("time [s]")

    def show(self, state: State) -> None:
        """Add a state and draw."""
        angles = {name: degrees(state[name]) for name in ("theta", "theta_ref")}
        pressures = {"P1": state["P"][0] / 1e5, "P2": state["P"][1] / 1e5}
        self._rows.append({"t": state["t"], "K": state["K"], "K_ref": state["K_ref"], **angles, **pressures})
        t = [row["t"] for row in self._rows]
        for name, line in self._lines.items():
            line.set_data(t, [row[name] for row in self._rows])
        for axes in self._axes:
            axes.relim()
            axes.autoscale_view(scalex=False)
        self._axes[-1].set_xlim(max(t[-1] - _SHOWN, t[0]), max(t[-1], t[0] + 1.0))
        self.figure.canvas.draw_idle()
