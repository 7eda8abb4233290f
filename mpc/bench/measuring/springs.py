"""Felt stiffness of a steady loop by springs that slip: a backbone and stops of the measured angle.

Along a steady loop between ±A, with stops s_j of half widths ρ_j A on a grid,

    Σ g_i T_i - J θ'' - D θ' = K θ + Σ w_j s_j(θ; ρ_j A),        K, w_j ≥ 0                                     (F1)

by least squares over the stroke, ∮ … |dθ|, and the secant is K + Σ w_j ρ_j. The torque at the turns themselves is no
measure of it: friction that reverses there lets the acceleration jump, of which a sampled tone has the mean, or holds
the joint while the torque changes.
"""

import numpy as np

from allocator.calculus import Array
from mpc.bench.measuring.loops import Tone

_SHARES = np.array([0.001, 0.03, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8])  # ρ_j
_HARMONICS = 3  # odd ones: where friction reverses, higher ones of the acceleration oscillate
_GRID = 360  # points per period


def stop(theta: Array, r: float) -> Array:
    """Return the stop e = clip(e + Δθ, ±r) (n,) [rad] of half width r along the angles (n,), from e = 0."""
    e, out = 0.0, [0.0]
    for step in np.diff(theta).tolist():
        e = max(-r, min(r, e + step))
        out.append(e)
    return np.array(out)


def solved(X: Array, y: Array) -> Array:
    """Return the nonnegative least-squares solution of X x = y, with scaled columns."""
    from scipy.optimize import nnls

    size = np.maximum(np.sqrt((X**2).mean(axis=0)), 1e-30)
    return np.asarray(nnls(X / size, y)[0] / size)


def secant(tone: Tone, strengths: Array, age: float, inertia: float, damping: float) -> float:
    """Return the stiffness [N·m/rad] between the turns of a tone, gravity included."""
    h, Y = (each[:_HARMONICS] for each in tone.phasors(age))
    waves = np.exp(1j * np.outer(2 * np.pi * np.arange(_GRID) / _GRID, h))
    rate = 1j * h * tone.omega * Y[:, 0]
    force = Y[:, 1:] @ strengths + inertia * (h * tone.omega) ** 2 * Y[:, 0] - damping * rate
    theta, omega, T = (waves @ np.column_stack([Y[:, 0], rate, force])).real.T
    A, up = np.ptp(theta) / 2, np.sign(omega)[:, None]
    stops = up * np.minimum(A + up * theta[:, None] - _SHARES * A, _SHARES * A)
    stroke = np.sqrt(np.abs(omega))
    found = solved(np.column_stack([theta, stops]) * stroke[:, None], T * stroke)
    return float(found[0] + found[1:] @ _SHARES)
