"""Dashboard of a loop in the terminal, in a process of its own, so that drawing delays no sample.

The loop sends a line of JSON from time to time, and none while the dashboard is behind. On a terminal it is drawn in
place (rich); elsewhere there is a line of text per second.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterable
from typing import TYPE_CHECKING, Self

from allocator.lazy import Table
from mpc.bench.shell.live_plot import State, plotted

if TYPE_CHECKING:
    from mpc.bench.rows import Row
    from mpc.model.machine import Machine

_EVERY = 0.1  # [s] between two pictures
_LINE_EVERY = 1.0  # [s] between two lines of text
_BAR = 24  # characters
_PLOT = "--plot"
_PHASES = ("start", "settling", "tracking", "stopping")
_SEVERAL = (  # lists of a state, and fields of `Row`
    ("theta", "theta"), ("theta_ref", "theta_ref"), ("K", "K_estimate"), ("K_ref", "K_ref"), ("P", "P"),
    ("u", "P_command"),
)  # fmt: skip


class Dashboard:
    """Dashboard as a context manager, which shows the rows that it is called with; `plot` also opens a window."""

    def __init__(self, machine: "Machine", *, plot: bool = False) -> None:
        from mpc.bench.rows import Sheet  # not in the dashboard's process, which begins at once

        self._sheet, one = Sheet.of(machine), machine.angle_shape == ()
        self._constant = {
            "joints": ("angle",) if one else machine.labels.angles,
            "muscles": ("muscle 1", "muscle 2") if one else machine.labels.pressures,
            "entries": self._sheet.stiffness,
            "unit": machine.stiffness_unit,
            "highest": machine.pressure_limits[1],
        }
        self.health: Callable[[], str] = lambda: ""  # sentence about the joint's health, shown with a row
        self._plot = plot
        self._last = float("-inf")
        self._late: list[float] = []

    def __enter__(self) -> Self:
        command = [sys.executable, "-m", "mpc.bench.shell.dashboard", *[_PLOT] * self._plot]
        environment = {name: value for name, value in os.environ.items() if name != "MPLBACKEND"}  # a window is wanted
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, start_new_session=True, env=environment)
        assert self._process.stdin is not None
        self._pipe = self._process.stdin.fileno()
        os.set_blocking(self._pipe, False)
        return self

    def __exit__(self, *raised: object) -> None:
        assert self._process.stdin is not None
        self._process.stdin.close()
        try:
            self._process.wait(2.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def __call__(self, row: "Row") -> None:
        """Show a `Row`, if the last one was shown long enough ago."""
        self._late.append(row.late)
        if row.t - self._last < _EVERY:
            return
        self._last = row.t
        cells = dict(zip(self._sheet.names, self._sheet.cells(row), strict=True))
        several = {name: [cells[column] for column in self._sheet.fields[field]] for name, field in _SEVERAL}
        one = {name: cells[name] for name in ("t", "phase", "took", "missed")}
        state = {**one, **several, **self._constant, "late": max(self._late), "health": self.health()}
        self._late.clear()
        try:
            os.write(self._pipe, json.dumps(state).encode() + b"\n")
        except (BlockingIOError, BrokenPipeError):
            return  # the dashboard is behind or gone: the loop goes on


def main(lines: Iterable[str] | None = None) -> None:
    """Show the incoming states, one per line."""
    states: Iterable[State] = map(json.loads, sys.stdin if lines is None else lines)
    if _PLOT in sys.argv[1:]:
        states = plotted(states)
    if sys.stdout.isatty():
        _draw(states)
    else:
        _print(states)


def _print(states: Iterable[State]) -> None:
    last = float("-inf")
    for state in states:
        if state["t"] - last >= _LINE_EVERY:
            last = state["t"]
            print(text(state), flush=True)


def text(state: State) -> str:
    """Return a state as a line of text."""
    P, u = (_numbers(state[name], 1e-5) for name in ("P", "u"))
    wanted = f" of {_degrees(state['theta_ref'])}°" if _known(state["theta_ref"]) else ""
    health = f"  {state['health']}" if state["health"] else ""
    stiff = f"  K {_numbers(state['K'])} {state['unit']}" if _known(state["K"]) else ""
    return (
        f"{state['t']:7.1f} s {_PHASES[state['phase']]:9} θ {_degrees(state['theta'])}°{wanted}{stiff}  "
        f"P {P} bar, commanded {u}  late {1e3 * state['late']:.2f} ms{health}"
    )


def _known(values: list[float]) -> bool:
    return any(value == value for value in values)


def _numbers(values: list[float], scale: float = 1.0) -> str:
    return " ".join(f"{scale * value:.2f}" for value in values)


def _degrees(angles: list[float]) -> str:
    return _numbers(angles, 57.29577951308232)


def _draw(states: Iterable[State]) -> None:
    from rich.live import Live

    with Live(auto_refresh=False) as live:
        for state in states:
            live.update(_picture(state), refresh=True)


def _picture(state: State) -> "Table":
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"{_PHASES[state['phase']]}, {state['t']:.1f} s", show_header=False, min_width=64)
    for name, theta, wanted in zip(state["joints"], state["theta"], state["theta_ref"], strict=True):
        table.add_row(Text(name), f"{_degrees([theta])}°", f"reference {_degrees([wanted])}°")
    K, K_ref = (" ".join(f"{value:.3g}" for value in state[name]) for name in ("K", "K_ref"))
    table.add_row("stiffness", f"{K} {state['unit']}", f"reference {K_ref} {state['unit']}")
    for i, (name, P, u) in enumerate(zip(state["muscles"], state["P"], state["u"], strict=True), 1):
        table.add_row(Text(f"P{i} ({name})"), f"{P / 1e5:.2f} bar", bar(P, state["highest"]) + f" → {u / 1e5:.2f}")
    late = f"{1e3 * state['late']:.2f} ms late, {1e3 * state['took']:.2f} ms taken"
    table.add_row("time", late, f"{state['missed']} missed" if state["missed"] else "")
    table.add_row("health", Text(state["health"] or "well", style="red" if state["health"] else "green"))
    return table


def bar(value: float, highest: float) -> str:
    """Return a bar of length `value` over `highest`; empty if not measured."""
    full = round(_BAR * min(max(value / highest, 0.0), 1.0)) if value == value else 0
    return "█" * full + "·" * (_BAR - full)


if __name__ == "__main__":
    try:
        main()
    except OSError:  # the terminal or the reader is gone: nothing is left to show
        os._exit(0)  # without a flush, which would fail again
