"""Errors after a load, beside the least that a linear controller as robust and as quiet can have.

The model that was identified from a stranger's logs, without friction and dead band, rests at 15° with 5 N·m/rad, and
1 N·m acts from one sample on. All controllers get the same dead time and age of readings. A linear controller of the
stable plant is a filter Q from the deviation of the reading that the load alone would cause to the commands (Youla's
parameter), and all figures are those of affine functions of it:

    sensitivity  S = 1 + G Q,      angle  θ = h + g * q * w,      commands  u = q * w,      their noise  q * n

G, g: commands ↦ reading and angle; h, w: angle and reading under the load; n: the encoder's rounding. The least Σ θ²
over 4 s with |S| ≤ M_s at all frequencies, a given noise of the commands' rate and |u'| within the slew is the solution
of a convex problem (S. P. Boyd and C. H. Barratt, Linear Controller Design: Limits of Performance, 1991, chapters 11
and 15), here with q of 1 s. Bounds are those for the controller's own M_s and noise, then for M_s = 2 and the noise of
the MPC, with the slew of the model and without one. The payload's inertia is not part of it. Figures are medians over
the strangers; in brackets is the greatest M_s.
"""

from collections.abc import Iterable
from math import inf
from typing import NamedTuple

import numpy as np

from allocator.calculus import Array
from allocator.units import BAR, DEG
from benchmarks.strangers.identified import identified
from benchmarks.strangers.plants import drawn
from benchmarks.strangers.runs import CASES, DT, K, rms
from mpc.model.experiment import Experiment
from mpc.model.real import real_of
from mpc.trials.loops import Settings, loop, robust
from mpc.trials.margins import ROBUST, margins

TITLE = "The least errors after a load"
CONTROLLERS = ("mpc", "lqr", "predictive-pid", "pid")
THETA, LOAD, ROUNDING = 15 * DEG, 1.0, 0.1 * DEG / 12**0.5  # [rad], [N·m], [rad] of an encoder with steps of 0.1°
LENGTH, TAPS, SETTLE = 400, 100, 20  # samples of the responses and of q, and before them
SMALL = 1e-3  # of a response: 1 mbar, 1 mN·m, 1e-3 of the rounding
TWINS = np.array([1.0, -1.0])  # commands that turn the joint


class Responses(NamedTuple):
    """Responses (LENGTH,) of the plant without a controller."""

    reading: Array  # to a pulse of the commands [rad/bar]
    angle: Array
    loaded_reading: Array  # to the load [rad]
    loaded_angle: Array


class Achieved(NamedTuple):
    """Figures of one controller on one stranger."""

    controller: str
    peak: float  # M_s
    noise: float  # of the commands' rate [bar/s]
    error: float  # RMS after the load [°]
    swing: float  # its greatest error [°]
    bound: float  # least RMS error with this M_s and this noise [°]
    robust: float  # with M_s = 2 and the noise of the MPC [°]
    free: float  # the same without a slew [°]


def begun(settings: Settings) -> Experiment:
    """Begin an experiment with the model as its plant."""
    plant, told = settings.plant, settings.compensation
    real = real_of(plant, dead_time=told.dead_time, reading_age=told.reading_age)
    return real.begin(DT, plant.at_rest(THETA, K), 0)


def responses_of(settings: Settings) -> Responses:
    """Return the responses of the model."""
    rest = settings.plant.at_rest(THETA, K)[2:]

    def run(more: float, torque: float) -> Array:
        """Return readings and angles (2, LENGTH) with a pulse of the commands [bar] and a torque [N·m]."""
        trial, found = begun(settings), []
        for k in range(SETTLE + LENGTH):
            found.append((trial.measure()[0], trial.x[0]))
            trial.advance(rest + TWINS * more * BAR * (k == SETTLE), np.array([torque * (k >= SETTLE)]))
        return np.array(found[SETTLE:]).T

    still = run(0.0, 0.0)
    pulsed, loaded = (run(SMALL, 0.0) - still) / SMALL, (run(0.0, SMALL) - still) / SMALL * LOAD
    return Responses(pulsed[0], pulsed[1], loaded[0], loaded[1])


