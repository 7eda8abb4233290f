"""Window with the last seconds of a loop, drawn by the dashboard's process, so that drawing delays no sample."""

import sys
from collections import deque
from collections.abc import Iterable, Iterator
from math import degrees
from typing import Any, TypeAlias

State: TypeAlias = dict[str, Any]  # content of a line of JSON

_SHOWN = 10.0  # [s]
_MOST = 400  # states kept
_PANELS = (  # label, lists of a state, scale of their numbers
    ("angle [°]", ("theta", "theta_ref"), degrees(1.0)),
    ("stiffness", ("K", "K_ref"), 1.0),
    ("pressures [bar]", ("P",), 1e-5),
)
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000", "#8c8c8c")


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
    """Window with angles, stiffness and pressures of the last seconds."""

    def __init__(self) -> None:
        import matplotlib.pyplot as plt

        self.figure, self._axes = plt.subplots(3, 1, sharex=True, figsize=(7, 6), layout="constrained")
        self._states: deque[State] = deque(maxlen=_MOST)
        self._lines: dict[tuple[str, int], Any] = {}  # by list of a state and place in it

    def show(self, state: State) -> None:
        """Add a state and draw."""
        if not self._lines:
            self._begin(state)
        self._states.append(state)
        t = [each["t"] for each in self._states]
        for axes, (_, names, scale) in zip(self._axes, _PANELS, strict=True):
            for (name, i), line in self._lines.items():
                if name in names:
                    line.set_data(t, [scale * each[name][i] for each in self._states])
            axes.relim()
            axes.autoscale_view(scalex=False)
        self._axes[-1].set_xlim(max(t[-1] - _SHOWN, t[0]), max(t[-1], t[0] + 1.0))
        self.figure.canvas.draw_idle()

    def _begin(self, state: State) -> None:
        """Draw the axes and the empty lines for the quantities of a state."""
        for axes, (label, names, _) in zip(self._axes, _PANELS, strict=True):
            axes.set_ylabel(f"{label} [{state['unit']}]" if label == "stiffness" else label)
            axes.grid(alpha=0.25)
            for name in names:
                for i, (own, colour, style) in enumerate(_styles(name, len(state[name]), state["entries"])):
                    (self._lines[name, i],) = axes.plot([], [], color=colour, ls=style, label=own)
            axes.legend(loc="upper left", frameon=False, ncols=2)
        self._axes[-1].set_xlabel("time [s]")


def _styles(name: str, size: int, entries: list[str]) -> Iterator[tuple[str, str, str]]:
    """Yield label, colour and style of each line of a list; references of several quantities are dashed.

    The labels are the names of the columns in a log; `entries` are those of the stiffness.
    """
    stem, reference, ending = name.partition("_")
    for i in range(size):
        own = entries[i] if stem == "K" else stem if size == 1 else f"{stem}{i + 1}"
        place = (1 if reference else 0) if size == 1 else i % len(_COLOURS)
        yield own + reference + ending, _COLOURS[place], "--" if reference and size > 1 else "-"