def achieved(controller: str, settings: Settings) -> tuple[float, float, float, float]:
    """Return M_s, noise, RMS error and swing [°] of a controller on the model."""
    control, observer = loop(controller, settings)

    def run(error: float, torque: float) -> tuple[Array, Array]:
        """Return the angles and first commands (LENGTH,) with one disturbed reading [rad] and a torque [N·m]."""
        control.reset()
        observer.reset()
        trial, u, angles, commands = begun(settings), settings.plant.at_rest(THETA, K)[2:], [], []
        for k in range(SETTLE + LENGTH):
            y = trial.measure()
            y[0] += error * (k == SETTLE)
            x, d = observer.estimate(y, u)
            u = control.step(x, THETA, K, d).u[0]
            angles.append(trial.x[0])
            commands.append(u[0])
            trial.advance(u, np.array([torque * (k >= SETTLE)]))
        return np.array(angles[SETTLE:]), np.array(commands[SETTLE:])

    rests, control.rest = control.rest, False
    still, disturbed, loaded = run(0.0, 0.0), run(SMALL * ROUNDING, 0.0), run(0.0, LOAD)
    control.rest = rests
    theta = (loaded[0] - still[0]) / DEG
    peak = margins(control, observer, [(THETA, K)], inertia=False)[0].sensitivity_peak
    return peak, noise_of((disturbed[1] - still[1]) / SMALL / BAR), rms(theta), float(np.abs(theta).max())


def noise_of(response: Array) -> float:
    """Return the deviation of the rate of a command [bar/s] from its response to one rounding [bar]."""
    return float(np.linalg.norm(np.diff(response, prepend=0.0)) / DT)


def least(plant: Responses, peak: float, noise: float, slew: float = inf) -> float:
    """Return the least RMS error [°] of the linear controllers with at most this M_s, noise and slew [bar/s]."""
    import cvxpy as cp

    unit = 1 / np.abs(plant.reading).max()  # [bar/rad] of q
    basis = np.eye(TAPS)
    driven = [np.convolve(plant.loaded_reading, one)[:LENGTH] for one in basis]
    turned = unit * np.array([np.convolve(plant.angle, one)[:LENGTH] for one in driven]).T
    omega = 2 * np.pi * DT * np.concatenate([np.linspace(0.05, 8, 150), np.linspace(8.2, 50, 60)])
    delayed = np.exp(-1j * np.outer(omega, np.arange(LENGTH)))
    G = unit * (delayed @ plant.reading)[:, None] * delayed[:, :TAPS]
    q = cp.Variable(TAPS)
    S = cp.vstack([1 + G.real @ q, G.imag @ q])
    rate = unit * ROUNDING / DT * cp.diff(cp.hstack([0, q, 0]))
    theta = (plant.loaded_angle + turned @ q) / DEG
    limits = [cp.norm(S, axis=0) <= peak, cp.norm(rate) <= noise]
    if slew < inf:
        limits.append(cp.abs(cp.diff(unit * np.array(driven).T @ q)) <= slew * DT)
    problem = cp.Problem(cp.Minimize(cp.sum_squares(theta)), limits)
    problem.solve(solver=cp.CLARABEL, tol_gap_rel=1e-3, tol_gap_abs=1e-2, tol_feas=1e-5)
    return rms(theta.value)


def rows_of(structure: str, seed: int) -> list[Achieved]:
    """Return the figures of all controllers on one stranger."""
    model, rows = identified(drawn(structure, seed)), []
    settings = Settings(model.plant, DT, compensation=model.told)
    plant, slew, calm = responses_of(settings.sliding), model.plant.slew / BAR, 0.0
    for name in CONTROLLERS:
        figures = achieved(name, robust(name, settings, CASES["rest"].reference).sliding)
        calm = calm or figures[1]
        bounds = least(plant, *figures[:2], slew), least(plant, ROBUST, calm, slew), least(plant, ROBUST, calm)
        rows.append(Achieved(name, *figures, *bounds))
    return rows


def table(rows: Iterable[Achieved]) -> list[str]:
    """Return the medians as lines of Markdown."""
    all_rows = list(rows)
    heads = "M_s (greatest) | noise [bar/s] | error [°] | peak [°] | bound [°] | with M_s = 2 [°] | without slew [°]"
    lines = [f"| controller | {heads} | error over the bound |", "|---" * 9 + "|"]
    for name in CONTROLLERS:
        mine = np.array([row[1:] for row in all_rows if row.controller == name])
        cells = " | ".join(f"{value:.2f}" for value in np.median(mine, axis=0)[1:])
        peaks = f"{np.median(mine[:, 0]):.2f} ({mine[:, 0].max():.2f})"
        lines.append(f"| {name} | {peaks} | {cells} | {np.median(mine[:, 2] / mine[:, 4]):.2f} |")
    return lines
